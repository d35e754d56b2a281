"""The virtual bench as a running process: real time, real sockets."""

import asyncio
import math
import time
from collections.abc import Callable
from pathlib import Path

from adapters.virtual_bench.announcements import BenchAnnouncement
from adapters.virtual_bench.can_sender import BenchCanSender
from adapters.virtual_bench.families import random_bench
from adapters.virtual_bench.live import TRUTH_COLUMNS, LiveBench
from adapters.virtual_bench.modbus_server import BenchModbusServer
from adapters.virtual_bench.parameters import BenchParameters
from adapters.virtual_bench.scenarios import Scenario, find_scenario
from adapters.virtual_bench.truth_file import TruthFile

CAN_PERIOD_S = 0.05  # process time: 20 frames per second and message at rate 1
_SHORTEST_PERIOD_S = 0.01  # wall time


async def run(
    scenario: str | Scenario,
    *,
    rate: float = 1.0,
    seed: int = 0,
    specimen: int | None = None,
    host: str = "127.0.0.1",
    modbus_port: int = 5020,
    can_port: int = 5021,
    truth: Path | None = None,
    wait_for_start: bool = False,
    announce: Callable[[BenchAnnouncement], None],
    stop: asyncio.Event,
) -> None:
    """Run a scenario until stopped.

    After its last step the bench stands still and goes on answering. Raises `ValueError`: unknown
    scenario, rate that is not positive, port in use, truth file not writable.

    Same `seed`, same run: noise and ambient depend on process time only. `truth` is a CSV file for
    the true temperatures of all nodes. With `wait_for_start` it stands still until a client sets
    the controller's start coil. `announce` is called once, when both ports listen.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise ValueError(f"rate {rate!r}: expected a positive number")
    if seed < 0:
        raise ValueError(f"seed {seed!r}: expected a whole number not below 0")
    if specimen is not None and specimen < 0:
        raise ValueError(f"specimen {specimen!r}: expected a whole number not below 0")
    plan = find_scenario(scenario) if isinstance(scenario, str) else scenario
    parameters = None if specimen is None else random_bench(specimen, plan.bearing)
    truth_file = None if truth is None else TruthFile(truth, TRUTH_COLUMNS)
    try:
        # the compiler's first run must not eat process time
        await asyncio.to_thread(LiveBench(plan, seed, parameters).advance, 1.0)
        await _serve(
            plan,
            parameters,
            rate,
            seed,
            host,
            modbus_port,
            can_port,
            truth_file,
            wait_for_start,
            announce,
            stop,
        )
    finally:
        if truth_file is not None:
            truth_file.close()


async def _serve(
    plan: Scenario,
    parameters: BenchParameters | None,
    rate: float,
    seed: int,
    host: str,
    modbus_port: int,
    can_port: int,
    truth_file: TruthFile | None,
    wait_for_start: bool,
    announce: Callable[[BenchAnnouncement], None],
    stop: asyncio.Event,
) -> None:
    bench = LiveBench(plan, seed, parameters)
    origin: float | None = None
    wall_start_us = 0

    def begin() -> None:
        nonlocal origin, wall_start_us
        if origin is None:
            origin, wall_start_us = time.monotonic(), time.time_ns() // 1000

    def now_s() -> float:
        return 0.0 if origin is None else (time.monotonic() - origin) * rate

    modbus = BenchModbusServer(bench, now_s, begin)
    can = BenchCanSender(bench)
    try:
        modbus_host, modbus_at = await modbus.start(host, modbus_port)
        can_host, can_at = await can.start(host, can_port)
        bracketed = f"[{can_host}]" if ":" in can_host else can_host
        if not wait_for_start:
            begin()
        announce(
            {
                "modbus": {"host": modbus_host, "port": modbus_at},
                "can": {
                    "host": can_host,
                    "port": can_at,
                    "channel": f"socket://{bracketed}:{can_at}",
                },
                "scenario": plan.name,
                "bearing": plan.bearing,
                "rate": rate,
                "seed": seed,
            }
        )
        period = max(CAN_PERIOD_S / rate, _SHORTEST_PERIOD_S)
        due = time.monotonic()
        while not stop.is_set():
            bench.advance(now_s())
            can.send_frames()
            if origin is not None:  # before the start no wall time belongs to the first row
                rows = bench.take_truth()
                if truth_file is not None:
                    truth_file.write(rows, wall_start_us, rate)
            # after a hiccup the beat goes on from now; the plant has caught up above
            due = max(due + period, time.monotonic() - period)
            await wait(stop, due - time.monotonic())
    finally:
        await can.stop()
        await modbus.stop()


async def wait(stop: asyncio.Event, seconds: float) -> None:
    """Wait some wall seconds, or until the end."""
    try:
        async with asyncio.timeout(max(seconds, 0.0)):
            await stop.wait()
    except TimeoutError:
        return
