"""Reading a month of history for a screen, and what a stored sample costs."""

import contextlib
import math
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from adapters.samples import Quality, Sample
from service.lab.benchmarks.common import Measurement, Progress, shortest_s
from service.store import Store
from service.store.opening import FILE_NAME
from service.transfer.pages import ExportPosition, choose_resolution, read_page

_ASSET = "bench"
_CHANNELS = (
    "speed_rpm", "load_n", "ambient_c", "t_inner_ring_c", "t_outer_ring_c", "t_node_5_c",
)  # fmt: skip
_SECOND_US = 1_000_000
_BEGIN_US = 1_699_999_200_000_000  # a full hour
_BATCH_S = 2000
_RAW_BYTES = 17.0  # 8 for the time, 8 for the value, 1 for the quality


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
    """Size of the SQLite file per sample, rollups and everything else included."""
    seconds = round(86_400 * days)
    with tempfile.TemporaryDirectory() as folder:
        with Store.open("", Path(folder)) as store:
            empty = _file_bytes(Path(folder))
            _fill(store, seconds, lambda done: tell(done, f"storing {days:g} days at 1 Hz"))
        full = _file_bytes(Path(folder))
    count = seconds * len(_CHANNELS)
    return Measurement(
        (full - empty) / count,
        "B",
        _RAW_BYTES,
        "8 bytes of time, 8 of value, 1 of quality",
        {"samples": count, "file_bytes": full},
    )


def _fill(store: Store, seconds: int, tell: Callable[[float], None]) -> None:
    """Store this many seconds of all channels at 1 Hz, in order of time, and the rollups."""
    for begin in range(0, seconds, _BATCH_S):
        samples = []
        for second in range(begin, min(begin + _BATCH_S, seconds)):
            time_us = _BEGIN_US + second * _SECOND_US
            value = 60.0 + 20.0 * math.sin(second / 7000.0) + second % 10 * 0.1
            samples += [
                Sample(_ASSET, name, time_us, value, Quality.GOOD, time_us) for name in _CHANNELS
            ]
        store.samples.write(samples)
        tell(0.9 * begin / seconds)
    while store.rollups.refresh(_BEGIN_US + seconds * _SECOND_US):
        tell(0.95)


def _read_raw(path: Path) -> tuple[float, int]:
    """Seconds for reading all rows, and how many they are."""
    with contextlib.closing(sqlite3.connect(path)) as connection:
        began = time.perf_counter()
        cursor = connection.execute("SELECT channel_id, time_us, value, quality FROM samples")
        cursor.arraysize = 10_000
        count = 0
        while rows := cursor.fetchmany():
            count += len(rows)
        return time.perf_counter() - began, count


def _file_bytes(folder: Path) -> int:
    with contextlib.closing(sqlite3.connect(folder / FILE_NAME)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return (folder / FILE_NAME).stat().st_size
