"""A virtual bench on real wires."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from patience import within

from adapters.virtual_bench import run
from adapters.virtual_bench.live import LiveBench
from adapters.virtual_bench.modbus_server import BenchModbusServer
from adapters.virtual_bench.scenarios import find_scenario


@asynccontextmanager
async def running_bench(
    scenario: str, rate: float, **options: Any
) -> AsyncIterator[dict[str, Any]]:
    announced: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
    stop = asyncio.Event()
    task = asyncio.create_task(
        run(
            scenario,
            rate=rate,
            modbus_port=0,
            can_port=0,
            announce=announced.set_result,
            stop=stop,
            **options,
        )
    )
    task.add_done_callback(lambda _: announced.done() or announced.cancel())
    try:
        yield await announced
    finally:
        stop.set()
        async with within(20.0):
            await task


@asynccontextmanager
async def polled_bench(scenario: str, now_s: Callable[[], float]) -> AsyncIterator[dict[str, Any]]:
    """A bench whose clock is the test's: each read is at the next moment that `now_s` gives."""
    server = BenchModbusServer(LiveBench(find_scenario(scenario), 0), now_s, lambda: None)
    host, port = await server.start("127.0.0.1", 0)
    try:
        yield {"modbus": {"host": host, "port": port}}
    finally:
        await server.stop()
