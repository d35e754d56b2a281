"""Backup and restore of the whole store, both checked."""

import contextlib
import os
import secrets
import shutil
import sqlite3
import subprocess
from collections.abc import Mapping, Sequence
from glob import escape
from pathlib import Path

import psycopg
from sqlalchemy.engine import URL

from service.files import new_part
from service.store.copies import check_sqlite, copy_sqlite, table_counts
from service.store.errors import StoreError
from service.store.identity import RESTORED, renew
from service.store.sqlite import open_sqlite
from service.store.sqlite_file import complete_schema, connect_file, find_program
from service.store.tables import all_tables

#: Tables whose rows make a store that someone would miss.
_MISSED = ("samples", "packed_hours", "model_versions", "api_keys", "alarms")


def _table_names() -> list[str]:
    return sorted([*all_tables().tables, "alembic_version"])


def back_up(url: URL, out: Path) -> dict[str, int]:
    """Write a backup of a store, also while a service works on it; return its rows by table.

    ``out``: a file that does not exist yet: an SQLite file, or a dump in PostgreSQL's custom
    format. Raises `StoreError` if it cannot be made, or is not whole.
    """
    if out.exists():
        raise StoreError(f"backup {out}: exists already; expected a new name")
    if url.get_backend_name() == "postgresql":
        return _dump(url, out)
    source = Path(url.database or "")
    if not source.is_file():
        raise StoreError(f"store {source}: there is no such file")
    return copy_sqlite(source, out)


def restore(url: URL, backup: Path, *, force: bool) -> dict[str, int]:
    """Put a backup in the place of a store on which no service works; return its rows by table.

    Sessions of browsers end; a key that was revoked after the backup is valid again. ``force`` also
    replaces a store that holds something; an SQLite file is kept under another name. Raises
    `StoreError` if the backup is not whole, or there is a store that holds something.
    """
    if not backup.is_file():
        raise StoreError(f"backup {backup}: there is no such file")
    if url.get_backend_name() == "postgresql":
        return _load(url, backup, force=force)
    return _restore_sqlite(Path(url.database or ""), backup, force=force)


def _restore_sqlite(path: Path, backup: Path, *, force: bool) -> dict[str, int]:
    _check_backup(backup)
    there = path.exists() and path.stat().st_size > 0
    if there and not force and _holds_something(path):
        raise StoreError(
            f"store {path}: is not empty; expected --force, which keeps it under another name"
        )
    new = path.with_name(f"{path.stem}-restored{path.suffix}")
    _remove(new)
    counts = copy_sqlite(backup, new)
    try:
        # An older backup is brought up to date before it takes its place.
        database = open_sqlite(URL.create("sqlite", database=str(new)))
        with contextlib.closing(database):
            with contextlib.closing(connect_file(new)) as connection:
                strange = complete_schema(connection)
            if strange:
                raise StoreError(f"backup {backup}: {strange}")
            with database.writing() as writer:
                renew(writer, RESTORED)
        with contextlib.closing(connect_file(new)) as connection:
            connection.execute("PRAGMA journal_mode = DELETE")
            connection.execute("DELETE FROM browser_sessions")
            restored = table_counts(connection)
        missing = {
            name: count
            for name, count in counts.items()
            if name != "browser_sessions" and restored.get(name, 0) < count
        }
        if missing:
            raise StoreError(f"backup {backup}: rows are missing after the restore: {missing}")
        if there:
            _keep(path)
        new.replace(path)
    except (sqlite3.Error, OSError) as error:
        raise StoreError(f"store {path}: cannot be restored ({error})") from error
    finally:
        _remove(new)
        for copy in new.parent.glob(f"{escape(new.stem)}-before-upgrade-*"):
            copy.unlink()
    return restored


def _check_backup(backup: Path) -> None:
    try:
        with contextlib.closing(connect_file(backup, read_only=True)) as connection:
            tables = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            if ("alembic_version",) not in tables.fetchall():
                problems = "not a store of bearing-twin"
            else:
                problems = find_program(connection) or check_sqlite(connection)
    except sqlite3.Error as error:
        problems = " ".join(str(error).split())
    if problems:
        raise StoreError(f"backup {backup}: {problems}")


def _holds_something(path: Path) -> bool:
    try:
        with contextlib.closing(connect_file(path)) as connection:
            return any(table_counts(connection).get(name) for name in _MISSED)
    except sqlite3.Error:
        return True  # damaged, or not ours


def _keep(path: Path) -> None:
    number = 1
    while (kept := path.with_name(f"{path.stem}-before-restore-{number}{path.suffix}")).exists():
        number += 1
    for companion in ("-wal", "-shm", ""):
        old = path.with_name(path.name + companion)
        if old.exists():
            old.rename(kept.with_name(kept.name + companion))


def _remove(path: Path) -> None:
    for companion in ("", "-wal", "-shm"):
        path.with_name(path.name + companion).unlink(missing_ok=True)


# ---------------------------------------------------------------------- PostgreSQL
def _dump(url: URL, out: Path) -> dict[str, int]:
    try:
        with new_part(out) as part:
            with psycopg.connect(_address(url)) as connection:
                connection.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
                snapshot = connection.execute("SELECT pg_export_snapshot()").fetchone()
                counts = _server_counts(connection)
                _run(
                    "pg_dump",
                    [
                        "--format=custom",
                        "--no-owner",
                        f"--file={part}",
                        f"--snapshot={(snapshot or '')[0]}",
                    ],
                    url,
                )
            dumped = _dumped_counts(part, url)
            if dumped != counts:
                raise StoreError(f"backup {out}: has {dumped} rows, expected {counts}")
            part.replace(out)
    except (psycopg.Error, OSError) as error:
        raise StoreError(f"backup {out}: {' '.join(str(error).split())}") from error
    return counts


def _load(url: URL, backup: Path, *, force: bool) -> dict[str, int]:
    counts = _dumped_counts(backup, url)
    try:
        with psycopg.connect(_address(url), autocommit=True) as connection:
            there = _server_counts(connection)
        if not force and any(there.get(name) for name in _MISSED):
            raise StoreError(
                f"service.database_url = {_shown(url)}: is not empty; expected --force, which "
                "replaces what it holds"
            )
        _replace(url, backup)
        with psycopg.connect(_address(url), autocommit=True) as connection:
            restored = _server_counts(connection)
            connection.execute("DELETE FROM browser_sessions")
            if "store_identity" in restored:  # else the upgrade of an older one makes it
                connection.execute(
                    "UPDATE store_identity SET incarnation = %s, origin = %s",
                    (secrets.token_hex(16), RESTORED),
                )
    except psycopg.Error as error:
        raise StoreError(
            f"service.database_url = {_shown(url)}: {' '.join(str(error).split())}"
        ) from error
    if restored != counts:
        raise StoreError(f"backup {backup}: {restored} rows were restored, expected {counts}")
    return restored


def _replace(url: URL, backup: Path) -> None:
    """Put a dump in the place of our tables, in one transaction."""
    drop = "".join(f'DROP TABLE IF EXISTS "{name}" CASCADE;\n' for name in _table_names())
    drop += "DROP FUNCTION IF EXISTS audit_only_grows() CASCADE;\n"
    environment = {**os.environ, **_environment(url)}
    quiet = "-c client_min_messages=error"
    environment["PGOPTIONS"] = f"{environment.get('PGOPTIONS', '')} {quiet}".strip()
    load = [
        _program("psql"),
        "--no-psqlrc",
        "--quiet",
        "--single-transaction",
        "--output=/dev/null",
    ]
    with (
        subprocess.Popen(
            [_program("pg_restore"), "--no-owner", "--file=-", str(backup)],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as reading,
        subprocess.Popen(
            [*load, "--set=ON_ERROR_STOP=1", "--file=-"],
            env=environment,
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as loading,
    ):
        assert reading.stdout is not None  # noqa: S101 - asked for
        assert loading.stdin is not None  # noqa: S101
        assert loading.stderr is not None  # noqa: S101
        with contextlib.suppress(BrokenPipeError):
            loading.stdin.write(drop.encode())
            shutil.copyfileobj(reading.stdout, loading.stdin)
            if reading.wait():
                loading.stdin.write(b"ROLLBACK; SELECT error;\n")
        with contextlib.suppress(BrokenPipeError):
            loading.stdin.close()
        said = loading.stderr.read().decode(errors="replace")
    if loading.returncode or reading.returncode:
        raise StoreError(f"backup {backup}: not restored ({' '.join(said.split())})")


def _server_counts(connection: "psycopg.Connection[tuple[object, ...]]") -> dict[str, int]:
    counts = {}
    for name in _table_names():
        (there,) = connection.execute("SELECT to_regclass(%s)", (name,)).fetchone() or (None,)
        if there is not None:
            row = connection.execute(f'SELECT COUNT(*) FROM "{name}"').fetchone()
            counts[name] = int(str((row or (0,))[0]))
    return counts


def _dumped_counts(dump: Path, url: URL) -> dict[str, int]:
    """Read a whole dump and count its rows by table; partitions count as their table."""
    names = _table_names()
    counts: dict[str, int] = {}
    command = [_program("pg_restore"), "--file=-", str(dump)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None  # noqa: S101 - asked for
        assert process.stderr is not None  # noqa: S101
        table = None
        for line in process.stdout:
            if table is not None:
                if line == b"\\.\n":
                    table = None
                else:
                    counts[table] += 1
            elif line.startswith(b"COPY "):
                name = line.split()[1].decode().rpartition(".")[2].strip('"')
                table = "samples" if name.startswith("samples_p") else name
                counts.setdefault(table, 0)
            elif line.startswith(b"CREATE TABLE "):
                name = line.split()[2].decode().rpartition(".")[2].strip('"')
                if name in names:
                    counts.setdefault(name, 0)
        said = process.stderr.read().decode(errors="replace")
    if process.returncode or "alembic_version" not in counts:
        reason = " ".join(said.split()) or "not a store of bearing-twin"
        raise StoreError(f"backup {dump}: {reason}")
    return dict(sorted(counts.items()))


def _run(program: str, arguments: Sequence[str], url: URL) -> None:
    ended = subprocess.run(
        [_program(program), *arguments],
        env={**os.environ, **_environment(url)},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise StoreError(f"{program}: {' '.join(ended.stderr.split())}")


def _program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        raise StoreError(
            f"{name}: not found; expected PostgreSQL's client programs, of the server's version, "
            "on the path"
        )
    return found


def _environment(url: URL) -> Mapping[str, str]:
    """How the programs connect: a password on a command line is read by everybody."""
    query = {name: value for name, value in url.query.items() if isinstance(value, str)}
    found = {
        "PGHOST": url.host or query.get("host"),
        "PGPORT": str(url.port or query.get("port") or ""),
        "PGUSER": url.username,
        "PGPASSWORD": None if url.password is None else str(url.password),
        "PGDATABASE": url.database,
        "PGOPTIONS": query.get("options"),
        "PGSSLMODE": query.get("sslmode"),
        "PGSSLROOTCERT": query.get("sslrootcert"),
    }
    return {name: value for name, value in found.items() if value}


def _address(url: URL) -> str:
    return url.set(drivername="postgresql").render_as_string(hide_password=False)


def _name(url: URL) -> str:
    return url.database or ""


def _shown(url: URL) -> str:
    return repr(url.render_as_string(hide_password=True))
