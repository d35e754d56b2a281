"""Reading a month of history for a screen, and what a stored sample costs."""

import contextlib
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adapters.samples import Quality, Sample
from service.clock import HOUR_US
from service.lab.benchmarks.common import Measurement, Progress, shortest_s
from service.store import Store
from service.store.blocks import Samples, pack
from service.store.opening import FILE_NAME
from service.transfer.pages import ExportPosition, choose_resolution, read_page

_ASSET = "bench"
_CHANNELS = (
    "speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c", "t_node_5_c",
)  # fmt: skip
_SECOND_US = 1_000_000
_BEGIN_US = 1_699_999_200_000_000  # a full hour
_BATCH_S = 2000
_RAW_BYTES = 25.0  # 8 for each of both times, 8 for the value, 1 for the quality
#: Samples of an hour of a channel that has times of its own.
_IRREGULAR = 600
#: Samples that a gateway sends at once.
_AT_ONCE = 10


def query_auto(tell: Progress, *, days: float = 30.0) -> Measurement:
    """Six channels at 1 Hz over 30 days, ``auto`` for a screen, next to reading the raw rows."""
    seconds = round(86_400 * days)
    with tempfile.TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        _fill(store, seconds, lambda done: tell(0.9 * done, f"storing {days:g} days at 1 Hz"))
        end_us = _BEGIN_US + seconds * _SECOND_US
        rows = 0

        def query() -> None:
            nonlocal rows
            chosen = choose_resolution(store, _ASSET, list(_CHANNELS), _BEGIN_US, end_us)
            place = ExportPosition(
                resolution=chosen, start_us=_BEGIN_US, end_us=end_us, channels=list(_CHANNELS)
            )
            rows = len(read_page(store, _ASSET, place, 100_000).rows)

        tell(0.9, "the query")
        duration = shortest_s(query)
        tell(0.95, "the raw rows")
        reference, raw_rows = _read_raw(Path(folder) / FILE_NAME)
    return Measurement(
        duration,
        "s",
        reference,
        "sqlite3 reading the raw rows of the same span and channels",
        {
            "times_faster": reference / duration,
            "rows": rows,
            "points_per_channel": rows / len(_CHANNELS),
            "raw_rows": raw_rows,
        },
    )


def bytes_per_sample(tell: Progress, *, days: float = 1.0) -> Measurement:
    """Size of the SQLite file per sample, rollups and everything else included.

    Hours are packed as they pass, as a service does. The drivers of the service receive a sample
    at its time. In blocks also: polls of a gateway that sends each on, or ten at once, and single
    channels with times of their own that are sent so.
    """
    seconds = round(86_400 * days)
    with tempfile.TemporaryDirectory() as folder:
        with Store.open("", Path(folder)) as store:
            empty = _file_bytes(Path(folder))
            doing = f"storing {days:g} days at 1 Hz"
            _fill(store, seconds, lambda done: tell(done, doing), packed=True)
        full = _file_bytes(Path(folder))
        block_bytes = _block_bytes(Path(folder) / FILE_NAME)
    count = seconds * len(_CHANNELS)
    return Measurement(
        (full - empty) / count,
        "B",
        _RAW_BYTES,
        "8 bytes of each of both times, 8 of value, 1 of quality",
        {
            "samples": count,
            "file_bytes": full,
            "block_bytes_per_sample": block_bytes / count,
            **_sent_bytes_per_sample(),
        },
    )


def _sent_bytes_per_sample() -> dict[str, float]:
    """Bytes per sample of an hour in a block of what gateways push over a network."""
    noise = np.random.default_rng(2)
    hour_s = HOUR_US // _SECOND_US
    polled_us = _BEGIN_US + _SECOND_US * np.arange(hour_s) + noise.integers(0, 3000, hour_s)
    irregular_us = _BEGIN_US + np.sort(noise.integers(0, HOUR_US, _IRREGULAR))
    found = {}
    for name, times_us, channels in (
        ("polled", polled_us, len(_CHANNELS)),
        ("irregular", irregular_us, 1),
    ):
        numbers = np.arange(times_us.size)
        sent = np.minimum(numbers // _AT_ONCE * _AT_ONCE + _AT_ONCE, times_us.size) - 1
        for way, last in (("one_by_one", numbers), ("ten_at_once", sent)):
            # Some 30 ms on the way, and never before what was sent earlier.
            on_the_way_us = 30_000.0 * np.exp(noise.normal(0.0, 0.5, times_us.size))
            received_us = np.maximum.accumulate(times_us + on_the_way_us.astype(np.int64))[last]
            block = pack(
                [
                    Samples(
                        times_us,
                        np.round(60.0 + np.cumsum(noise.normal(0.0, 0.05, times_us.size)), 1),
                        np.full(times_us.size, int(Quality.GOOD), np.uint16),
                        received_us,
                    )
                    for _ in range(channels)
                ]
            )
            count = times_us.size * channels
            found[f"{name}_{way}_bytes_per_sample"] = len(block.data) / count
    return found


def _fill(
    store: Store, seconds: int, tell: Callable[[float], None], *, packed: bool = False
) -> None:
    """Store this many seconds of all channels at 1 Hz, in order of time, and the rollups.

    Polls come up to 3 ms late, and transmitters have steps of 0.1 °C.
    """
    noise = np.random.default_rng(1)
    for begin in range(0, seconds, _BATCH_S):
        at_s = np.arange(begin, min(begin + _BATCH_S, seconds))
        times_us = _BEGIN_US + at_s * _SECOND_US + noise.integers(0, 3000, at_s.size)
        course = 60.0 + 20.0 * np.sin(at_s / 7000.0)
        samples = [
            Sample(_ASSET, name, time_us, value, Quality.GOOD, time_us)
            for name in _CHANNELS
            for time_us, value in zip(
                times_us.tolist(),
                np.round(course + noise.normal(0.0, 0.05, at_s.size), 1).tolist(),
                strict=True,
            )
        ]
        store.samples.write(samples)
        if packed:
            _keep(store, _BEGIN_US + begin * _SECOND_US, packed=True)
        tell(0.9 * begin / seconds)
    _keep(store, _BEGIN_US + seconds * _SECOND_US, packed=packed)


def _keep(store: Store, before_us: int, *, packed: bool) -> None:
    """Do what the service does next to its work."""
    while store.rollups.refresh(before_us):
        pass
    while packed and store.packing.pack(before_us):
        pass


def _block_bytes(path: Path) -> int:
    with contextlib.closing(sqlite3.connect(path)) as connection:
        (total,) = connection.execute("SELECT SUM(LENGTH(data)) FROM sample_blocks").fetchone()
    return int(total or 0)


def _read_raw(path: Path) -> tuple[float, int]:
    """Seconds for reading all rows, and how many they are."""
    with contextlib.closing(sqlite3.connect(path)) as connection:
        began = time.perf_counter()
        cursor = connection.execute(
            "SELECT channel_id, time_us, value, quality, received_us FROM samples"
        )
        cursor.arraysize = 10_000
        count = 0
        while rows := cursor.fetchmany():
            count += len(rows)
        return time.perf_counter() - began, count


def _file_bytes(folder: Path) -> int:
    with contextlib.closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return (folder / FILE_NAME).stat().st_size
