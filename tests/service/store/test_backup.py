"""The commands of the chapter on backups in `docs/run/store.md`, as they stand there."""

import contextlib
import re
import shlex
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest
from patience import patience
from postgresql import PostgreSQL
from sqlalchemy.engine import make_url

from adapters.samples import Sample
from service.store import Store
from service.store.opening import FILE_NAME

pytestmark = pytest.mark.wires

PAGE = Path(__file__).parents[3] / "docs" / "run" / "store.md"
CHAPTER = PAGE.read_text().split("## Backup")[1]
BLOCKS = re.findall(r"```sh\n(.*?)```", CHAPTER.split("\n## ")[0], re.DOTALL)
CHANNELS = 20


@contextlib.contextmanager
def written_to(store: Store) -> Iterator[None]:
    """Store goes on being written to, a time of all channels after the other."""
    stop, begun = threading.Event(), threading.Event()

    def write() -> None:
        time_us = 0
        while not stop.is_set():
            time_us += 1
            store.samples.write(
                [Sample("a", f"c{n}", time_us, float(time_us), 192, 0) for n in range(CHANNELS)]
            )
            begun.set()

    thread = threading.Thread(target=write)
    thread.start()
    try:
        assert begun.wait(30)
        yield
    finally:
        stop.set()
        thread.join()


def holds_whole_batches(store: Store) -> bool:
    """Return whether the store holds some batches, the first ones, each whole."""
    found = store.samples.read("a", None, 0, 2**62, 10**6)
    last = max(one.time_us for one in found)
    return len(found) == CHANNELS * last and all(one.value == one.time_us for one in found)


def test_an_sqlite_file_is_copied_while_it_is_written_and_restored(tmp_path: Path) -> None:
    (block,) = [one for one in BLOCKS if "VACUUM INTO" in one]
    program = shlex.split(block)
    code = program[program.index("-c") + 1].replace("/var/lib/bearing-twin", str(tmp_path))
    with Store.open("", tmp_path) as store, written_to(store):
        subprocess.run([sys.executable, "-c", code], check=True, timeout=patience(180))
    restored = tmp_path / "restored"
    restored.mkdir()
    (tmp_path / "backup.db").rename(restored / FILE_NAME)
    with Store.open("", restored) as store:
        assert holds_whole_batches(store)
        assert store.samples.write([Sample("a", "c0", 2**50, 1.0, 192, 0)]) == (1, 0)
    with contextlib.closing(sqlite3.connect(restored / FILE_NAME)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def test_a_postgresql_database_is_dumped_while_it_is_written_and_restored(
    postgresql: PostgreSQL, tmp_path: Path
) -> None:
    (block,) = [one for one in BLOCKS if "pg_dump" in one]
    dump, restore = (shlex.split(line) for line in block.strip().splitlines())
    url = postgresql.database()
    new = make_url(url).set(database=f"{make_url(url).database}_restored")
    with psycopg.connect(url, autocommit=True) as admin:
        admin.execute(f'CREATE DATABASE "{new.database}"')
        found = admin.execute("SELECT setting FROM pg_config WHERE name = 'BINDIR'").fetchone()
    assert found is not None
    programs = Path(found[0])  # those of the server's own version
    places = {"backup.dump": str(tmp_path / "backup.dump")}
    with Store.open(url, tmp_path) as store, written_to(store):
        run(programs, dump, {**places, "postgresql://USER@HOST/bearing_twin": url})
    restored = new.render_as_string(hide_password=False)
    run(programs, restore, {**places, "postgresql://USER@HOST/NEW": restored})
    with Store.open(restored, tmp_path) as store:
        assert holds_whole_batches(store)
        assert store.samples.write([Sample("a", "c0", 2**50, 1.0, 192, 0)]) == (1, 0)


def run(programs: Path, command: list[str], replaced: dict[str, str]) -> None:
    words = [
        next((word.replace(old, new) for old, new in replaced.items() if old in word), word)
        for word in command
    ]
    subprocess.run([programs / words[0], *words[1:]], check=True, timeout=patience(280))
