"""A fleet of virtual benches as a running process: real time, real sockets."""

import asyncio
import math
import time
from collections.abc import Callable
from pathlib import Path

from adapters.virtual_bench.announcements import FleetAnnouncement
from adapters.virtual_bench.fleet import BEARING, TRUTH_COLUMNS, BenchFleet
from adapters.virtual_bench.fleet_server import UNITS, FleetModbusServer
from adapters.virtual_bench.run import wait
from adapters.virtual_bench.truth_file import TruthFile

#: More would not keep up with real time.
MOST_BENCHES = 10_000
_BEAT_S = 0.25  # wall time


async def run_fleet(
    benches: int,
    *,
    rate: float = 1.0,
    seed: int = 0,
    host: str = "127.0.0.1",
    modbus_port: int = 5020,
    gateways: int | None = None,
    truth: Path | None = None,
    announce: Callable[[FleetAnnouncement], None],
    stop: asyncio.Event,
) -> None:
    """Run many benches until stopped.

    Raises `ValueError`: wrong number of benches or gateways, rate that is not positive, port in
    use, truth file not writable.

    Same `seed`, same run. `modbus_port` is the first; 0 takes free ones. The benches are spread
    evenly over so many `gateways` at most; by default as few as do. `truth` is a CSV file for the
    true temperatures of all benches, once a minute. `announce` is called when all ports listen.
    """
    if not 1 <= benches <= MOST_BENCHES:
        raise ValueError(f"benches {benches!r}: expected a whole number from 1 to {MOST_BENCHES}")
    fewest = math.ceil(benches / UNITS)
    if gateways is not None and not fewest <= gateways <= benches:
        raise ValueError(
            f"gateways {gateways!r}: expected a whole number from {fewest} to {benches}, "
            f"as one has {UNITS} units at most"
        )
    if not (math.isfinite(rate) and rate > 0.0):
        raise ValueError(f"rate {rate!r}: expected a positive number")
    if seed < 0:
        raise ValueError(f"seed {seed!r}: expected a whole number not below 0")
    # The compiler's first run must not eat process time.
    await asyncio.to_thread(BenchFleet(1, seed).advance, 2.0)
    fleet = await asyncio.to_thread(BenchFleet, benches, seed)
    truth_file = None if truth is None else TruthFile(truth, TRUTH_COLUMNS)
    origin, wall_start_us = time.monotonic(), time.time_ns() // 1000

    def now_s() -> float:
        return (time.monotonic() - origin) * rate

    units = UNITS if gateways is None else math.ceil(benches / gateways)
    server = FleetModbusServer(fleet, now_s, units)
    try:
        ports = await server.start(host, modbus_port)
        announce(
            {
                "modbus": [
                    {"host": at, "port": port, "units": min(units, benches - number * units)}
                    for number, (at, port) in enumerate(ports)
                ],
                "benches": benches,
                "bearing": BEARING,
                "rate": rate,
                "seed": seed,
            }
        )
        while not stop.is_set():
            fleet.advance(now_s())
            rows = fleet.take_truth()
            if truth_file is not None and rows:
                truth_file.write(rows, wall_start_us, rate)
            await wait(stop, _BEAT_S)
    finally:
        await server.stop()
        if truth_file is not None:
            truth_file.close()
