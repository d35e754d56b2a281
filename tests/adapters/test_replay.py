"""The replay driver on real files: CSV and Parquet tables, ASC and BLF logs."""

import asyncio
import struct
from pathlib import Path
from typing import Any

import can
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from adapters.configuration import ConfigurationError
from adapters.protocol import ChannelBinding
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
                return samples
    raise AssertionError("a driver ends only when cancelled")


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
        "time": pa.array([0, 1_000_000, 2_000_000], pa.timestamp("us", tz="UTC")),
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
