"""The virtual bench as a running process: real time, real sockets."""

import asyncio
import csv
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from adapters.virtual_bench.can_sender import BenchCanSender
from adapters.virtual_bench.live import TRUTH_COLUMNS, LiveBench
from adapters.virtual_bench.modbus_server import BenchModbusServer
from adapters.virtual_bench.scenarios import Scenario, find_scenario

CAN_PERIOD_S = 0.05  # process time: 20 frames per second and message at rate 1
_SHORTEST_PERIOD_S = 0.01  # wall time


class _TruthFile:
    """CSV of the true temperatures, one row per 10 s of process time, flushed as it is written."""

    def __init__(self, path: Path) -> None:
        try:
            self._file: TextIO = path.open("w", newline="")
        except OSError as error:
            reason = error.strerror or str(error)
            raise ValueError(f"truth {str(path)!r}: cannot be written: {reason}") from error
        self._writer = csv.writer(self._file)
        self._writer.writerow([*TRUTH_COLUMNS, "wall_time_us"])

    def write(self, rows: list[tuple[float, ...]], wall_start_us: int, rate: float) -> None:
        if not rows:
            return
        for row in rows:
            wall_us = wall_start_us + round(row[0] / rate * 1e6)
            self._writer.writerow([*(f"{value:.4f}" for value in row), wall_us])
        self._file.flush()

    def close(self) -> None:
        self._file.close()


async def run(
    scenario: str | Scenario,
    *,
    rate: float = 1.0,
    seed: int = 0,
    host: str = "127.0.0.1",
    modbus_port: int = 5020,
    can_port: int = 5021,
    truth: Path | None = None,
    wait_for_start: bool = False,
    announce: Callable[[dict[str, Any]], None],
    stop: asyncio.Event,
) -> None:
    """Run a scenario until told to stop.

    After its last step the bench stands still and goes on answering.

    Parameters
    ----------
    scenario : str or Scenario
        What is run.
    rate : float
        Process seconds per wall second.
    seed : int
        Same seed, same run: noise and ambient depend on process time only.
    host : str
        Address to listen on.
    modbus_port, can_port : int
        Ports; 0 takes a free one.
    truth : pathlib.Path, optional
        CSV file for the true temperatures of all nodes.
    wait_for_start : bool
        Stand still until a client sets the controller's start coil.
    announce : callable
        Called once, when both ports listen, with the addresses.
    stop : asyncio.Event
        Ends the run.

    Raises
    ------
    ValueError
        Unknown scenario, rate that is not positive, port in use, truth file not writable.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise ValueError(f"rate {rate!r}: expected a positive number")
    if seed < 0:
        raise ValueError(f"seed {seed!r}: expected a whole number not below 0")
    plan = find_scenario(scenario) if isinstance(scenario, str) else scenario
    truth_file = None if truth is None else _TruthFile(truth)
    try:
        # the compiler's first run must not eat process time
        await asyncio.to_thread(LiveBench(plan, seed).advance, 1.0)
        await _serve(
            plan,
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
    rate: float,
    seed: int,
    host: str,
    modbus_port: int,
    can_port: int,
    truth_file: _TruthFile | None,
    wait_for_start: bool,
    announce: Callable[[dict[str, Any]], None],
    stop: asyncio.Event,
) -> None:
    bench = LiveBench(plan, seed)
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
            await _wait(stop, due - time.monotonic())
    finally:
        await can.stop()
        await modbus.stop()


async def _wait(stop: asyncio.Event, seconds: float) -> None:
    try:
        async with asyncio.timeout(max(seconds, 0.0)):
            await stop.wait()
    except TimeoutError:
        return
