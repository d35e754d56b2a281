"""An hour of many channels: what it costs to condense and to pack it."""

import contextlib
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from adapters.samples import Quality, Sample
from bearing_twin_laboratory.benchmarks.common import Measurement, Progress
from bearing_twin_laboratory.benchmarks.ingest import empty_database
from service.clock import HOUR_US
from service.store import Store
from service.store.buckets import LEVELS_S

_BEGIN_US = 1_699_999_200_000_000  # a full hour
_CHANNELS_OF_ASSET = 6
#: One sample every five seconds.
_SAMPLES = 720
_ASSETS_AT_ONCE = 50
#: Channels of 16,000 bearings, four measured and two derived ones each.
_FLEET = 96_000
_TABLES = (
    "CREATE TABLE samples (channel_id INTEGER, time_us INTEGER, value REAL, quality INTEGER, "
    "received_us INTEGER, PRIMARY KEY (channel_id, time_us)) WITHOUT ROWID",
    "CREATE TABLE rollups (channel_id INTEGER, resolution_s INTEGER, time_us INTEGER, mean REAL, "
    "low REAL, high REAL, good INTEGER, quality INTEGER, "
    "PRIMARY KEY (channel_id, resolution_s, time_us)) WITHOUT ROWID",
)


def rollups(progress: Progress, *, assets: int = 500) -> Measurement:
    """Processor time of an hour of a channel, condensed and packed, in SQLite."""
    with tempfile.TemporaryDirectory() as folder:
        return _measured(progress, "", Path(folder), assets)


def rollups_postgresql(progress: Progress, *, assets: int = 500) -> Measurement:
    """As `rollups`, in PostgreSQL; the time of the server is not in it."""
    with tempfile.TemporaryDirectory() as folder, empty_database(Path(folder)) as url:
        return _measured(progress, url, Path(folder), assets)


def _measured(progress: Progress, url: str, folder: Path, assets: int) -> Measurement:
    count = assets * _CHANNELS_OF_ASSET
    end_us = _BEGIN_US + HOUR_US
    with Store.open(url, folder, migrate=True) as store:
        for first in range(0, assets, _ASSETS_AT_ONCE):
            progress(0.6 * first / assets, f"storing an hour of {count} channels")
            store.samples.write(_hour(range(first, min(first + _ASSETS_AT_ONCE, assets))))
        progress(0.6, "condensing")
        condensed = _taken_s(lambda: store.rollups.refresh(end_us))
        progress(0.75, "packing")
        packed = _taken_s(lambda: store.packing.pack(end_us))
        stored = sum(store.samples.counts(_SAMPLES + 1).values())
    progress(0.9, "the same rows in a plain file")
    reference = _plain_s(folder / "plain.db", assets)
    both = condensed[0] + packed[0]
    return Measurement(
        both / count,
        "s",
        reference / count,
        "sqlite3 inserting as many samples and statistics into plain tables",
        {
            "channel_hours": count,
            "samples_lost": count * _SAMPLES - stored,
            "condense_s_per_channel_hour": condensed[0] / count,
            "pack_s_per_channel_hour": packed[0] / count,
            "wall_s_per_channel_hour": (condensed[1] + packed[1]) / count,
            f"processor_s_of_{_FLEET}": both / count * _FLEET,
        },
    )


def _taken_s(work: Callable[[], int]) -> tuple[float, float]:
    """Do it until nothing is left: processor time and wall time."""
    processor_s, wall_s = time.process_time(), time.perf_counter()
    while work():
        pass
    return time.process_time() - processor_s, time.perf_counter() - wall_s


def _hour(assets: range) -> list[Sample]:
    """What one poll every five seconds of each asset brings, in steps of 0.1."""
    noise = np.random.default_rng(assets.start)
    samples = []
    for asset in assets:
        step_us = HOUR_US // _SAMPLES
        times_us = _BEGIN_US + step_us * np.arange(_SAMPLES) + noise.integers(0, 3000, _SAMPLES)
        walks = 50 + np.cumsum(noise.normal(0, 0.05, (_CHANNELS_OF_ASSET, _SAMPLES)), axis=1)
        samples += [
            Sample(f"bench-{asset}", f"c_{channel}", time_us, value, Quality.GOOD, time_us)
            for channel, walk in enumerate(np.round(walks, 1).tolist())
            for time_us, value in zip(times_us.tolist(), walk, strict=True)
        ]
    return samples


def _plain_s(path: Path, assets: int) -> float:
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as plain:
        plain.execute("PRAGMA journal_mode = WAL")
        for table in _TABLES:
            plain.execute(table)
        begun_s = time.process_time()
        for channel_id in range(assets * _CHANNELS_OF_ASSET):
            times_us = range(_BEGIN_US, _BEGIN_US + HOUR_US, HOUR_US // _SAMPLES)
            plain.execute("BEGIN IMMEDIATE")
            plain.executemany(
                "INSERT INTO samples VALUES (?, ?, ?, ?, ?)",
                [(channel_id, time_us, 50.1, 192, time_us) for time_us in times_us],
            )
            plain.executemany(
                "INSERT INTO rollups VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (
                        channel_id,
                        level_s,
                        _BEGIN_US + k * level_s * 1_000_000,
                        50.1,
                        50.0,
                        50.2,
                        9,
                        192,
                    )
                    for level_s in LEVELS_S
                    for k in range(3600 // level_s)
                ],
            )
            plain.execute("COMMIT")
        return time.process_time() - begun_s
