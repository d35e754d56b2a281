import os
import subprocess
import threading
from pathlib import Path
from typing import Any

import psycopg
import pytest
from patience import patience
from postgresql import PostgreSQL, running_postgresql
from processes import hasty, wait_until

from service.store import DatabaseInUseError, StoreError, lock_database
from service.store.database_lock import DatabaseLock


def held(url: str, folder: Path, on_lost: threading.Event | None = None) -> DatabaseLock:
    lock = lock_database(url, folder, (on_lost or threading.Event()).set)
    assert lock is not None
    return lock


def locks(connection: psycopg.Connection[Any]) -> list[tuple[int, bool]]:
    """Processes of the server that hold the lock, or wait for it."""
    return connection.execute(
        "SELECT pid, granted FROM pg_locks WHERE locktype = 'advisory' AND database = "
        "(SELECT oid FROM pg_database WHERE datname = current_database())"
    ).fetchall()


@pytest.mark.wires
def test_a_second_service_with_a_directory_of_its_own_is_refused(
    postgresql: PostgreSQL, tmp_path: Path
) -> None:
    url = postgresql.database()
    configuration = tmp_path / "second.toml"
    configuration.write_text(
        f'[service]\nport = 0\ndata_dir = "second"\ndatabase_url = "{url}"\n', encoding="utf-8"
    )
    with held(url, tmp_path), held(postgresql.database(), tmp_path):
        with pytest.raises(DatabaseInUseError, match=r"another service .* process \d+\)"):
            held(url, tmp_path)
        second = subprocess.run(
            hasty("serve", "-c", str(configuration)),
            capture_output=True,
            text=True,
            timeout=patience(280),
            check=False,
        )
    assert second.returncode == os.EX_TEMPFAIL, second.stderr
    assert "another service is running on it" in second.stderr.splitlines()[-1]
    held(url, tmp_path).close()


def test_schemas_of_a_database_do_not_meet(postgresql: PostgreSQL, tmp_path: Path) -> None:
    url = postgresql.database()
    with psycopg.connect(url, autocommit=True) as admin:
        admin.execute("CREATE SCHEMA other")
    with held(url, tmp_path), held(f"{url}&options=-csearch_path%3Dother", tmp_path):
        pass


@pytest.mark.wires
def test_the_lock_is_taken_again_after_a_restart_of_the_server(tmp_path: Path) -> None:
    lost = threading.Event()
    with running_postgresql() as server:
        url = server.database()
        with held(url, tmp_path, lost) as lock:
            server.stop()
            server.start()
            with psycopg.connect(url, autocommit=True) as admin:
                wait_until(lambda: bool(locks(admin)), 30.0, "locked again")
            with pytest.raises(DatabaseInUseError):
                held(url, tmp_path)
            assert not lock.lost
    assert not lost.is_set()


def test_who_loses_the_database_to_another_is_told(postgresql: PostgreSQL, tmp_path: Path) -> None:
    url = postgresql.database()
    lost = threading.Event()
    with held(url, tmp_path, lost) as lock, psycopg.connect(url, autocommit=True) as other:
        ((process, _),) = locks(other)
        # In the queue before the holder is cut off, so that it is surely the next one.
        waiting = threading.Thread(
            target=other.execute,
            args=("SELECT pg_advisory_lock(%s, hashtext(current_schema()))", (0x42545773,)),
        )
        waiting.start()
        with psycopg.connect(url, autocommit=True) as admin:
            wait_until(lambda: any(not granted for _, granted in locks(admin)), 30.0, "waits")
            admin.execute("SELECT pg_terminate_backend(%s)", (process,))
        waiting.join()
        assert lost.wait(30.0)
        assert "another service is running on it" in lock.lost


def test_an_sqlite_file_has_a_lock_of_its_own(tmp_path: Path) -> None:
    with lock_database("", tmp_path, lambda: None) as lock:
        assert lock.lost == ""
        with pytest.raises(DatabaseInUseError):
            lock_database("", tmp_path, lambda: None)


def test_without_a_server_the_error_is_one_line_without_the_password(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"service\.database_url = .*connection") as caught:
        held("postgresql://u:secret@127.0.0.1:1/d", tmp_path)
    assert "\n" not in str(caught.value)
    assert "secret" not in str(caught.value)
