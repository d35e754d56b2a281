"""Many virtual benches in one process: each another one, all on one port, cheap."""

import asyncio
import csv
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import patience, within
from processes import wait_until
from pymodbus.client import AsyncModbusTcpClient

from adapters.virtual_bench import (
    BenchParameters,
    BenchProfile,
    PortInUseError,
    run_fleet,
    simulate,
)
from adapters.virtual_bench.fleet import BenchFleet, Duty
from adapters.virtual_bench.fleet_server import COUNTER_ADDRESS, UNITS
from adapters.virtual_bench.live import LiveBench
from adapters.virtual_bench.scenarios import find_scenario

pytestmark = pytest.mark.wires

PATIENCE_S = 30.0


def _registers(fleet: BenchFleet, bench: int) -> tuple[int, ...]:
    return struct.unpack(">3h2HI", fleet.row(bench))


@asynccontextmanager
async def _fleet(benches: int, **options: Any) -> AsyncIterator[dict[str, Any]]:
    announced: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
    stop = asyncio.Event()
    task = asyncio.create_task(
        run_fleet(benches, modbus_port=0, announce=announced.set_result, stop=stop, **options)
    )
    task.add_done_callback(lambda _: announced.done() or announced.cancel())
    try:
        yield await announced
    finally:
        stop.set()
        async with within(PATIENCE_S):
            await task


@asynccontextmanager
async def _client(port: int) -> AsyncIterator[AsyncModbusTcpClient]:
    client = AsyncModbusTcpClient("127.0.0.1", port=port, timeout=patience(PATIENCE_S))
    try:
        assert await client.connect()
        yield client
    finally:
        client.close()


async def test_benches_are_spread_over_gateways() -> None:
    async with _fleet(7, gateways=3) as facts:
        assert [one["units"] for one in facts["modbus"]] == [3, 3, 1]
        async with _client(facts["modbus"][2]["port"]) as client:
            assert not (await client.read_input_registers(0, count=3, device_id=1)).isError()
            assert (await client.read_input_registers(0, count=3, device_id=2)).isError()


def test_same_seed_gives_the_same_whenever_it_is_advanced() -> None:
    often, once = BenchFleet(23, 4), BenchFleet(23, 4)
    for second in range(0, 1801, 7):
        often.advance(second)
    often.advance(1800.9)
    once.advance(1800.0)
    rows = [_registers(once, bench) for bench in range(23)]
    assert rows == [_registers(often, bench) for bench in range(23)]
    assert {row[-1] for row in rows} == {1800}
    assert len(set(rows)) == 23
    assert rows != [_registers(BenchFleet(23, 5), bench) for bench in range(23)]
    assert once.take_truth() == often.take_truth()


def test_begins_at_standstill_in_its_own_air() -> None:
    fleet = BenchFleet(40, 1)
    inner, outer, ambient, speed, load, second = zip(
        *(_registers(fleet, bench) for bench in range(40)), strict=True
    )
    assert inner == outer == ambient
    assert set(speed) == set(load) == set(second) == {0}
    assert all(180 <= one <= 280 for one in ambient)
    assert len(set(ambient)) > 10


def test_true_temperatures_are_those_of_a_single_bench() -> None:
    """Duty and air of one bench, simulated alone, give what it showed among the others."""
    seed, bench, minutes = 3, 12, 60
    fleet = BenchFleet(15, seed)
    fleet.advance(60.0 * minutes + 30.0)
    rows = [row for row in fleet.take_truth() if row[1] == bench and row[0] <= 60.0 * minutes]
    assert len(rows) == minutes
    time_s = np.arange(60.0 * minutes + 1.0)
    speed, load = Duty(seed, 15).true_point(np.array([bench]), time_s + 0.5)
    ambient_c = fleet._ambient(np.array([bench]), time_s)[0]
    parameters = BenchParameters.random(seed * 100_003 + bench)
    truth = simulate(BenchProfile(time_s, speed[0], load[0], ambient_c), parameters)
    for row in rows:
        at = int(row[0])
        assert row[5] == pytest.approx(truth.t_inner_ring_c[at], abs=1e-9)
        assert row[6] == pytest.approx(truth.t_outer_ring_c[at], abs=1e-9)
        assert row[7:] == pytest.approx(truth.paper_nodes_c[at], abs=1e-9)
    assert rows[-1][5] > rows[0][5] + 5.0


def test_duty_stays_in_the_low_risk_region_and_ramps() -> None:
    time_s = np.arange(0.0, 8 * 3600.0)
    speed, load = Duty(9, 30).true_point(np.arange(30), time_s)
    assert speed[:, 0].max() == 0.0
    assert speed.max() <= 4200.0
    assert speed[:, 60:].min() >= 1500.0
    assert load.min() >= 2000.0
    assert load.max() <= 3300.0
    assert np.abs(np.diff(speed, axis=1)).max() <= 100.0 + 1e-9
    assert np.abs(np.diff(load, axis=1)).max() <= 200.0 + 1e-9
    assert (np.ptp(speed[:, 7200:], axis=1) > 100.0).all()


def test_readings_are_those_of_sensors() -> None:
    """What is read follows the truth within lag, offset, drift and noise, in whole steps."""
    fleet = BenchFleet(30, 2)
    fleet.advance(1801.0 + 9)  # every bench has passed its own full minute
    truth = {int(row[1]): row for row in fleet.take_truth() if row[0] >= 1740.0}
    differences = []
    for bench, row in truth.items():
        inner, outer, ambient, speed, load, _ = _registers(fleet, bench)
        differences += [0.1 * inner - row[5], 0.1 * outer - row[6], 0.1 * ambient - row[4]]
        assert abs(0.25 * speed - row[2]) < 800.0
        assert 1900.0 < 0.25 * load < 3400.0
    assert np.abs(differences).max() < 1.5
    assert 0.03 < np.std(differences) < 0.5


async def test_every_bench_is_a_unit_and_counts_its_answers() -> None:
    async with _fleet(UNITS + 2) as facts:
        first, second = facts["modbus"]
        assert (first["units"], second["units"]) == (UNITS, 2)
        async with _client(first["port"]) as client, _client(second["port"]) as other:
            seen = set()
            for unit in (1, 2, UNITS):
                answer = await client.read_input_registers(0, count=7, device_id=unit)
                assert not answer.isError()
                seen.add(tuple(answer.registers[:3]))
            answer = await other.read_input_registers(0, count=5, device_id=2)
            seen.add(tuple(answer.registers[:3]))
            assert len(seen) == 4
            for asked, unit, count in ((client, 1, 1), (client, 3, 0), (other, 2, 1)):
                counted = await asked.read_input_registers(COUNTER_ADDRESS, count=2, device_id=unit)
                assert counted.registers == [0, count]


async def test_wrong_requests_are_refused_and_other_clients_go_on() -> None:
    async with _fleet(2) as facts:
        port = facts["modbus"][0]["port"]
        async with _client(port) as client:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"GET / HTTP/1.1\r\n\r\n")
            async with within(PATIENCE_S):
                assert await reader.read() == b""
            writer.close()
            for function, address, count, unit, code in (
                ("input", 0, 1, 3, 0x0B),
                ("input", 0, 1, 0, 0x0B),
                ("holding", 0, 1, 1, 1),
                ("input", 4, 4, 1, 2),
                ("input", 400, 1, 1, 2),
            ):
                read = (
                    client.read_input_registers
                    if function == "input"
                    else client.read_holding_registers
                )
                answer = await read(address, count=count, device_id=unit)
                assert answer.exception_code == code, (function, address, unit)
            answer = await client.read_input_registers(0, count=7, device_id=2)
            assert len(answer.registers) == 7


async def test_truth_file_has_a_row_per_bench_and_minute(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    async with _fleet(12, truth=path, rate=600.0):
        await asyncio.to_thread(
            wait_until, lambda: path.read_text().count("\n") >= 60, PATIENCE_S, "60 rows"
        )
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert {row["bench"] for row in rows} == {f"{bench}.0000" for bench in range(12)}
    times = [float(row["time_s"]) for row in rows if row["bench"] == "3.0000"]
    assert np.diff(times) == pytest.approx(60.0)


async def test_bad_arguments_name_what_is_wrong() -> None:
    for options, message in (
        ({"benches": 0}, "benches 0: expected a whole number from 1"),
        ({"benches": 1, "rate": 0.0}, "rate 0.0: expected a positive number"),
        ({"benches": 1, "seed": -1}, "seed -1: expected"),
        ({"benches": 300, "gateways": 1}, "gateways 1: expected a whole number from 2 to 300"),
    ):
        with pytest.raises(ValueError, match=message):
            await run_fleet(modbus_port=0, announce=print, stop=asyncio.Event(), **options)
    async with _fleet(1) as facts:
        with pytest.raises(PortInUseError, match="cannot listen"):
            await run_fleet(
                1,
                modbus_port=facts["modbus"][0]["port"],
                announce=print,
                stop=asyncio.Event(),
            )


def test_a_bench_of_many_costs_a_tenth_of_a_single_one() -> None:
    """Processor time per bench and second, both in the same run."""

    def seconds(bench: BenchFleet | LiveBench) -> float:
        bench.advance(20.0)
        begin = time.process_time()
        for second in range(21, 61):
            bench.advance(second)
        return time.process_time() - begin

    # By turns and each for a moment: what else the machine does disturbs both alike.
    pairs = [
        (seconds(LiveBench(find_scenario("staircase"), 0)), seconds(BenchFleet(200, 0)))
        for _ in range(12)
    ]
    single, many = map(min, zip(*pairs, strict=True))
    assert many / 200 < single / 10
