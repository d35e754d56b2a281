"""``bearing-twin backup`` and ``restore``, locks and copies: nobody loses a store by a tool."""

import contextlib
import os
import sqlite3
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest
from patience import patience
from postgresql import PostgreSQL
from sqlalchemy import create_engine
from sqlalchemy.engine import make_url

from adapters.samples import Sample
from service.clock import ProcessClock
from service.ingest import Spool
from service.security.keys import create_key, list_keys, revoke_all_keys, revoke_key
from service.store import (
    DatabaseInUseError,
    Outbox,
    Store,
    StoreError,
    lock_data_directory,
    lock_database,
)
from service.store.backup import back_up, restore
from service.store.migrations import upgrade
from service.store.opening import FILE_NAME, database_address

COUNT = 2000


def filled(store: Store) -> str:
    """Fill a store; returns the prefix of a key that is logged in."""
    store.samples.write([Sample("a", "x", k, float(k), 192, 0) for k in range(COUNT)])
    key = create_key(store, "admin").record
    now_us = time.time_ns() // 1000
    store.access.add_session(
        sha256="s", key_id=key.id, created_us=now_us, expires_us=now_us + 10**12
    )
    return key.prefix


def holds_it(store: Store, prefix: str) -> bool:
    found = store.samples.read("a", None, 0, 2**62, 10**6)
    assert store.access.find_session("s") is None, "sessions have ended"
    return len(found) == COUNT and prefix in [key.prefix for key in list_keys(store)]


def test_a_backup_of_sqlite_is_restored_with_its_rows_and_without_sessions(tmp_path: Path) -> None:
    url = database_address("", tmp_path)
    out = tmp_path / "backup.db"
    with Store.open("", tmp_path) as store:
        prefix = filled(store)
        rows = back_up(url, out)  # the store is open: as under a running service
        assert rows["samples"] == COUNT
        with pytest.raises(StoreError, match="exists already; expected a new name"):
            back_up(url, out)
        revoke_key(store, prefix)
        store.samples.write([Sample("a", "x", COUNT, 1.0, 192, 0)])
    assert stat.S_IMODE(out.stat().st_mode) == 0o600
    with pytest.raises(StoreError, match=r"is not empty; expected --force"):
        restore(url, out, force=False)
    assert restore(url, out, force=True)["samples"] == COUNT
    assert (tmp_path / "bearing-twin-before-restore-1.db").exists()
    with Store.open("", tmp_path) as store:
        assert holds_it(store, prefix)
        # What was revoked since is valid again: one command ends that.
        assert [key.prefix for key in revoke_all_keys(store)] == [prefix]
        assert [line.action for line in store.audit.page(1).items] == ["key.revoke"]
        assert revoke_all_keys(store) == []
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    restore(database_address("", elsewhere), out, force=False)
    with Store.open("", elsewhere) as store:
        assert holds_it(store, prefix)
    assert sorted(path.name for path in elsewhere.iterdir()) == [FILE_NAME]


def test_a_damaged_backup_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    url, out = database_address("", tmp_path), tmp_path / "backup.db"
    with Store.open("", tmp_path) as store:
        filled(store)
    back_up(url, out)
    content = bytearray(out.read_bytes())
    content[len(content) // 2 :] = bytes(len(content) - len(content) // 2)
    out.write_bytes(content)
    before = (tmp_path / FILE_NAME).read_bytes()
    for wrong in (out, tmp_path / "missing.db"):
        with pytest.raises(StoreError, match="backup"):
            restore(url, wrong, force=True)
    (tmp_path / "notes.db").write_text("no database " * 500)
    with pytest.raises(StoreError, match=r"backup .*notes\.db: file is not a database"):
        restore(url, tmp_path / "notes.db", force=True)
    assert (tmp_path / FILE_NAME).read_bytes() == before


def test_a_damaged_store_gives_no_backup(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        filled(store)
    path = tmp_path / FILE_NAME
    content = bytearray(path.read_bytes())
    content[len(content) - 3 * 4096 :] = bytes(3 * 4096)
    path.write_bytes(content)
    with pytest.raises(StoreError, match="copy of"):
        back_up(database_address("", tmp_path), tmp_path / "backup.db")
    assert not (tmp_path / "backup.db").exists()


@pytest.mark.wires
def test_a_backup_of_postgresql_is_restored(
    postgresql: PostgreSQL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = postgresql.database()
    url = make_url(address)
    with psycopg.connect(address, autocommit=True) as admin:
        found = admin.execute("SELECT setting FROM pg_config WHERE name = 'BINDIR'").fetchone()
        new = url.set(database=f"{url.database}_restored")
        admin.execute(f'CREATE DATABASE "{new.database}"')
    assert found is not None
    out = tmp_path / "backup.dump"
    with Store.open(address, tmp_path, migrate=True) as store:
        prefix = filled(store)
        monkeypatch.setenv("PATH", str(tmp_path))
        with pytest.raises(StoreError, match=r"pg_dump: not found; expected PostgreSQL's client"):
            back_up(url, out)
        monkeypatch.setenv("PATH", str(found[0]))
        out.with_name("backup.dump.part").symlink_to(tmp_path / "victim")
        assert back_up(url, out)["samples"] == COUNT
        assert not (tmp_path / "victim").exists(), "a planted link is not followed"
        store.samples.write([Sample("a", "x", COUNT, 1.0, 192, 0)])
    assert stat.S_IMODE(out.stat().st_mode) == 0o600
    assert restore(new, out, force=False)["samples"] == COUNT
    with pytest.raises(StoreError, match="is not empty; expected --force"):
        restore(url, out, force=False)
    restore(url, out, force=True)
    for one in (url, new):
        with Store.open(one.render_as_string(hide_password=False), tmp_path) as store:
            assert holds_it(store, prefix)
            assert store.samples.write([Sample("a", "x", 2**50, 1.0, 192, 0)]) == (1, 0)
    out.write_bytes(out.read_bytes()[:-2000])
    with pytest.raises(StoreError):
        restore(url, out, force=True)


# ---------------------------------------------------------------------- locks, rights, upgrades
@pytest.mark.wires
def test_two_services_on_one_sqlite_file_are_refused(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/shared/one.db"
    for name in ("first", "second"):
        Store.open(url, tmp_path / name).close()
    with (
        lock_data_directory(tmp_path / "first"),
        lock_data_directory(tmp_path / "second"),
        lock_database(url, tmp_path / "first", lambda: None),
    ):
        code = (
            "import sys, pathlib\n"
            "from service.store import DatabaseInUseError, lock_database\n"
            "try: lock_database(sys.argv[1], pathlib.Path(sys.argv[2]), lambda: None)\n"
            "except DatabaseInUseError as error: print(error)\n"
        )
        said = subprocess.run(
            [sys.executable, "-c", code, url, str(tmp_path / "second")],
            capture_output=True, text=True, timeout=patience(180), check=True,
        ).stdout  # fmt: skip
        assert f"shared/one.db: another service is running on it (process {os.getpid()})" in said
        with pytest.raises(DatabaseInUseError):
            lock_database(url, tmp_path / "second", lambda: None)
    lock_database(url, tmp_path / "second", lambda: None).close()


def test_only_the_owner_reads_the_files(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        data_dir = tmp_path / "var"
        with (
            lock_data_directory(data_dir),
            Store.open("", data_dir) as store,
            lock_database("", data_dir, lambda: None),
            contextlib.closing(Spool.open(data_dir, 16)),
            Outbox.open(data_dir, store),
        ):
            ProcessClock.resume(60.0, data_dir)
            filled(store)
            names = {path.name for path in data_dir.iterdir()}
            assert names >= {FILE_NAME, f"{FILE_NAME}-wal", "spool.db", "outbox.db", "clock.json"}
            for path in data_dir.iterdir():
                assert stat.S_IMODE(path.stat().st_mode) == 0o600, path.name
        assert stat.S_IMODE(data_dir.stat().st_mode) == 0o700
        # Files of an earlier version, too.
        (data_dir / FILE_NAME).chmod(0o644)
        Store.open("", data_dir).close()
        assert stat.S_IMODE((data_dir / FILE_NAME).stat().st_mode) == 0o600
    finally:
        os.umask(before)


def older(data_dir: Path, revision: str) -> Path:
    path = data_dir / FILE_NAME
    data_dir.mkdir(exist_ok=True)
    engine = create_engine(f"sqlite:///{path}")
    upgrade(engine, revision)
    engine.dispose()
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("INSERT INTO channels VALUES (7, 'a', 'x')")
        connection.execute("INSERT INTO samples VALUES (7, 5, 1.5, 192)")
        connection.commit()
    return path


def test_a_checked_copy_is_kept_before_the_tables_are_upgraded(tmp_path: Path) -> None:
    path = older(tmp_path, "0008")
    for number in range(4):
        (tmp_path / f"bearing-twin-before-upgrade-000{number}.db").touch()
    Store.open("", tmp_path).close()
    copies = sorted(one.name for one in tmp_path.glob("*before-upgrade*"))
    assert copies == [f"bearing-twin-before-upgrade-000{n}.db" for n in (2, 3, 8)], "a few"
    with contextlib.closing(sqlite3.connect(tmp_path / copies[-1])) as copy:
        assert copy.execute("SELECT version_num FROM alembic_version").fetchall() == [("0008",)]
        assert copy.execute("SELECT * FROM samples").fetchall() == [(7, 5, 1.5, 192)]
    assert path.exists()


@pytest.fixture
def older_service(tmp_path: Path) -> Iterator[Path]:
    """A service of an earlier version that runs on a store with its tables."""
    older(tmp_path, "0008")
    code = (
        "import fcntl, os, sys\n"
        "descriptor = os.open(sys.argv[1], os.O_RDWR | os.O_CREAT)\n"
        "fcntl.flock(descriptor, fcntl.LOCK_EX)\n"
        "os.write(descriptor, b'4711\\n')\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path / "service.lock")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield tmp_path
        process.communicate(timeout=patience(60))


@pytest.mark.wires
def test_a_tool_does_not_upgrade_a_store_under_a_running_older_service(older_service: Path) -> None:
    with pytest.raises(StoreError, match=r"earlier version, and a service is running on it \(proc"):
        Store.open("", older_service)
    with contextlib.closing(sqlite3.connect(older_service / FILE_NAME)) as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == ("0008",)


# ---------------------------------------------------------------------- one transaction
def test_a_key_and_its_line_in_the_trail_come_together_or_not_at_all(sqlite_store: Store) -> None:
    kept = create_key(sqlite_store, "viewer").record
    with sqlite_store._database.writing() as connection:
        connection.exec_driver_sql(
            "CREATE TRIGGER no_lines BEFORE INSERT ON audit BEGIN SELECT RAISE(ABORT, 'no'); END"
        )
    with pytest.raises(Exception, match="no"):
        create_key(sqlite_store, "admin")
    with pytest.raises(Exception, match="no"):
        revoke_key(sqlite_store, kept.prefix)
    (key,) = list_keys(sqlite_store)
    assert (key.id, key.revoked_us) == (kept.id, None)
