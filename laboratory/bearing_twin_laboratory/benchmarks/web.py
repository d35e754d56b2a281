"""The web side under load: snapshots, what-if and the stream while ingest and a job run."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from statistics import median

from bearing_twin_laboratory.benchmarks import clients
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.site import Site, site

FIRST_ANSWER_S = 5.0
CONNECTIONS = 4
WHAT_IF = {"profile": [{"duration_s": 4 * 3600, "speed_rpm": 5600, "load_n": 4000}]}


def snapshot(progress: Progress) -> Measurement:
    """Snapshots/s while an identification job and ingest run."""
    return asyncio.run(_at_a_site(snapshot_at, progress, 60.0))


def what_if_http(progress: Progress) -> Measurement:
    """95 % of the what-if forecasts (4 h, all nodes, 200 members) are answered within this."""
    return asyncio.run(_at_a_site(what_if_at, progress, 30.0))


def websocket_500(progress: Progress) -> Measurement:
    """99 % of the stream's messages reach 500 clients within this, 50 more never read."""
    return asyncio.run(_at_a_site(websocket_at, progress, 60.0))


async def _at_a_site(
    measure: Callable[[Site, Progress, float], Awaitable[Measurement]],
    progress: Progress,
    duration_s: float,
) -> Measurement:
    progress(0.0, "a virtual bench and a service start")
    async with site() as here:
        return await measure(here, progress, duration_s)


async def snapshot_at(
    here: Site, progress: Progress, duration_s: float, rounds: int = 5
) -> Measurement:
    """Measure snapshots and an empty route in turn, without and with a job."""
    seconds = duration_s / rounds / 4
    with clients.started("empty") as process:
        assert process.stdout is not None  # noqa: S101
        port = int(await asyncio.to_thread(process.stdout.readline))

        ours = clients.Calls(
            port=here.port,
            path=here.snapshot_path,
            headers=here.headers,
            connections=CONNECTIONS,
            seconds=seconds,
        )
        empty = clients.Calls(port=port, path="/", connections=CONNECTIONS, seconds=seconds)
        await _in_turn(1, ours, empty)  # the first calls are not counted
        progress(0.2, "no job, snapshot and empty route in turn")
        idle, idle_empty = await _in_turn(rounds, ours, empty)
        async with here.identifying():
            progress(0.6, "a job runs, snapshot and empty route in turn")
            busy, busy_empty = await _in_turn(rounds, ours, empty)
    p99_s, idle_p99_s = _p99_s(busy), _p99_s(idle)
    return Measurement(
        _per_s(busy),
        "1/s",
        _per_s(busy_empty),
        "an empty FastAPI route in a process of its own, in turn with it",
        {
            "p99_s": p99_s,
            "idle_p99_s": idle_p99_s,
            "p99_ratio": p99_s / idle_p99_s,
            "idle": _per_s(idle),
            "idle_reference": _per_s(idle_empty),
            "reference_p99_s": _p99_s(busy_empty),
            "connections": CONNECTIONS,
        },
    )


async def _in_turn(
    rounds: int, ours: clients.Calls, empty: clients.Calls
) -> tuple[list[clients.Answered], list[clients.Answered]]:
    pairs = [(await _call(ours), await _call(empty)) for _ in range(rounds)]
    return [pair[0] for pair in pairs], [pair[1] for pair in pairs]


async def _call(asked: clients.Calls) -> clients.Answered:
    found = await asyncio.to_thread(clients.call, asked)
    if set(found.statuses) != {"200"} or found.lost:
        raise BenchmarkError(f"answers {found.statuses}, {found.lost} connections lost")
    return found


def _per_s(found: Sequence[clients.Answered]) -> float:
    return median(one.per_s for one in found)


def _p99_s(found: Sequence[clients.Answered]) -> float:
    return median(one.p99_s for one in found)


async def what_if_at(here: Site, progress: Progress, duration_s: float) -> Measurement:
    """Measure what-if forecasts one after the other, without and with a job."""
    question = clients.Calls(
        port=here.port,
        path=here.forecasts_path,
        headers=here.headers,
        method="POST",
        body=json.dumps(WHAT_IF),
        connections=1,
        seconds=FIRST_ANSWER_S,
    )
    # The process that computes them may still be starting.
    await asyncio.to_thread(clients.call, question)
    progress(0.3, "no job")
    idle = await _call(replace(question, seconds=duration_s / 3))
    async with here.identifying():
        progress(0.5, "a job runs")
        busy = await _call(replace(question, seconds=2 * duration_s / 3))
    return Measurement(
        busy.p95_s,
        "s",
        idle.p95_s,
        "the same without a job",
        {
            "p50_s": busy.p50_s,
            "p99_s": busy.p99_s,
            "max_s": busy.max_s,
            "idle_p50_s": idle.p50_s,
            "idle_p99_s": idle.p99_s,
            "requests": busy.requests,
        },
    )


async def websocket_at(
    here: Site, progress: Progress, duration_s: float, listeners: int = 500, stalled: int = 50
) -> Measurement:
    """Measure how late messages come, and how the service's memory grows meanwhile."""
    few = await _listen(here, duration_s / 6, 1, 0)
    progress(0.3, f"{listeners} clients")
    before_mib, cpu_s = here.memory_mib(), here.cpu_s()
    peak_mib = before_mib
    listening = asyncio.create_task(_listen(here, duration_s, listeners, stalled))
    while not listening.done():
        await asyncio.wait({listening}, timeout=0.5)
        peak_mib = max(peak_mib, here.memory_mib())
    found = listening.result()
    cpu_s = here.cpu_s() - cpu_s
    if found.lost:
        raise BenchmarkError(f"{found.lost} clients that read were cut off")
    return Measurement(
        found.p99_s,
        "s",
        few.p99_s,
        "one client alone",
        {
            "p50_s": found.p50_s,
            "p99_s": found.p99_s,
            "max_s": found.max_s,
            "clients": listeners,
            "stalled": stalled,
            "messages_per_client_per_s": found.messages / listeners / duration_s,
            "fewest_per_client": found.fewest_per_client,
            "memory_growth_mib": peak_mib - before_mib,
            "cpu_share": cpu_s / duration_s,
        },
    )


async def _listen(here: Site, seconds: float, count: int, stalled: int) -> clients.Heard:
    asked = clients.Listening(
        port=here.port,
        key=here.key,
        path="/api/v1/stream",
        clients=count,
        stalled=stalled,
        settle_s=min(2.0, seconds),
        seconds=seconds,
    )
    return await asyncio.to_thread(clients.listen, asked)
