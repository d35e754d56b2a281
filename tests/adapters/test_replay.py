"""The replay driver on real files: CSV and Parquet tables, ASC and BLF logs."""

import asyncio
import struct
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import can
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from patience import within

from adapters.configuration import ConfigurationError
from adapters.protocol import ChannelBinding, SourceHealth
from adapters.registry import driver_spec
from adapters.samples import Quality, Sample

DBC = Path(__file__).parent / "bench.dbc"
START_US = 1_900_000_000_000_000


class Clock:
    """A process clock that jumps to where somebody wants to wait for."""

    rate = 1.0

    def __init__(self) -> None:
        self.us = START_US

    def now_us(self) -> int:
        return self.us

    async def sleep(self, process_seconds: float) -> None:
        self.us += round(process_seconds * 1e6)
        await asyncio.sleep(0)


async def play(
    path: Path, channels: dict[str, dict[str, Any]], count: int, **keys: Any
) -> list[Sample]:
    return (await watched(path, channels, count, **keys))[0]


async def watched(
    path: Path, channels: dict[str, dict[str, Any]], count: int, **keys: Any
) -> tuple[list[Sample], SourceHealth]:
    spec = driver_spec("replay")
    source = spec.source_model.model_validate({"name": "old", "file": path, **keys})
    bindings = [
        ChannelBinding("a", name, spec.channel_model.model_validate({"source": "old", **one}))
        for name, one in channels.items()
    ]
    samples: list[Sample] = []
    async with spec.create(source, bindings, [], Clock()) as driver:
        async for batch in driver.batches():
            samples += batch.samples
            if len(samples) >= count:
                assert driver.health().up
                return samples, replace(driver.health())
    raise AssertionError("a driver ends only when cancelled")


async def played_to_its_end(path: Path, **keys: Any) -> tuple[list[Sample], SourceHealth]:
    """Play the column x of a table; the driver waits without end then."""
    spec = driver_spec("replay")
    source = spec.source_model.model_validate({"name": "old", "file": path, **keys})
    config = spec.channel_model.model_validate({"source": "old", "column": "x"})
    samples: list[Sample] = []
    async with spec.create(source, [ChannelBinding("a", "load_n", config)], [], Clock()) as driver:

        async def play_on() -> None:
            async for batch in driver.batches():
                samples.extend(batch.samples)

        before = driver.health().detail
        playing = asyncio.create_task(play_on())
        async with within(60.0):
            while driver.health().up or driver.health().detail == before:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
        assert not playing.done()
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)
        return samples, replace(driver.health())


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "run.csv"
    path.write_text(text)
    return path


CSV = """time,t_inner_ring_c,speed
2026-03-01T12:00:00Z,40.5,1500
2026-03-01T12:00:01Z,,1501
2026-03-01T12:00:03Z,n/a,99999
"""
CHANNELS = {
    "t_inner_ring_c": {"column": "t_inner_ring_c"},
    "speed_rpm": {"column": "speed", "scale": 2.0, "valid_range": [0, 10_000]},
}


async def test_a_table_is_played_in_process_time(tmp_path: Path) -> None:
    samples = await play(table(tmp_path, CSV), CHANNELS, 5)
    assert [(one.channel, one.time_us - START_US, one.quality) for one in samples] == [
        ("t_inner_ring_c", 0, Quality.GOOD),
        ("speed_rpm", 0, Quality.GOOD),
        ("speed_rpm", 1_000_000, Quality.GOOD),
        ("t_inner_ring_c", 3_000_000, Quality.SENSOR_FAILURE),
        ("speed_rpm", 3_000_000, Quality.EU_EXCEEDED),
    ]
    assert [one.value for one in samples[:3]] == [40.5, 3000.0, 3002.0]
    assert samples[3].value != samples[3].value


async def test_twice_as_fast_and_again(tmp_path: Path) -> None:
    path = table(tmp_path, "time_s,x\n10,1\n14,2\n")
    samples = await play(path, {"load_n": {"column": "x"}}, 4, speed=2.0, repeat=True)
    assert [one.value for one in samples] == [1.0, 2.0, 1.0, 2.0]
    times = [one.time_us - START_US for one in samples]
    assert times == [0, 2_000_000, 3_000_000, 5_000_000]


async def test_as_fast_as_possible_keeps_the_times_of_the_file(tmp_path: Path) -> None:
    rows = "".join(f"2026-03-01T12:00:{k // 1000:02d}.{k % 1000:03d}Z,{k}\n" for k in range(12_000))
    samples = await play(
        table(tmp_path, "time,x\n" + rows), {"load_n": {"column": "x"}}, 12_000, speed=0
    )
    assert [one.value for one in samples] == list(range(12_000))
    assert samples[-1].time_us - samples[0].time_us == 11_999_000
    assert samples[0].time_us < START_US


async def test_an_exported_table_brings_its_qualities(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    columns = {
        "time": pa.array([k + 1_800_000_000 for k in range(3)], pa.timestamp("s", tz="UTC")),
        "channel": ["load_n", "other", "load_n"],
        "value": [2650.0, 1.0, None],
        "quality": pa.array([216, 192, 24], pa.uint8()),
    }
    parquet.write_table(pa.table(columns), path)
    samples = await play(path, {"load_n": {"column": "load_n"}}, 2)
    assert [(one.time_us - START_US, one.quality) for one in samples] == [(0, 216), (2_000_000, 24)]


@pytest.mark.parametrize("suffix", ["asc", "blf"])
async def test_a_can_log_is_decoded_like_a_bus(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run.{suffix}"
    with can.Logger(path) as log:
        for k, speed in enumerate((1000.0, 1001.0, 8191.875)):
            payload = struct.pack("<Hhi", round(speed / 0.125), 0, 0)
            log.on_message_received(
                can.Message(
                    timestamp=1_800_000_000 + k, arbitration_id=0x100, data=payload,
                    is_extended_id=False,
                )
            )  # fmt: skip
            log.on_message_received(can.Message(timestamp=1_800_000_000 + k, arbitration_id=0x7))
    speed = {"speed_rpm": {"message": "DriveStatus", "signal": "Speed"}}
    samples = await play(path, speed, 3, dbc=DBC)
    assert [one.quality for one in samples] == [192, 192, Quality.SENSOR_FAILURE]
    assert [one.value for one in samples[:2]] == [1000.0, 1001.0]
    assert [one.time_us - START_US for one in samples] == [0, 1_000_000, 2_000_000]


@pytest.mark.parametrize(
    ("name", "channel", "keys", "complaint"),
    [
        ("run.xls", {"column": "x"}, {}, "expected a name that ends in"),
        ("run.asc", {"message": "M", "signal": "S"}, {}, "dbc is missing"),
        ("run.csv", {"column": "y"}, {}, "column 'y' is not in 'run.csv'"),
        ("run.csv", {"message": "M", "signal": "S"}, {}, "expected column"),
        ("run.csv", {"column": "x", "message": "M", "signal": "S"}, {}, "expected either column"),
        ("gone.csv", {"column": "x"}, {}, "gone.csv' cannot be read"),
        ("run.csv", {"column": "x"}, {"speed": 0, "repeat": True}, "repeat needs a speed"),
    ],
)
async def test_what_cannot_be_played_is_named(
    tmp_path: Path, name: str, channel: dict[str, Any], keys: dict[str, Any], complaint: str
) -> None:
    table(tmp_path, "time_s,x\n1,2\n")
    with pytest.raises((ValueError, ConfigurationError), match=complaint.replace("'", ".")):
        await play(tmp_path / name, {"load_n": channel}, 1, **keys)


async def test_rows_that_cannot_be_played_are_left_out_and_reported(tmp_path: Path) -> None:
    rows = ["1969-07-20T20:17:40Z,1", "2026-03-01T12:00:00Z,2", "2026-03-01T12:00:00,3"]
    rows += ["soon,4", "2026-03-01T12:00:01Z", "3026-03-01T12:00:00Z,5", "2026-03-01T12:00:02Z,6"]
    for speed in (0.0, 1.0):
        samples, health = await watched(
            table(tmp_path, "\n".join(["time,x", *rows])),
            {"load_n": {"column": "x"}},
            2,
            speed=speed,
        )
        assert [one.value for one in samples] == [2.0, 6.0]
        assert health.errors == {"row": 5}
        assert "5 rows left out, the latest: " in health.detail
        assert "expected a time from 1990 to tomorrow" in health.detail


async def test_a_parquet_column_of_numbers_is_no_column_of_times(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    parquet.write_table(pa.table({"time": [1_800_000_000, 1_800_000_001], "x": [1.0, 2.0]}), path)
    samples, health = await played_to_its_end(path, speed=0.0)
    assert samples == []
    assert health.errors == {"row": 2}
    assert "time = 1800000001: expected a time with an offset" in health.detail


@pytest.fixture
def berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def asc(tmp_path: Path, date: str, *seconds: float, kind: str = "absolute") -> Path:
    path = tmp_path / "run.asc"
    lines = [f"date {date}"] if date else []
    lines += [f"base hex  timestamps {kind}", "internal events logged"]
    lines += [
        f"   {second:.6f} 1  100             Rx   d 8 40 1F 00 00 00 00 00 00" for second in seconds
    ]
    path.write_bytes(("\n".join(lines) + "\n").encode("cp1252"))
    return path


SPEED = {"speed_rpm": {"message": "DriveStatus", "signal": "Speed"}}


@pytest.mark.usefixtures("berlin")
@pytest.mark.parametrize("date", ["Fri Mar 20 08:00:00.000 2026", "Fre Mär 20 08:00:00 2026"])
async def test_the_date_of_a_can_log_counts_where_its_times_do(tmp_path: Path, date: str) -> None:
    samples = await play(asc(tmp_path, date, 1.5, 2.5), SPEED, 2, dbc=DBC, speed=0)
    noted_us = [datetime.fromisoformat("2026-03-20T08:00:00+01:00").timestamp() * 1e6 + 1_500_000]
    assert [one.time_us for one in samples] == [noted_us[0], noted_us[0] + 1_000_000]


async def test_a_can_log_without_a_date_is_played_by_its_distances(tmp_path: Path) -> None:
    path = asc(tmp_path, "", 1.5, 1_800_000_000.0, 2.5)
    samples, health = await watched(path, SPEED, 2, dbc=DBC)
    assert [one.time_us - START_US for one in samples] == [0, 1_000_000]
    assert health.errors == {"row": 1}
    with pytest.raises(ConfigurationError, match="which has no date; expected a date at the begin"):
        await play(path, SPEED, 1, dbc=DBC, speed=0)


async def test_a_table_of_seconds_has_no_date(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="has no date; expected a column time, or a speed"):
        await play(table(tmp_path, "time_s,x\n1,2\n"), {"load_n": {"column": "x"}}, 1, speed=0)


@pytest.mark.parametrize(
    ("date", "kind", "speed", "complaint"),
    [
        ("Fri Mar 20 08:00:00.000 2026", "relative", 1.0, "times count from frame to frame"),
        ("Fri Mar 32 08:00:00.000 2026", "absolute", 0.0, "is no date; expected one such as"),
    ],
)
async def test_a_can_log_that_cannot_be_read_is_one_line(
    tmp_path: Path, date: str, kind: str, speed: float, complaint: str
) -> None:
    with pytest.raises(ConfigurationError, match=complaint) as refused:
        await play(asc(tmp_path, date, 1.0, kind=kind), SPEED, 1, dbc=DBC, speed=speed)
    assert "\n" not in str(refused.value)


async def test_a_row_from_before_the_first_one_has_no_place_in_a_play(tmp_path: Path) -> None:
    rows = "time_s,x\n100,1\n40,2\n101,3\n100.5,4\n"
    samples, health = await watched(table(tmp_path, rows), {"load_n": {"column": "x"}}, 3)
    assert [(one.time_us - START_US, one.value) for one in samples] == [
        (0, 1.0), (1_000_000, 3.0), (500_000, 4.0)
    ]  # fmt: skip
    assert health.errors == {"row": 1}
    assert "is before the first row" in health.detail


@pytest.mark.parametrize("speed", [0.0, 1.0])
async def test_a_can_log_without_a_frame_is_refused(tmp_path: Path, speed: float) -> None:
    path = asc(tmp_path, "Fri Mar 20 08:00:00.000 2026")
    with pytest.raises(ConfigurationError, match=r"run.asc' holds no frame"):
        await play(path, SPEED, 1, dbc=DBC, speed=speed)


async def test_a_file_that_is_damaged_further_on_has_ended_there(tmp_path: Path) -> None:
    path = table(tmp_path, "time,x\n2026-03-01T12:00:00Z,1\n2026-03-01T12:00:01Z,2\n")
    path.write_bytes(path.read_bytes() + b"2026-03-01T12:00:02Z,\xff\n")
    samples, health = await played_to_its_end(path)
    assert health.errors == {"file": 1}
    assert "line 4: not CSV in UTF-8 (byte 0xff at 22)" in health.detail
    assert [one.value for one in samples] == [1.0, 2.0]


DESCENDING = {
    "time": [f"2026-03-01T12:00:{9 - k:02d}Z,{k}" for k in range(10)],
    "time_s": [f"{100 - k},{k}" for k in range(10)],
}


@pytest.mark.parametrize("clock", ["time", "time_s"])
async def test_a_table_with_the_latest_row_first_is_refused(tmp_path: Path, clock: str) -> None:
    path = table(tmp_path, "\n".join([f"{clock},x", "soon,1", *DESCENDING[clock]]))
    with pytest.raises(ConfigurationError, match=r"run.csv': times descend, from ") as refused:
        await play(path, {"load_n": {"column": "x"}}, 2)
    assert "; expected the earliest row first, or speed = 0" in str(refused.value)
    assert "1970" not in str(refused.value)


async def test_a_clock_that_was_set_back_once_is_no_order(tmp_path: Path) -> None:
    later = [f"2026-03-01T12:00:0{second}Z,{second}" for second in (5, 5, 5, 4, 4, 6)]
    path = table(tmp_path, "\n".join(["time,x", *later]))
    samples, health = await played_to_its_end(path)
    assert [one.value for one in samples] == [5.0, 5.0, 5.0, 6.0]
    assert health.errors == {"row": 2}
    beyond = ["2099-01-01T00:00:00Z,0", "2098-01-01T00:00:00Z,0", *later]
    samples, _ = await played_to_its_end(table(tmp_path, "\n".join(["time,x", *beyond])))
    assert len(samples) == 4


async def test_at_full_speed_the_order_of_rows_does_not_matter(tmp_path: Path) -> None:
    path = table(tmp_path, "\n".join(["time,x", *DESCENDING["time"]]))
    samples, _ = await played_to_its_end(path, speed=0.0)
    assert [one.value for one in samples] == list(range(10))


CHANNEL_X = {"load_n": {"column": "x"}}
STRAY = "2029-06-01T00:00:00Z"


async def test_a_long_gap_is_played_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = ["2026-03-01T12:00:00Z,1", "2026-03-01T14:59:00Z,2", "2026-03-03T14:59:00Z,3"]
    path = table(tmp_path, "\n".join(["time,x", *rows, f"{STRAY},4"]))
    with caplog.at_level("WARNING"):
        samples, health = await watched(path, CHANNEL_X, 3)
    assert [one.value for one in samples] == [1.0, 2.0, 3.0]
    assert samples[2].time_us - samples[1].time_us == 48 * 3600 * 10**6
    (said,) = [one.getMessage() for one in caplog.records]  # not of each gap
    until = "2030-03-19T20:45:40+00:00"
    assert f"48.0 h without a row, up to 2026-03-03T14:59:00+00:00: plays on at {until}" in said
    assert health.detail.startswith("28449.0 h without a row")
    with caplog.at_level("WARNING"):
        _, health = await watched(path, CHANNEL_X, 4, speed=1e5)
        assert health.detail == "ok"
        caplog.clear()
        await watched(table(tmp_path, "\n".join(["time,x", *rows])), CHANNEL_X, 3, speed=1e4)
    assert caplog.records == []
