"""Reading a month of history for a screen, and what a stored sample costs."""

import contextlib
import json
import sqlite3
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydantic_core import to_json

from adapters.samples import Quality, Sample
from bearing_twin_laboratory.benchmarks.common import Measurement, Progress, shortest_s
from bearing_twin_laboratory.benchmarks.ingest import empty_database
from service.clock import HOUR_US
from service.store import Store
from service.store.blocks import ChannelSamples, pack
from service.store.opening import FILE_NAME
from service.transfer.pages import ExportPosition, as_items, choose_resolution, read_page

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


def query_auto(progress: Progress, *, days: float = 30.0) -> Measurement:
    """Six channels at 1 Hz over 30 days, ``auto`` for a screen, next to reading the raw rows."""
    seconds = round(86_400 * days)
    with tempfile.TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        _fill(store, seconds, lambda done: progress(0.9 * done, f"storing {days:g} days at 1 Hz"))
        end_us = _BEGIN_US + seconds * _SECOND_US
        rows = 0

        def query() -> None:
            nonlocal rows
            chosen = choose_resolution(store, _ASSET, list(_CHANNELS), _BEGIN_US, end_us)
            place = ExportPosition(
                resolution=chosen, start_us=_BEGIN_US, end_us=end_us, channels=list(_CHANNELS)
            )
            rows = len(read_page(store, _ASSET, place, 100_000).rows)

        progress(0.9, "the query")
        duration = shortest_s(query)
        progress(0.95, "the raw rows")
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


def chart_30_days(progress: Progress, *, days: float = 30.0, channels: int = 50) -> Measurement:
    """Hours of many channels over 30 days as the page's chart asks for them: rows and JSON.

    Each channel has a sample a minute, condensed and packed; an hour's row costs the same whatever
    came in it.
    """
    minutes = round(1440 * days)
    names = [f"t_node_{number}_c" for number in range(channels)]
    end_us = _BEGIN_US + minutes * 60 * _SECOND_US
    place = ExportPosition(resolution="1h", start_us=_BEGIN_US, end_us=end_us, channels=names)
    with tempfile.TemporaryDirectory() as folder, Store.open("", Path(folder)) as store:
        for number, name in enumerate(names):
            store.samples.write(
                [
                    Sample(
                        _ASSET, name, time_us, 60.0 + time_us % 7919 / 1e3, Quality.GOOD, time_us
                    )
                    for time_us in range(_BEGIN_US, end_us, 60 * _SECOND_US)
                ]
            )
            progress(0.6 * (number + 1) / channels, f"storing {days:g} days")
        _keep(store, end_us, packed=True)
        rows = 0

        def query() -> None:
            nonlocal rows
            found = read_page(store, _ASSET, place, 100_000).rows
            rows = len(found)
            to_json(as_items(found, place))

        duration = shortest_s(query)
        reference = _read_hours(Path(folder) / FILE_NAME)
    return Measurement(
        duration,
        "s",
        reference,
        "sqlite3 reading the same rows, and json writing them",
        {"rows": rows, "us_per_row": 1e6 * duration / rows},
    )


def bytes_per_sample(
    progress: Progress, *, days: float = 1.0, step_s: int = 1, server: bool = False
) -> Measurement:
    """Bytes of all tables per sample of six channels, rollups and all else included.

    Hours are packed as they pass, as a service does: the last two are not, which weighs less in a
    month (``month_bytes_per_sample``). The drivers of the service receive a sample at its time. In
    blocks also: polls of a gateway that sends each on, or ten at once, and single channels with
    times of their own that are sent so.

    - ``step_s``: seconds between two samples of a channel.
    - ``server``: in PostgreSQL instead of SQLite; it is vacuumed as the hours pass.
    """
    seconds = round(86_400 * days)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = stack.enter_context(empty_database(folder)) if server else ""
        store = stack.enter_context(Store.open(url, folder, migrate=True))
        empty = sum(_table_bytes(store).values())
        doing = f"storing {days:g} days at one sample every {step_s} s"
        _fill(store, seconds, lambda done: progress(done, doing), packed=True, step_s=step_s)
        tables = _table_bytes(store)
        with store._database.reading() as connection:
            blocks = connection.exec_driver_sql("SELECT SUM(LENGTH(data)) FROM sample_blocks")
            hours = connection.exec_driver_sql("SELECT SUM(sample_count) FROM packed_hours")
            in_blocks = int(blocks.scalar() or 0) / int(hours.scalar() or 1)
    count = seconds // step_s * len(_CHANNELS)
    full = sum(tables.values())
    rollups = sum(size for name, size in tables.items() if "rollup" in name)
    hot = sum(size for name, size in tables.items() if name.startswith("samples"))
    return Measurement(
        (full - empty) / count,
        "B",
        _RAW_BYTES,
        "8 bytes of each of both times, 8 of value, 1 of quality",
        {
            "samples": count,
            "table_bytes": full,
            "rollup_bytes_per_sample": rollups / count,
            "month_bytes_per_sample": (full - empty - hot * (1.0 - days / 30.0)) / count,
            "block_bytes_per_sample": in_blocks,
            **_sent_bytes_per_sample(),
        },
    )


def bytes_per_slow_sample(progress: Progress, *, days: float = 7.0) -> Measurement:
    """As `bytes_per_sample`, one sample every 20 s."""
    return bytes_per_sample(progress, days=days, step_s=20)


def bytes_per_sample_postgresql(progress: Progress, *, days: float = 1.0) -> Measurement:
    """As `bytes_per_sample`, in PostgreSQL."""
    return bytes_per_sample(progress, days=days, server=True)


def bytes_per_slow_sample_postgresql(progress: Progress, *, days: float = 7.0) -> Measurement:
    """As `bytes_per_sample`, one sample every 20 s, in PostgreSQL."""
    return bytes_per_sample(progress, days=days, step_s=20, server=True)


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
                    ChannelSamples(
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
    store: Store,
    seconds: int,
    progress: Callable[[float], None],
    *,
    packed: bool = False,
    step_s: int = 1,
) -> None:
    """Store all channels for this many seconds, in order of time, and the rollups.

    Polls come up to 3 ms late, and transmitters have steps of 0.1 °C.
    """
    noise = np.random.default_rng(1)
    batch_s = max(_BATCH_S, HOUR_US // _SECOND_US) if step_s > 1 else _BATCH_S
    for begin in range(0, seconds, batch_s):
        at_s = np.arange(begin, min(begin + batch_s, seconds), step_s)
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
            _keep(store, _BEGIN_US + begin * _SECOND_US - HOUR_US, packed=True)
            _vacuum(store)
        progress(0.9 * begin / seconds)
    _keep(store, _BEGIN_US + seconds * _SECOND_US, packed=False)


def _keep(store: Store, before_us: int, *, packed: bool) -> None:
    """Do what the service does next to its work."""
    while store.rollups.refresh(before_us):
        pass
    while packed and store.packing.pack(before_us):
        pass


def _vacuum(store: Store) -> None:
    """Do what a server does without being asked meanwhile."""
    engine = store._database.engine
    if engine.dialect.name == "postgresql":
        with engine.connect() as connection:
            connection.execution_options(isolation_level="AUTOCOMMIT").exec_driver_sql("VACUUM")


def _table_bytes(store: Store) -> dict[str, int]:
    """Bytes of each table with its indexes."""
    _vacuum(store)
    query = (
        "SELECT m.tbl_name, SUM(s.pgsize) FROM dbstat s JOIN sqlite_master m ON m.name = s.name "
        "GROUP BY m.tbl_name"
    )
    if store._database.engine.dialect.name == "postgresql":
        query = (
            "SELECT relname, pg_total_relation_size(oid) FROM pg_class "
            "WHERE relkind = 'r' AND relnamespace = current_schema()::regnamespace"
        )
    with store._database.reading() as connection:
        return {name: int(size) for name, size in connection.exec_driver_sql(query)}


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


def _read_hours(path: Path) -> float:
    """Seconds for the rows of all hours by the standard library alone."""
    query = (
        "SELECT name, time_us, mean, low, high, good, quality FROM rollups "
        "JOIN channels ON channels.id = channel_id WHERE resolution_s = 3600 "
        "ORDER BY time_us, name"
    )
    with contextlib.closing(sqlite3.connect(path)) as connection:
        return shortest_s(lambda: json.dumps(connection.execute(query).fetchall()))
