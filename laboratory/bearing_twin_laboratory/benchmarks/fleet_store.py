"""What the store of a fleet has to do: cells without twins write an hour of it into PostgreSQL."""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import psycopg

from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.fleet import processes_of
from bearing_twin_laboratory.benchmarks.hollow_cell import BEGIN_US, CHANNELS, Task
from bearing_twin_laboratory.benchmarks.ingest import empty_database
from service.clock import HOUR_US
from service.store import Store
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model
from twin_core.observer import Observer

SIZES = (160, 1600)
FLEET = (16_000,)
_ASSETS_OF_A_CELL = 1000
_END_S = 60.0
#: Rows of the reference, and how many it commits at a time.
_PLAIN_ROWS, _PLAIN_AT_ONCE = 200_000, 400
_PLAIN_TABLE = """
CREATE TABLE plain (
    channel_id integer NOT NULL, time_us bigint NOT NULL, value double precision,
    quality smallint NOT NULL, received_us bigint, PRIMARY KEY (channel_id, time_us)
)
"""
_COPY = "COPY plain (channel_id, time_us, value, quality, received_us) FROM STDIN (FORMAT BINARY)"
_STORED = """
SELECT (SELECT count(*) FROM samples) + (SELECT coalesce(sum(sample_count), 0) FROM packed_hours)
"""
_DEAD = "SELECT coalesce(sum(n_dead_tup), 0) FROM pg_stat_user_tables"
_LOG = "SELECT pg_wal_lsn_diff(pg_current_wal_lsn(), '0/0')"


def fleet_store(
    progress: Progress,
    *,
    sizes: Sequence[int] = SIZES,
    rate: float = 6.0,
    period_s: float = 5.0,
    batch_s: float = 0.5,
    state_s: float = 5.0,
) -> Measurement:
    """Processor seconds that an hour of a channel costs the store, at growing numbers of assets.

    Cells of up to 1000 assets share the partitions, write samples and states, and then condense and
    pack the hour while they write on into the next one.

    - ``sizes``: assets, each with four measured channels and two that a twin stores.
    - ``rate``: process seconds a wall second; 0: as fast as possible.
    - ``period_s``, ``batch_s``, ``state_s``: see `Task`.
    """
    rows = []
    for number, assets in enumerate(sizes):
        cells = -(-assets // _ASSETS_OF_A_CELL)
        progress(number / len(sizes), f"{assets * len(CHANNELS)} channels by {cells} cells")
        pace = {"period_s": period_s, "batch_s": batch_s, "state_s": state_s, "rate": rate}
        with tempfile.TemporaryDirectory(prefix="pg", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            with empty_database(folder) as url:
                rows.append(_measured(url, folder, cells, assets, pace))
    last = rows[-1]
    return Measurement(
        last["processor_s_per_channel_hour"],
        "s",
        last["plain_s_per_channel_hour"],
        "psycopg copying as many rows into a plain table, as many at a time; its server too",
        {"by_size": {str(row["channels"]): row for row in rows}, "slope": _slope(rows)},
    )


def fleet_store_16000(progress: Progress) -> Measurement:
    """As `fleet_store`, of 16,000 assets: 96,000 channels."""
    return fleet_store(progress, sizes=FLEET)


def _slope(rows: Sequence[Mapping[str, Any]]) -> float | None:
    """Exponent of the growth of the processor time: 1 where twice the channels cost twice."""
    if len(rows) < 2:
        return None
    channels = [row["channels"] for row in rows]
    spent = [row["channels"] * row["processor_s_per_channel_hour"] for row in rows]
    return float(np.polyfit(np.log(channels), np.log(spent), 1)[0])


def _measured(
    url: str, folder: Path, cells: int, assets: int, pace: Mapping[str, float]
) -> dict[str, Any]:
    with Store.open(url, folder, migrate=True):
        pass
    (folder / "state.json").write_text(json.dumps(_state()))
    with psycopg.connect(url, autocommit=True) as connection:
        server = _Server(connection)
        tasks = [
            Task(url, str(folder / f"cell-{number}"), number, cells, assets, **pace)
            for number in range(cells)
        ]
        with _Cells(tasks) as hollow:
            settled = hollow.heard()
            log_bytes, begun_s = server.one(_LOG), time.perf_counter()
            server.spent_s()
            hollow.say("begin")
            written = hollow.heard()
            wall_s, written_s = time.perf_counter() - begun_s, server.spent_s()
            log_bytes = server.one(_LOG) - log_bytes
            hollow.say("condense")
            condensed, condensed_s = hollow.heard(), server.spent_s()
            hollow.say("pack")
            packed, packed_s = hollow.heard(), server.spent_s()
            hollow.say("stop")
            on = hollow.heard()
            hollow.say("end")
        stored = server.one(_STORED)
        dead = server.one(_DEAD)
        plain_s = _plain_s(connection, server)
    samples = _sum(written, "samples")
    on_s = written_s / samples * _sum(on, "samples")  # of the writes next to the packing
    upkeep_s = max(condensed_s + packed_s - on_s, 0.0)
    channels = assets * len(CHANNELS)
    parts = {
        "samples_s": _sum(written, "samples_s"),
        "states_s": _sum(written, "states_s"),
        "condense_s": _sum(condensed, "processor_s"),
        "pack_s": _sum(packed, "processor_s"),
        "server_write_s": written_s,
        "server_condense_and_pack_s": upkeep_s,
    }
    sent = samples + _sum(settled, "known") + _sum(on, "samples")
    return {
        "channels": channels,
        "cells": cells,
        "assets_of_fullest_cell": max(one["assets"] for one in settled),
        "samples": samples,
        "samples_per_s": samples / wall_s,
        "rate": 3600.0 / wall_s,
        "samples_lost": sent - stored,
        "states": _sum(written, "states"),
        "processor_s_per_channel_hour": sum(parts.values()) / channels,
        "plain_s_per_channel_hour": plain_s * samples / channels,
        **parts,
        "making_s": _sum(written, "made_s"),
        "late_s": _times([s for one in written for s in one["late_s"]]),
        "late_while_packing_s": _times([s for one in on for s in one["late_s"]]),
        "turns_alone": _turns(written, "alone"),
        "turns_of_samples": _turns(written, "shared"),
        "condense_wall_s": max(one["wall_s"] for one in condensed),
        "pack_wall_s": max(one["wall_s"] for one in packed),
        "channel_hours_condensed": _sum(condensed, "hours"),
        "channel_hours_packed": _sum(packed, "hours"),
        "log_bytes_per_sample": log_bytes / samples,
        "dead_rows": dead,
        "partitions_lost": sum(bool(one["lost"]) for one in on),
        "load": round(os.getloadavg()[1], 1),
    }


def _sum(parts: Sequence[Mapping[str, Any]], name: str) -> Any:
    return sum(part[name] for part in parts)


def _times(times_s: Sequence[float]) -> dict[str, float]:
    if not times_s:
        return {}
    return {
        "p50": float(np.quantile(times_s, 0.5)),
        "p99": float(np.quantile(times_s, 0.99)),
        "max": max(times_s),
    }


def _turns(parts: Sequence[Mapping[str, Any]], kind: str) -> dict[str, float]:
    held_s = [s for part in parts for s in part["turns"].get(kind, ())]
    return {"count": len(held_s), "sum_s": sum(held_s), **_times(held_s)}


def _state() -> dict[str, object]:
    """What a twin keeps, with numbers of which none is even."""
    model = build_model("default", bearing=bearing("6311"))
    nodes = len(model.node_names)
    spread = np.random.default_rng(0).normal(0.0, 1.0, (nodes, nodes))
    values = model.parameters.values_from_z(prior_posterior(model).z)
    observer = Observer(model, values, 40.0 + spread[0], spread @ spread.T)
    observer.predict(1.0, 2400.0, 2650.0, 23.0)
    return {"bearing": "6311", "time_us": BEGIN_US, "observer": observer.to_dict()}


class _Server:
    """The database server of a connection, where it runs on this machine."""

    def __init__(self, connection: psycopg.Connection[Any]) -> None:
        self._connection = connection
        backend = self.one("SELECT pg_backend_pid()")
        try:
            status = Path(f"/proc/{backend}/stat").read_text()
        except OSError:
            raise BenchmarkError(
                "fleet_store: its processor time is counted, so that the database server must run "
                "on this machine"
            ) from None
        self._process = int(status.rpartition(")")[2].split()[1])
        self._spent_s = self._total_s()

    def one(self, query: str) -> int:
        """Give the one number that a query finds."""
        row = self._connection.execute(query).fetchone()
        return 0 if row is None else int(row[0])

    def spent_s(self) -> float:
        """Processor seconds since the last question."""
        before, self._spent_s = self._spent_s, self._total_s()
        return self._spent_s - before

    def _total_s(self) -> float:
        ticks = 0
        for process in processes_of(self._process):
            with contextlib.suppress(OSError):  # it has just ended, and counts as a child
                status = Path(f"/proc/{process}/stat").read_text()
                times = status.rpartition(")")[2].split()[11:15]
                ended = process == self._process
                ticks += sum(map(int, times if ended else times[:2]))
        return ticks / os.sysconf("SC_CLK_TCK")


class _Cells:
    """The processes of the cells, all led by the same words."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        module = "bearing_twin_laboratory.benchmarks.hollow_cell"
        self._processes = [
            subprocess.Popen(
                (sys.executable, "-m", module, json.dumps(asdict(task))),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            for task in tasks
        ]

    def __enter__(self) -> "_Cells":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for process in self._processes:
            if kind is not None:
                process.kill()
            process.communicate(timeout=_END_S)

    def say(self, word: str) -> None:
        """Say a word to all."""
        for pipe in self._pipes("stdin"):
            pipe.write(f"{word}\n")
            pipe.flush()

    def heard(self) -> list[dict[str, Any]]:
        """Give the next line of each, when all have said one."""
        lines = [pipe.readline() for pipe in self._pipes("stdout")]
        if not all(lines):
            raise BenchmarkError("a cell of the benchmark ended early; its reason stands above")
        return [json.loads(line) for line in lines]

    def _pipes(self, name: str) -> Iterator[Any]:
        return (getattr(process, name) for process in self._processes)


def _plain_s(connection: psycopg.Connection[Any], server: _Server) -> float:
    """Processor seconds of a row, of this process and of the server."""
    connection.execute(_PLAIN_TABLE)
    server.spent_s()
    begun_s = time.process_time()
    channels = 6 * _PLAIN_AT_ONCE
    for number in range(0, _PLAIN_ROWS, _PLAIN_AT_ONCE):
        time_us = BEGIN_US + number * HOUR_US // _PLAIN_ROWS
        with connection.cursor() as cursor, cursor.copy(_COPY) as copy:
            copy.set_types(("int4", "int8", "float8", "int2", "int8"))
            for place in range(_PLAIN_AT_ONCE):
                channel = (number + place) % channels
                copy.write_row((channel, time_us, 50.0 + number % 97 / 10, 192, time_us))
    return (time.process_time() - begun_s + server.spent_s()) / _PLAIN_ROWS
