"""The loop whose clock jumps: far where nothing happens, never past somebody who works."""

import asyncio
import socket
import time
from threading import Thread

import anyio.to_thread
import pytest
from jumping import JumpingLoop, LoopClock, seen_threads, work
from patience import within

__all__ = ["seen_threads"]

YEAR_S = 365 * 86_400.0


def run(coroutine) -> object:  # type: ignore[no-untyped-def]
    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(coroutine)


def test_a_year_takes_no_time_and_events_keep_their_order() -> None:
    order = []

    async def note(after_s: float) -> None:
        await asyncio.sleep(after_s)
        order.append((after_s, asyncio.get_running_loop().time()))

    async def year() -> float:
        began_s = asyncio.get_running_loop().time()
        await asyncio.gather(note(YEAR_S), note(3600.0), note(0.5 * YEAR_S))
        return asyncio.get_running_loop().time() - began_s

    began_s = time.monotonic()
    passed_s = run(year())
    assert passed_s == pytest.approx(YEAR_S, abs=60.0)
    assert time.monotonic() - began_s < 60.0
    assert [after_s for after_s, _ in order] == [3600.0, 0.5 * YEAR_S, YEAR_S]
    assert order == sorted(order, key=lambda one: one[1])


def test_its_own_computing_takes_no_time() -> None:
    async def busy() -> float:
        clock = LoopClock(1.0, 0)
        time.sleep(0.1)  # noqa: ASYNC251 - a loop that does not come to its turn
        await asyncio.sleep(1.0)
        return clock.now_us() / 1e6

    assert run(busy()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("way", ["asyncio", "anyio", "future"])
def test_no_time_out_passes_while_a_thread_works(way: str) -> None:
    async def answer() -> str:
        def compute() -> str:
            time.sleep(0.2)
            return "done"

        async with within(60.0):
            if way == "asyncio":
                return await asyncio.to_thread(compute)
            if way == "anyio":
                return await anyio.to_thread.run_sync(compute)
            loop, future = asyncio.get_running_loop(), asyncio.Future[str]()
            thread = Thread(target=lambda: loop.call_soon_threadsafe(future.set_result, compute()))
            thread.start()
            with work():
                return await future

    assert run(answer()) == "done"


def test_no_time_out_passes_while_a_socket_may_answer() -> None:
    async def answer() -> bytes:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        with ours, theirs:
            thread = Thread(target=lambda: (time.sleep(0.2), theirs.send(b"late")))
            thread.start()
            async with within(60.0):
                received = await asyncio.get_running_loop().sock_recv(ours, 4)
            thread.join()
            return received

    assert run(answer()) == b"late"


def test_process_time_jumps_with_the_loop() -> None:
    async def hours() -> int:
        clock = LoopClock(3600.0, 1_000_000)
        await clock.sleep(10 * 3600.0)
        return clock.now_us()

    assert run(hours()) == pytest.approx(1_000_000 + 36_000_000_000, rel=0.1)
