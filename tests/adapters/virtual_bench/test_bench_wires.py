"""The bench on real sockets, read by clients that are not ours."""

import asyncio
import csv
import itertools
import json
import math
import re
import signal
import socket
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import can
import can.interfaces.slcan
import cantools
import pytest
from patience import patience, wait_for
from programs import needed
from pyModbusTCP.client import ModbusClient  # type: ignore[import-untyped]

from adapters.virtual_bench import PortInUseError, UnknownScenarioError, dbc_path, run
from adapters.virtual_bench.can_sender import BenchCanSender
from adapters.virtual_bench.live import LiveBench
from adapters.virtual_bench.scenarios import find_scenario

from .running_bench import polled_bench, running_bench

pytestmark = pytest.mark.wires

PATIENCE_S = 30.0


def _client(where: dict[str, Any], unit: int) -> ModbusClient:
    return ModbusClient(
        where["modbus"]["host"], where["modbus"]["port"], unit_id=unit, timeout=patience(PATIENCE_S)
    )


def _until(holds: Callable[[], Any], what: str) -> None:
    """Wait in a thread."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end, what
        time.sleep(0.02)


def _rows_of(truth: Path) -> int:
    return len(truth.read_text().splitlines()) if truth.exists() else 0


def _read(client: ModbusClient, holding: bool, address: int, count: int) -> list[int]:
    read: Callable[[int, int], list[int] | None] = (
        client.read_holding_registers if holding else client.read_input_registers
    )
    registers = read(address, count)
    assert registers is not None, client.last_error_as_txt
    return registers


def _plan(registers: Sequence[int]) -> list[tuple[int, float, float]]:
    raw = struct.pack(f">{len(registers)}H", *registers)
    return [row for row in struct.iter_unpack(">Iff", raw) if row[0]]


async def test_transmitters_and_controller_are_read_by_a_foreign_client() -> None:
    async with running_bench("demo", rate=1.0) as where:

        def look() -> None:
            transmitter, controller = _client(where, 1), _client(where, 2)
            values = _read(transmitter, False, 0, 3)
            assert all(210 <= value <= 245 for value in values)  # 0.1 degC, near ambient
            assert _read(transmitter, False, 10, 3) == [0, 0, 0]
            head = struct.pack(">10H", *_read(controller, True, 0, 10))
            phase, state, speed, load, left, elapsed = struct.unpack(">HHffII", head)
            assert (phase, state, speed, load) == (1, 0, 0.0, 2650.0)
            assert left + elapsed in (179, 180)
            plan = _plan(_read(controller, True, 100, 96))
            assert len(plan) == 10
            assert plan[1] == (3300, 1500.0, 2650.0)
            assert plan[8] == (4500, 6200.0, 5500.0)
            transmitter.close()
            controller.close()

        await asyncio.to_thread(look)


async def test_wrong_requests_get_the_exceptions_of_a_real_device() -> None:
    async with running_bench("demo", rate=1.0) as where:

        def look() -> None:
            for unit, method, arguments, expected in (
                (1, "read_holding_registers", (0, 1), 1),
                (1, "read_coils", (0, 1), 1),
                (1, "read_input_registers", (3, 1), 2),
                (1, "read_input_registers", (500, 1), 2),
                (2, "read_input_registers", (0, 1), 1),
                (2, "write_single_register", (0, 5), 1),
                (2, "read_holding_registers", (190, 10), 2),
                (7, "read_holding_registers", (0, 1), 11),
            ):
                client = _client(where, unit)
                assert not getattr(client, method)(*arguments)
                assert client.last_except == expected
                client.close()

        await asyncio.to_thread(look)


async def test_planned_profile_counts_down_and_is_never_torn() -> None:
    async with polled_bench("rapid-acceleration", itertools.count(0.0, 61.0).__next__) as where:

        def look() -> None:
            controller = _client(where, 2)
            previous = math.inf
            phases: set[int] = set()
            while len(phases) < 3:
                # head and plan in two reads cannot be one moment, so the plan is checked by itself
                plan = _plan(_read(controller, True, 100, 96))
                total = sum(row[0] for row in plan)
                assert total <= previous  # the whole rest shrinks, also across a change of phase
                assert plan[-1] == (2700, 6200.0, 2650.0) or len(plan) == 1
                previous = total
                phases.add(len(plan))
            assert phases == {6, 5, 4}
            controller.close()

        await asyncio.to_thread(look)


async def test_wire_break_and_over_range_show_their_codes() -> None:
    moments = itertools.count(0.0, 20.0)
    async with polled_bench("sensor-break", moments.__next__) as where:

        def look() -> set[tuple[int, int, int]]:
            transmitter = _client(where, 1)
            seen = set()
            for _ in range(40):  # minutes of the run
                registers = _read(transmitter, False, 0, 3), _read(transmitter, False, 10, 3)
                again = _read(transmitter, False, 0, 3)
                for index, (raw, word) in enumerate(zip(*registers, strict=True)):
                    if word and raw == again[index]:
                        seen.add((index, raw, word))
            transmitter.close()
            return seen

        seen = await asyncio.to_thread(look)
    assert {(0, 0x8000, 1), (1, 0x7FFF, 4), (2, 0x7FFF, 4)} <= seen


async def test_mbpoll_reads_the_bench() -> None:
    mbpoll = needed("mbpoll")
    async with running_bench("demo", rate=1.0) as where:
        process = await asyncio.create_subprocess_exec(
            mbpoll, "-m", "tcp", "-a", "1", "-0", "-r", "0", "-c", "3", "-t", "3", "-1",
            "-p", str(where["modbus"]["port"]), where["modbus"]["host"],
            stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        output, _ = await process.communicate()
        assert process.returncode == 0
        values = [int(raw) for raw in re.findall(r"^\[\d+\]:\s+(\d+)", output.decode(), re.M)]
    assert len(values) == 3
    assert all(210 <= value <= 245 for value in values)


async def test_python_can_logger_records_both_messages(tmp_path: Path) -> None:
    log = tmp_path / "frames.asc"
    async with running_bench("staircase", rate=60.0) as where:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "can.logger", "-i", "slcan", "-c", where["can"]["channel"],
            "-b", "500000", "--sleep-after-open=0.1", "-f", str(log),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            # Past three minutes of rest; 1400 lines are 700 frames of each message.
            await asyncio.to_thread(_until, lambda: _rows_of(log) > 1400, "frames in the log")
            process.send_signal(signal.SIGINT)
            _, errors = await wait_for(process.communicate(), PATIENCE_S)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
    assert log.exists(), errors.decode()
    database: Any = cantools.database.load_file(dbc_path())
    with can.LogReader(log) as reader:
        frames = list(reader)
    counts = Counter(frame.arbitration_id for frame in frames)
    assert set(counts) == {0x120, 0x130}
    assert max(counts.values()) - min(counts.values()) <= 2
    decoded = [database.decode_message(f.arbitration_id, f.data) for f in frames[-20:]]
    speeds = [signals["Speed"] for signals in decoded if "Speed" in signals]
    loads = [signals["RadialLoad"] for signals in decoded if "RadialLoad" in signals]
    states = {str(signals["State"]) for signals in decoded if "State" in signals}
    assert all(abs(speed - 1500.0) < 6.0 for speed in speeds)
    assert all(abs(load - 2650.0) < 60.0 for load in loads)
    assert states == {"running"}


async def test_frames_come_at_the_pace_of_the_process_to_several_clients() -> None:
    async with running_bench("demo", rate=1.0) as where:

        def listen() -> Counter[int]:
            count: Counter[int] = Counter()
            channel = where["can"]["channel"]
            with can.Bus(
                interface="slcan", channel=channel, bitrate=500000, sleep_after_open=0.0
            ) as bus:
                assert isinstance(bus, can.interfaces.slcan.slcanBus)
                assert bus.get_version(timeout=patience(PATIENCE_S)) == (10, 13)
                began = time.monotonic()
                while min(count[0x120], count[0x130]) < 30:
                    frame = bus.recv(timeout=patience(PATIENCE_S))
                    assert frame is not None
                    count[frame.arbitration_id] += 1
                assert time.monotonic() - began > 0.5  # twenty a second; not as fast as can be
            return count

        counts = await asyncio.gather(asyncio.to_thread(listen), asyncio.to_thread(listen))
    for count in counts:
        assert abs(count[0x120] - count[0x130]) <= 1


async def _slcan(where: dict[str, Any], commands: bytes, wanted: bytes) -> bytes:
    reader, writer = await asyncio.open_connection(where["can"]["host"], where["can"]["port"])
    writer.write(commands)
    answer = await wait_for(reader.readuntil(wanted), PATIENCE_S)
    writer.close()
    await writer.wait_closed()
    return answer


async def test_slcan_commands_are_answered_like_an_adapter() -> None:
    async with running_bench("demo", rate=1.0) as where:
        assert await _slcan(where, b"V\r", b"\r") == b"V1013\r"
        assert await _slcan(where, b"N\r", b"\r") == b"NBT01\r"
        assert await _slcan(where, b"C\rS6\r", b"\r\r") == b"\r\r"
        assert await _slcan(where, b"S\r", b"\a") == b"\a"
        assert await _slcan(where, b"t1230\r", b"\a") == b"\a"  # channel closed
        assert await _slcan(where, b"nonsense\r", b"\a") == b"\a"
        assert await _slcan(where, b"x" * 500, b"\a") == b"\a"
        opened = await _slcan(where, b"O\rt1230\r", b"t1308")
        assert opened.startswith(b"\rz\r")
        assert b"t1208" in opened


async def test_not_available_signal_is_all_ones() -> None:
    bench = LiveBench(find_scenario("sensor-break"), 0)
    sender = BenchCanSender(bench)
    host, port = await sender.start("127.0.0.1", 0)
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(b"O\r")
    assert await reader.readexactly(1) == b"\r"
    seen = {}
    for minute in (5.0, 41.0, 49.0):
        bench.advance(60.0 * minute)
        sender.send_frames()
        drive = await reader.readuntil(b"\r")
        load = await reader.readuntil(b"\r")
        seen[minute] = (drive[5:9], load[5:9])
    writer.close()
    await writer.wait_closed()
    await sender.stop()
    assert b"FFFF" not in seen[5.0]
    assert seen[41.0][1] == b"FFFF"
    assert seen[41.0][0] != b"FFFF"
    assert seen[49.0][0] == b"FFFF"
    assert seen[49.0][1] != b"FFFF"


async def test_client_that_does_not_read_is_dropped_and_others_go_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = LiveBench(find_scenario("demo"), 0)
    sender = BenchCanSender(bench)
    host, port = await sender.start("127.0.0.1", 0)
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.connect((host, port))
    deaf.sendall(b"O\r")
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(b"O\r")
    assert await reader.readexactly(1) == b"\r"
    await asyncio.sleep(0.1)
    received, sent = 0, 0
    while "dropped" not in caplog.text:
        sender.send_frames()
        sent += 1
        received += len(await reader.readexactly(2 * 22))
        assert sent < 50_000
    assert received == sent * 44
    assert "does not read" in caplog.text
    deaf.close()
    writer.close()
    await writer.wait_closed()
    await sender.stop()


async def test_truth_is_written_while_the_bench_runs(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    async with running_bench("demo", rate=600.0, truth=truth):
        await asyncio.to_thread(_until, lambda: _rows_of(truth) > 32, "rows of truth")
        with truth.open(newline="") as file:
            running = list(csv.DictReader(file))
        assert len(running) > 30
    with truth.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time_s"]) for row in rows] == [10.0 * k for k in range(len(rows))]
    assert {f"t_node_{number}_c" for number in range(1, 14)} <= set(rows[0])
    assert float(rows[-1]["t_inner_ring_c"]) > float(rows[0]["t_inner_ring_c"])
    spacing = int(rows[2]["wall_time_us"]) - int(rows[1]["wall_time_us"])
    assert spacing == pytest.approx(10.0 / 600.0 * 1e6, abs=2)


async def test_two_runs_of_one_seed_write_the_same_truth(tmp_path: Path) -> None:
    texts = []
    for name in ("first", "second"):
        truth = tmp_path / f"{name}.csv"
        async with running_bench("demo", rate=3000.0, truth=truth, seed=4):
            await asyncio.to_thread(_until, lambda file=truth: _rows_of(file) > 50, "rows")
        lines = truth.read_text().splitlines()
        texts.append([line.rsplit(",", 1)[0] for line in lines[:50]])  # without the wall clock
    assert texts[0] == texts[1]
    assert len(texts[0]) == 50


async def _start(**options: Any) -> None:
    await run(
        options.pop("scenario", "demo"),
        announce=lambda where: None,
        stop=asyncio.Event(),
        **{"modbus_port": 0, "can_port": 0, **options},
    )


@pytest.mark.parametrize("option", ["modbus_port", "can_port"])
async def test_port_in_use_is_one_clear_line(
    option: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortInUseError) as caught:
            await _start(**{option: port})
    name = option.replace("_", " ")
    assert str(caught.value) == f"{name} 127.0.0.1:{port}: cannot listen: Address already in use"
    assert capfd.readouterr().err == ""


async def test_bad_input_names_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(UnknownScenarioError, match="nothing"):
        await _start(scenario="nothing")
    with pytest.raises(ValueError, match=r"rate -1\.0"):
        await _start(rate=-1.0)
    with pytest.raises(ValueError, match="seed -3"):
        await _start(seed=-3)
    missing = tmp_path / "no" / "truth.csv"
    with pytest.raises(ValueError, match=r"truth .*No such file"):
        await _start(truth=missing)
    with pytest.raises(PortInUseError, match=r"modbus port 203\.0\.113\.9:0"):
        await _start(host="203.0.113.9")


async def test_bench_waits_for_its_start_button(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    async with running_bench("demo", rate=600.0, truth=truth, wait_for_start=True) as where:

        def elapsed(controller: ModbusClient) -> int:
            high, low = _read(controller, True, 8, 2)
            return high << 16 | low

        def look() -> None:
            controller = _client(where, 2)
            time.sleep(0.3)
            assert elapsed(controller) == 0
            assert not controller.write_single_coil(2, True)  # there are two buttons only
            controller.write_single_coil(0, False)
            time.sleep(0.1)
            assert elapsed(controller) == 0
            assert controller.write_single_coil(0, True)
            _until(lambda: elapsed(controller) >= 180, "three minutes of the run")
            first = elapsed(controller)
            assert controller.write_single_coil(0, True)  # pressing again starts nothing over
            assert elapsed(controller) >= first
            controller.close()

        ready_us = time.time_ns() // 1000
        await asyncio.to_thread(look)
    with truth.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["time_s"]) == 0.0
    assert int(rows[0]["wall_time_us"]) >= ready_us + 400_000


async def test_hold_button_delays_the_high_risk_step_until_it_is_released() -> None:
    process_s = 0.0
    async with polled_bench("rapid-acceleration", lambda: process_s) as where:

        def look() -> None:
            nonlocal process_s
            controller = _client(where, 2)
            assert controller.write_single_coil(1, True)
            for second in range(0, 600, 7):
                process_s = float(second)
                assert _read(controller, True, 0, 1) == [1]
            assert _plan(_read(controller, True, 100, 96))[0][0] in (1, 2)
            assert controller.write_single_coil(1, False)
            process_s += 3.0
            assert _read(controller, True, 0, 1) == [2]
            assert _plan(_read(controller, True, 100, 96))[0][0] in range(3590, 3601)
            # the next high-risk step is not held, now that the button is released
            process_s += 3600.0 + 1200.0
            assert _read(controller, True, 0, 1) == [4]
            controller.close()

        await asyncio.to_thread(look)


async def test_host_name_listens_on_one_address() -> None:
    async with running_bench("demo", rate=1.0, host="localhost") as where:
        assert where["modbus"]["host"] == where["can"]["host"]
        values = await asyncio.to_thread(_read, _client(where, 1), False, 0, 3)
        assert len(values) == 3
        version = await _slcan(where, b"V\r", b"\r")
    assert version == b"V1013\r"


async def test_stopping_frees_the_ports_at_once() -> None:
    async with running_bench("demo", rate=1.0) as where:
        reader, writer = await asyncio.open_connection("127.0.0.1", where["can"]["port"])
        writer.write(b"O\r")
        await reader.readuntil(b"t1308")
    writer.close()
    for port in (where["modbus"]["port"], where["can"]["port"]):
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=patience(5.0))
    assert json.dumps(where)  # what is announced is plain JSON
