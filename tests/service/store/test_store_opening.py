import contextlib
import math
import os
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from patience import patience
from sqlalchemy import create_engine, insert, inspect

from adapters.samples import Sample
from service.store import (
    DataDirectoryInUseError,
    Store,
    StoreError,
    lock_data_directory,
    migrations,
)
from service.store.migrations import last_revision, upgrade
from service.store.opening import FILE_NAME
from service.store.postgresql import PARTITION_US
from service.store.salvage import salvage_store
from service.store.tables import Base, PackedHourRow, SampleBlockRow


def python(code: str, *arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def test_a_new_store_is_made_with_its_directory_and_found_again(tmp_path: Path) -> None:
    data_dir = tmp_path / "not" / "there"
    with Store.open("", data_dir) as store:
        store.samples.write([Sample("a", "x", 5, 1.0, 192, 5)])
    assert (data_dir / FILE_NAME).is_file()
    with Store.open("", data_dir) as store:
        assert store.samples.latest("a")["x"].value == 1.0


def test_a_url_names_another_file(tmp_path: Path) -> None:
    Store.open(f"sqlite:///{tmp_path}/elsewhere/my.db", tmp_path / "var").close()
    assert (tmp_path / "elsewhere" / "my.db").is_file()
    assert not (tmp_path / "var" / FILE_NAME).exists()


def test_the_file_keeps_a_write_ahead_log_and_commits_reach_the_disk(sqlite_store: Store) -> None:
    database = sqlite_store._database
    for connect in (database.reading, database.writing):
        with connect() as connection:
            assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
            assert connection.exec_driver_sql("PRAGMA synchronous").scalar() == 2
            assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1


def shape_of(path: Path) -> dict[str, object]:
    """Tables with their columns in order, indexes, triggers and references of an SQLite file."""
    with contextlib.closing(sqlite3.connect(path)) as connection:
        made: dict[str, object] = {}
        for kind, name, sql in connection.execute("SELECT type, name, sql FROM sqlite_master"):
            if kind == "table":
                made[name] = [
                    sorted(connection.execute(f"PRAGMA {question}({name})").fetchall())
                    for question in ("table_info", "foreign_key_list")
                ]
            else:
                made[name] = sql and re.sub(r"\s+", " ", sql)
        made["revision"] = connection.execute("SELECT version_num FROM alembic_version").fetchall()
        return made


def test_a_new_file_is_made_as_all_migrations_would(tmp_path: Path) -> None:
    """Salvage reads the pages of a damaged file by the order of the columns in a new one."""
    Store.open("", tmp_path / "new").close()
    migrated = tmp_path / "migrated.db"
    engine = create_engine(f"sqlite:///{migrated}")
    upgrade(engine)
    engine.dispose()
    assert shape_of(tmp_path / "new" / "bearing-twin.db") == shape_of(migrated)


@pytest.mark.wires
def test_the_last_migration_is_known_without_loading_alembic(tmp_path: Path) -> None:
    assert ScriptDirectory.from_config(migrations._config()).get_current_head() == last_revision()
    text = (
        "import sys; from pathlib import Path; from service.store import Store; "
        f"Store.open('', Path({str(tmp_path)!r})).close(); sys.exit('alembic' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", text], check=True)


def test_the_migrations_make_the_tables_that_the_program_expects(store: Store) -> None:
    with store._database.reading() as connection:
        context = MigrationContext.configure(
            connection,
            opts={
                "compare_type": True,
                "compare_server_default": True,
            },
        )
        assert compare_metadata(context, Base.metadata) == []
        inspector = inspect(connection)
        for table in Base.metadata.tables.values():
            # compare_metadata sees neither of these
            made = {index["name"]: index for index in inspector.get_indexes(table.name)}
            for index in table.indexes:
                options = made[str(index.name)].get("dialect_options", {})
                kind = connection.dialect.name
                # The tables name it for SQLite only: those of PostgreSQL are made by migrations,
                # and the server writes it in its own words, with the same values.
                made_where, wanted = (
                    re.findall(r"'\w+'", str(where))
                    for where in (
                        options.get(f"{kind}_where"),
                        index.dialect_options["sqlite"]["where"],
                    )
                )
                assert made_where == wanted
            assert inspector.get_pk_constraint(table.name)["constrained_columns"] == [
                column.name for column in table.primary_key
            ]
        if connection.dialect.name == "sqlite":
            sql = connection.exec_driver_sql("SELECT sql FROM sqlite_master WHERE name = 'samples'")
            assert "WITHOUT ROWID" in sql.scalar_one()
        else:
            kind = connection.exec_driver_sql(
                "SELECT relkind FROM pg_class WHERE relname = 'samples'"
            )
            assert kind.scalar_one() == "p", "partitioned"


def test_an_older_file_loses_its_check_of_channels_and_no_sample(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    engine = create_engine(f"sqlite:///{path}")
    upgrade(engine, "0003")
    engine.dispose()
    with contextlib.closing(sqlite3.connect(path)) as old:
        assert old.execute("PRAGMA foreign_key_list(samples)").fetchall()
        old.execute("INSERT INTO channels VALUES (7, 'a', 'x')")
        old.execute("INSERT INTO samples VALUES (7, 5, 1.5, 192)")
        old.commit()
    with Store.open("", tmp_path) as store:
        assert store.samples.read("a", None, 0, 9, 9) == [("x", 5, 1.5, 192, None)]
        assert store.samples.write([Sample("a", "y", 6, 2.5, 192, 6)]) == (1, 0)
    with contextlib.closing(sqlite3.connect(path)) as new:
        assert not new.execute("PRAGMA foreign_key_list(samples)").fetchall()
        assert new.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


#: Made by the version before, of samples 5, 1000007 and 2000001 us after a full hour: good, without
#: a value (24), good.
BLOCK = (1, 2676025315, bytes.fromhex(
    "83a574696d6573c42370636f210300c104010402000000100028c0b653f5df3200ac0000004048e8f1117a00a676"
    "616c75657391c42f70636f210300c1040106020000003200080000000000900618000000000000500d3000000000"
    "000000fc7f00240000a97175616c697469657391c41770636f210300c1040107020000001000c00040a800a800"
))  # fmt: skip
HOUR_OF_BLOCK_US = 1_789_999_200_000_000


@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.wires)])
def test_samples_from_before_received_times_stay_as_they_are(
    request: pytest.FixtureRequest, tmp_path: Path, kind: str
) -> None:
    begin_us = HOUR_OF_BLOCK_US
    url = engine_url = f"sqlite:///{tmp_path / FILE_NAME}"
    if kind == "postgresql":
        url = request.getfixturevalue("postgresql").database(empty=True)
        engine_url = url.replace("postgresql:", "postgresql+psycopg:")
    engine = create_engine(engine_url)
    upgrade(engine, "0015")
    where = "SELECT rootpage FROM sqlite_master WHERE name = 'samples'"
    with engine.begin() as old:
        old.exec_driver_sql("INSERT INTO channels VALUES (1, 'a', 'x'), (2, 'a', 'y')")
        if kind == "postgresql":
            where = "SELECT pg_relation_filenode('samples_p813')"
            first_us = 813 * PARTITION_US
            assert first_us <= begin_us < first_us + PARTITION_US
            old.exec_driver_sql(
                "CREATE TABLE samples_p813 PARTITION OF samples "
                f"FOR VALUES FROM ({first_us}) TO ({first_us + PARTITION_US})"
            )
            old.exec_driver_sql("SELECT setval('channels_id_seq', 2)")
        old.exec_driver_sql(f"INSERT INTO samples VALUES (1, {begin_us + 4 * 10**9}, 1.5, 192)")
        codec, crc, data = BLOCK
        old.execute(insert(SampleBlockRow).values(id=1, codec=codec, crc=crc, data=data))
        old.execute(
            insert(PackedHourRow).values(
                channel_id=2, hour_us=begin_us, block_id=1, position=0, sample_count=3,
                first_us=begin_us + 5, last_us=begin_us + 2_000_001,
            )
        )  # fmt: skip
        place = old.exec_driver_sql(where).scalar()
    engine.dispose()
    with Store.open(url, tmp_path, migrate=True) as store:
        with store._database.reading() as connection:
            assert connection.exec_driver_sql(where).scalar() == place, "not written again"
        before = [
            ("y", begin_us + 5, 20.5, 192, None),
            ("y", begin_us + 1_000_007, None, 24, None),
            ("y", begin_us + 2_000_001, 21.25, 192, None),
            ("x", begin_us + 4 * 10**9, 1.5, 192, None),
        ]
        assert store.samples.read("a", None, 0, 2**62, 9) == before
        # One that mends and one that is late join the hour, with their own received times.
        later = [
            Sample("a", "y", begin_us + 1_000_007, 20.75, 192, begin_us + 7),
            Sample("a", "y", begin_us + 3_000_000, math.nan, 24, begin_us + 8),
            Sample("a", "y", begin_us + 5, 9.0, 192, begin_us + 9),
        ]
        assert store.samples.write(later) == (2, 1)
        mended, late = tuple(later[0][1:]), ("y", begin_us + 3_000_000, None, 24, begin_us + 8)
        after = [before[0], mended, before[2], late, before[3]]
        assert store.samples.read("a", None, 0, 2**62, 9) == after
        while store.rollups.refresh(begin_us + 10**11):
            pass
        assert store.packing.pack(begin_us + 10**11) == 1, "the other hour is packed"
        assert store.samples.read("a", None, 0, 2**62, 9) == after
        assert store.find_damage() is None


def test_salvage_finds_rows_from_before_received_times(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    engine = create_engine(f"sqlite:///{path}")
    upgrade(engine, "0015")
    engine.dispose()
    with contextlib.closing(sqlite3.connect(path)) as old:
        old.execute("INSERT INTO channels VALUES (7, 'a', 'x')")
        old.execute("INSERT INTO samples VALUES (7, 5, 1.5, 192)")
        # So that no tree leads to the row.
        old.execute("PRAGMA writable_schema = ON")
        old.execute("DELETE FROM sqlite_master WHERE name = 'samples'")
        old.commit()
    assert salvage_store(path, "a test").rows["samples"] == 1
    with Store.open("", tmp_path) as store:
        assert store.samples.read("a", None, 0, 9, 9) == [("x", 5, 1.5, 192, None)]


@pytest.mark.parametrize(
    "url",
    ["postgresql+asyncpg://u:secret@h/d", "sqlite://", "sqlite:///:memory:", "mysql://h/d", "??"],
)
def test_a_url_that_cannot_be_used_is_named_without_its_password(tmp_path: Path, url: str) -> None:
    with pytest.raises(StoreError, match=r"service\.database_url = .*expected empty, sqlite") as e:
        Store.open(url, tmp_path)
    assert "secret" not in str(e.value)


def test_another_programs_database_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE recipes (cake TEXT)")
    connection.close()
    with pytest.raises(StoreError, match=r"bearing-twin\.db: holds the tables of another program"):
        Store.open("", tmp_path)
    engine = create_engine(f"sqlite:///{path}")
    assert inspect(engine).get_table_names() == ["recipes"]
    engine.dispose()


def test_a_newer_store_is_refused(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store, store._database.writing() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(StoreError, match=r"\(9999\) are those of a newer version"):
        Store.open("", tmp_path)


def test_a_file_that_is_no_database_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / FILE_NAME
    path.write_bytes(b"precious notes\n" * 1000)
    with pytest.raises(StoreError, match=r"bearing-twin.db: not an SQLite database"):
        Store.open("", tmp_path)
    assert path.read_bytes() == b"precious notes\n" * 1000


def test_a_damaged_store_is_refused(tmp_path: Path) -> None:
    Store.open("", tmp_path).close()
    path = tmp_path / FILE_NAME
    content = bytearray(path.read_bytes())
    content[100:4096] = os.urandom(3996)
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"bearing-twin.db: .*malformed"):
        Store.open("", tmp_path)


def test_a_data_directory_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "var").write_text("")
    with pytest.raises(StoreError, match=r"data directory .*var: cannot be made"):
        Store.open("", tmp_path / "var")
    with pytest.raises(StoreError, match=r"data directory .*var: cannot be used"):
        lock_data_directory(tmp_path / "var")


def test_a_directory_in_place_of_the_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).mkdir()
    with pytest.raises(StoreError, match=r"bearing-twin.db: cannot be opened; expected a path"):
        Store.open("", tmp_path)


@pytest.mark.wires
@pytest.mark.parametrize("there_before", [False, True])
def test_a_store_that_may_not_be_written_is_refused(tmp_path: Path, there_before: bool) -> None:
    data_dir = tmp_path / "var"
    data_dir.mkdir()
    if there_before:
        Store.open("", data_dir).close()
        (data_dir / FILE_NAME).chmod(0o444)
    data_dir.chmod(0o555)
    for folder in (tmp_path, *tmp_path.parents):
        if folder == Path(tempfile.gettempdir()):
            break
        folder.chmod(0o755)
    code = (
        "import os, sys, pathlib\n"
        "from service.store import Store, StoreError\n"
        "if os.getuid() == 0: os.setuid(65534)\n"  # root may write everywhere
        "try: Store.open('', pathlib.Path(sys.argv[1]))\n"
        "except StoreError as error: print(error)\n"
    )
    said, _ = python(code, str(data_dir)).communicate(timeout=patience(180))
    assert said.startswith(f"store {data_dir}/{FILE_NAME}: ")
    assert "may" in said
    assert said.count("\n") == 1


@pytest.mark.wires
def test_opened_twice_in_a_process_it_keeps_its_log_from_other_programs(tmp_path: Path) -> None:
    """Closing any descriptor of the file would drop the locks that SQLite holds for all."""
    log = tmp_path / f"{FILE_NAME}-wal"
    code = (
        "import sys, pathlib\n"
        "from service.store import Store\n"
        "Store.open('', pathlib.Path(sys.argv[1])).close()\n"
    )
    with Store.open("", tmp_path) as cell:
        cell.samples.write([Sample("a", "x", 5, 1.0, 192, 5)])
        with Store.open("", tmp_path) as web:
            assert python(code, str(tmp_path)).communicate(timeout=patience(180))[0] == ""
            assert log.exists(), "another program that ends takes the log for its own to remove"
            assert len(web.samples.read("a", None, 0, 10, 10)) == 1


@pytest.mark.wires
def test_programs_that_start_together_make_one_store(tmp_path: Path) -> None:
    code = (
        "import sys, pathlib\n"
        "from adapters.samples import Sample\n"
        "from service.store import Store\n"
        "sys.stdin.read()\n"
        "with Store.open('', pathlib.Path(sys.argv[1])) as store:\n"
        "    store.samples.write([Sample('a', 'x', int(sys.argv[2]), 1.0, 192, 0)])\n"
    )
    programs = [python(code, str(tmp_path), str(number)) for number in range(4)]
    results = [program.communicate(timeout=patience(180))[0] for program in programs]
    assert results == [""] * 4
    with Store.open("", tmp_path) as store:
        assert len(store.samples.read("a", None, 0, 10, 10)) == 4


HOLD = (
    "import sys, pathlib\n"
    "from service.store import lock_data_directory\n"
    "with lock_data_directory(pathlib.Path(sys.argv[1])):\n"
    "    print('held', flush=True)\n"
    "    sys.stdin.read()\n"
)


@pytest.mark.wires
def test_a_second_service_on_the_directory_is_refused_and_told_of_the_first(tmp_path: Path) -> None:
    first = python(HOLD, str(tmp_path))
    assert first.stdout is not None
    assert first.stdout.readline() == "held\n"
    with pytest.raises(DataDirectoryInUseError, match=rf"{tmp_path}.*\(process {first.pid}\)"):
        lock_data_directory(tmp_path)
    with Store.open("", tmp_path) as store:  # a tool beside the service
        key = store.access.add_key(
            prefix="p", sha256="h", role="viewer", created_us=1, expires_us=None
        )
        assert store.access.find_key("h") == key
    first.communicate(timeout=patience(180))
    lock_data_directory(tmp_path).close()


@pytest.mark.wires
def test_a_killed_service_leaves_no_lock(tmp_path: Path) -> None:
    first = python(HOLD, str(tmp_path))
    assert first.stdout is not None
    first.stdout.readline()
    first.send_signal(signal.SIGKILL)
    first.communicate(timeout=patience(180))
    with lock_data_directory(tmp_path) as lock:
        with pytest.raises(DataDirectoryInUseError, match=rf"process {os.getpid()}"):
            lock_data_directory(tmp_path)
        lock.close()
        lock_data_directory(tmp_path).close()
