"""The CAN driver against an adapter in another process."""

import asyncio
import logging
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from adapters.samples import Quality

pytestmark = pytest.mark.wires

GOOD = int(Quality.GOOD)
COMM = int(Quality.COMM_FAILURE)
DBC = Path(__file__).parents[2] / "adapters" / "bench.dbc"
CHANNELS: dict[str, dict[str, Any]] = {
    "speed_rpm": {"message": "DriveStatus", "signal": "Speed"},
    "load_n": {"message": "LoadCell", "signal": "RadialLoad"},
}


@pytest.fixture
def source(free_port: int) -> dict[str, Any]:
    return {
        "driver": "can",
        "interface": "slcan",
        "channel": f"socket://127.0.0.1:{free_port}",
        "dbc": str(DBC),
        "bitrate": 500000,
    }


def listening_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("can-")]


async def test_frames_become_samples_in_order(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    peer("slcan_adapter.py", free_port, 0.01).start()
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: len(record.of("load_n")) >= 60)
        assert set(record.qualities("speed_rpm")) == {GOOD}
        speeds = [sample.value for sample in record.of("speed_rpm")[1:50]]
        assert speeds == [1000.0 + 0.125 * n for n in range(49)]
        assert {sample.value for sample in record.of("load_n")} == {2650.0}
        health = record.driver.health()
        assert (health.up, health.detail, health.errors) == (True, "ok", {})
        assert listening_threads() == ["can-s"]
    assert listening_threads() == []


async def test_no_doubtful_frame_becomes_a_good_value(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    adapter = peer("slcan_adapter.py", free_port, 0.01)
    adapter.start()
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: len(record.samples) > 4)
        await asyncio.to_thread(adapter.pause)
        adapter.tell("line t1008" + "8283" + "00" * 6)  # the last good one
        await record.until(lambda: record.samples[-1].value == 4208.25)
        before = len(record.samples)
        errors = {}
        for line, error in [
            ("t1008FFFF000000000000", "not_available"),
            ("T18FEF1008FFFE000000000000", "outside_dbc_limits"),
            ("t100110", "wrong_length"),
            ("t1238" + "00" * 8, "unknown_id"),
            # the standard frame 0x100 must not be taken for the extended one
            ("T000001008" + "00" * 8, "unknown_id"),
            ("r1008", "remote_frame"),
            ("t10", "garbage"),
            ("t1008ZZ", "garbage"),
            (r"t100\xff\xfe\x80", "garbage"),
        ]:
            errors[error] = errors.get(error, 0) + 1
            adapter.tell(f"line {line}")
        await record.until(lambda: record.driver.health().errors == errors)
        await record.until(lambda: len(record.samples) == before + 3)
        assert [(s.channel, s.quality) for s in record.samples[before:]] == [
            ("speed_rpm", Quality.SENSOR_FAILURE),
            ("load_n", Quality.SENSOR_FAILURE),
            ("speed_rpm", COMM),
        ]
        adapter.tell("line t1008" + "8083" + "00" * 6)
        await record.until(lambda: record.samples[-1].value == 4208.0)
        # far more than a message takes, in however many pieces
        adapter.tell("line " + "A" * 5000)
        await record.until(lambda: record.driver.health().errors["garbage"] > errors["garbage"])
        adapter.tell("line t1008" + "8183" + "00" * 6)
        await record.until(lambda: record.samples[-1].value > 4208.0)
        assert record.driver.health().reconnects == 0


async def test_a_second_sender_of_a_group_is_named_and_never_mixed_in(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    adapter = peer("slcan_adapter.py", free_port, 0.05)
    adapter.start()
    oil = {"t_node_1_c": {"message": "EngineTemperature", "signal": "Oil"}}
    own, other, third = "T18FEF000", "T18FEF02A", "T18FEF02B"
    async with drive(source, oil) as record:
        await record.until(lambda: record.driver.health().polls > 0)
        adapter.tell(f"line {other}8" + "64" + "FF" * 7)
        await record.until(lambda: record.samples)
        assert record.samples[-1].quality == Quality.WAITING_FOR_INITIAL_DATA
        adapter.tell(f"line {third}8" + "65" + "FF" * 7)
        await record.until(lambda: len(record.samples) == 2)
        assert (record.samples[-1].value, record.samples[-1].quality) == (61.0, Quality.UNCERTAIN)
        health = record.driver.health()
        assert health.detail.startswith("EngineTemperature has several senders (0x2a, 0x2b)")
        assert "several senders" in health.problems["bench/t_node_1_c"]
        adapter.tell(f"line {own}8" + "66" + "FF" * 7)
        adapter.tell(f"line {other}8" + "67" + "FF" * 7)
        await record.until(lambda: record.driver.health().errors.get("other_sender") == 1)
        await record.until(lambda: len(record.samples) == 3)
        assert (record.samples[-1].value, record.samples[-1].quality) == (62.0, GOOD)
        assert record.driver.health().problems == {}


async def test_comes_back_by_itself_from_a_killed_adapter_also_at_the_first_start(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    adapter = peer("slcan_adapter.py", free_port, 0.02)
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: len(record.samples) == 2)
        assert [s.quality for s in record.samples] == [COMM, COMM]
        await asyncio.sleep(0.5)
        assert len(record.samples) == 2  # the gap is marked once
        assert "cannot open socket://127.0.0.1" in record.driver.health().detail
        assert "refused" in record.driver.health().detail
        for restart in (1, 2):
            await asyncio.to_thread(adapter.start)
            await record.until(lambda: record.qualities("load_n")[-1] == GOOD)
            assert record.driver.health().up
            await asyncio.to_thread(adapter.kill)
            await record.until(lambda: record.qualities("load_n")[-1] == COMM)
            assert not record.driver.health().up
            for channel in CHANNELS:
                assert record.qualities(channel).count(COMM) == restart + 1
    assert record.driver.health().reconnects == 1
    assert listening_threads() == []


async def test_an_adapter_that_hangs_up_at_once_leaks_nothing_and_is_not_hammered(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    peer("slcan_adapter.py", free_port, 0.01, "hang-up").start()
    async with drive(source, CHANNELS) as record:
        descriptors = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
        began, tries = time.monotonic(), sum(record.driver.health().errors.values())
        await record.until(lambda: sum(record.driver.health().errors.values()) >= tries + 4)
        assert time.monotonic() - began > 0.6  # it waits ever longer between its tries
        assert not record.driver.health().up
        assert len(record.samples) == 2
        assert len(os.listdir("/proc/self/fd")) <= descriptors + 2  # noqa: PTH208
    assert listening_threads() == []


async def test_a_bus_that_falls_silent_shows_in_the_health_and_is_opened_anew(
    source: dict[str, Any],
    free_port: int,
    drive: Callable[..., Any],
    peer: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("adapters.drivers.can.reader.SILENCE_FIRST_S", 6.0)
    adapter = peer("slcan_adapter.py", free_port, 0.02)
    adapter.start()
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: record.driver.health().polls >= 20)
        adapter.tell("pause")
        await record.until(lambda: not record.driver.health().up)
        assert "DriveStatus: no frame for " in record.driver.health().detail
        assert COMM not in record.qualities("load_n")
        await record.until(lambda: record.driver.health().reconnects >= 1)
        assert record.qualities("load_n")[-1] == COMM
        adapter.tell("go")
        await record.until(lambda: record.driver.health().up)


async def test_samples_that_nobody_takes_are_bounded_and_the_newest_are_kept(
    source: dict[str, Any], free_port: int, peer: Callable[..., Any], drive: Callable[..., Any]
) -> None:
    adapter = peer("slcan_adapter.py", free_port, 0.05)
    adapter.start()
    async with drive(source, CHANNELS) as record:
        await record.until(lambda: record.samples)
        await asyncio.to_thread(adapter.pause)
        adapter.tell("flood 60000")
        adapter.tell("line t1008" + "8083" + "00" * 6)
        end = time.monotonic() + 60.0
        while record.driver.health().polls < 60_000 and time.monotonic() < end:
            time.sleep(0.05)  # noqa: ASYNC251  # the event loop is stuck: nobody takes anything
        await record.until(lambda: record.samples[-1].value == 4208.0)
        health = record.driver.health()
        assert 0 < health.skipped <= 10_100
        assert health.polls == len(record.samples) + health.skipped


async def test_process_time_of_the_reception_is_the_source_time(
    source: dict[str, Any], free_port: int, drive: Callable[..., Any], peer: Callable[..., Any]
) -> None:
    peer("slcan_adapter.py", free_port, 0.02).start()
    async with drive(source, CHANNELS, rate=60.0) as record:
        began_us = record.clock.now_us()
        await record.until(lambda: len(record.of("load_n")) >= 50)
        times = [sample.time_us for sample in record.of("load_n")]
        assert began_us <= times[0]
        assert times[-1] <= record.clock.now_us()
        period_s = (times[-1] - times[0]) / 1e6 / (len(times) - 1)
        assert period_s > 60.0 * 0.02 / 5  # of process time, not of the wall's
        # once a frame is older than 1.5 wall seconds it counts as stale, whatever its period
        assert record.driver.health().up


async def test_a_pseudo_terminal_is_read_like_a_serial_adapter(
    source: dict[str, Any], drive: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    opened = threading.Event()

    def adapter() -> None:
        received = b""
        while b"O\r" not in received:
            if select.select([master], [], [], 5.0)[0]:
                received += os.read(master, 64)
        for _ in range(20):
            os.write(master, b"t1008D084000000000000\r")
        opened.set()

    thread = threading.Thread(target=adapter)
    thread.start()
    source |= {"channel": os.ttyname(slave), "sleep_after_open": 0.1}
    try:
        with caplog.at_level(logging.WARNING):
            async with drive(source, CHANNELS) as record:
                await record.until(lambda: len(record.of("speed_rpm")) == 20)
                assert {s.value for s in record.samples} == {0.125 * 0x84D0}
    finally:
        thread.join()
        os.close(slave)
        os.close(master)
    assert opened.is_set()
