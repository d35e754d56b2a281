"""The write-ahead log of SQLite beside readers that take long."""

import sqlite3
from contextlib import closing
from pathlib import Path

from adapters.samples import Sample
from service.store import Store

MIB = 1024 * 1024
PORTION = 20_000


def test_the_log_gets_small_again_when_a_long_reader_has_ended(tmp_path: Path) -> None:
    log = tmp_path / "bearing-twin.db-wal"
    with Store.open("", tmp_path) as store:
        written = 0

        def write() -> None:
            nonlocal written
            first, written = written, written + PORTION
            store.samples.write(
                [Sample("a", "x", k, float(k), 192, 0) for k in range(first, written)]
            )

        with closing(sqlite3.connect(tmp_path / "bearing-twin.db")) as reader:
            reader.execute("BEGIN")
            reader.execute("SELECT count(*) FROM samples").fetchone()
            while log.stat().st_size < 20 * MIB:
                write()
        for _ in range(3):
            write()
        assert log.stat().st_size <= 16 * MIB
