"""A restore takes the rows of a backup, and none of the programs that someone put beside them."""

import contextlib
import sqlite3
from collections.abc import Sequence
from pathlib import Path

import pytest
from sqlalchemy import create_engine
from sqlalchemy.engine import URL

from service.security.keys import create_key, list_keys
from service.store import Store, StoreError, lock_database
from service.store.backup import back_up, restore
from service.store.migrations import upgrade
from service.store.opening import FILE_NAME, database_address

RISE = (
    "CREATE TRIGGER rise AFTER INSERT ON audit BEGIN UPDATE api_keys SET role = 'admin'; END",
    "DROP TRIGGER audit_no_update",
    "DROP TRIGGER audit_no_delete",
)


def rewritten(table: str, old: str, new: str) -> str:
    """Write the text of a table as an editor of the file would, without a look at its rows."""
    return (
        f"UPDATE sqlite_master SET sql = replace(sql, '{old}', '{new}') WHERE name = '{table}' "
        "AND type = 'table'"
    )


@pytest.fixture
def backup(tmp_path: Path) -> Path:
    folder = tmp_path / "made"
    with Store.open("", folder) as store:
        create_key(store, "viewer")
    out = tmp_path / "backup.db"
    back_up(database_address("", folder), out)
    return out


@pytest.fixture
def target(tmp_path: Path) -> URL:
    folder = tmp_path / "target"
    folder.mkdir()
    return database_address("", folder)


def change(path: Path, statements: Sequence[str]) -> None:
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as connection:
        for statement in statements:
            connection.execute(statement)


def made(url: URL) -> dict[tuple[str, str], str]:
    with contextlib.closing(sqlite3.connect(url.database or "")) as connection:
        rows = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
    return {(kind, name): sql for kind, name, sql in rows}


@pytest.mark.parametrize(
    ("statements", "named"),
    [
        (RISE, "trigger 'rise'"),
        (["CREATE VIEW seen AS SELECT * FROM api_keys"], "view 'seen'"),
        (["CREATE VIRTUAL TABLE words USING fts5(word)"], "table 'words'"),
        (["CREATE TABLE extra (id INTEGER)"], "table 'extra'"),
        (["CREATE INDEX slow ON audit (length(detail))"], "index 'slow'"),
        (
            [
                "DROP INDEX uq_channels_asset_name",
                "CREATE INDEX uq_channels_asset_name ON audit (id)",
            ],
            "index 'uq_channels_asset_name'",
        ),
        (
            [
                "DROP TRIGGER audit_no_update",
                "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit BEGIN SELECT 1; END",
            ],
            "trigger 'audit_no_update'",
        ),
        (["ALTER TABLE api_keys ADD COLUMN rights VARCHAR AS (role || 'x')"], "table 'api_keys'"),
        (
            [
                "PRAGMA writable_schema = ON",
                rewritten("api_keys", "DEFAULT ''''", "DEFAULT (hex(randomblob(4)))"),
            ],
            "table 'api_keys'",
        ),
        (
            [
                "PRAGMA writable_schema = ON",
                rewritten("api_keys", "role VARCHAR NOT", "role VARCHAR CHECK (role > ''a'') NOT"),
            ],
            "table 'api_keys'",
        ),
        (["DROP TABLE runs"], "table 'runs'"),
    ],
)  # fmt: skip
def test_what_is_not_ours_is_refused_and_named(
    backup: Path, target: URL, statements: Sequence[str], named: str
) -> None:
    change(backup, statements)
    with pytest.raises(StoreError, match=rf"^backup .*backup\.db: {named} is ") as refused:
        restore(target, backup, force=False)
    assert "\n" not in str(refused.value)
    assert list(Path(target.database or "").parent.iterdir()) == []


def test_no_trigger_of_an_older_backup_runs_before_it_is_refused(
    tmp_path: Path, target: URL
) -> None:
    """The upgrade of the tables makes some of them again, and so would hide what is strange."""
    old = tmp_path / "old.db"
    engine = create_engine(f"sqlite:///{old}")
    upgrade(engine, "0005")
    engine.dispose()
    change(old, ["CREATE TRIGGER rise AFTER UPDATE ON alarms BEGIN DELETE FROM api_keys; END"])
    with pytest.raises(StoreError, match=r"old\.db: trigger 'rise' is"):
        restore(target, old, force=False)


def test_triggers_and_indexes_of_ours_that_are_missing_are_made(backup: Path, target: URL) -> None:
    restore(target, backup, force=False)
    whole = made(target)
    change(
        backup,
        [
            "DROP TRIGGER audit_no_update",
            "DROP TRIGGER audit_no_delete",
            "DROP INDEX uq_channels_asset_name",
            "DROP INDEX ix_kept_forecasts_due_us",
        ],
    )
    restore(target, backup, force=True)
    assert made(target) == whole
    with (
        contextlib.closing(sqlite3.connect(target.database or "")) as connection,
        pytest.raises(sqlite3.IntegrityError, match="only grows"),
    ):
        connection.execute("UPDATE audit SET who = 'someone else'")
    with Store.open("", Path(target.database or "").parent) as store:
        assert [key.role for key in list_keys(store)] == ["viewer"]


def test_what_the_planner_has_counted_is_no_program(backup: Path, target: URL) -> None:
    change(backup, ["ANALYZE"])
    restore(target, backup, force=False)


@pytest.mark.parametrize("revision", ["0001", "0005", "0012", "0020", "0024"])
def test_a_backup_of_any_older_version_has_nothing_strange(
    tmp_path: Path, target: URL, revision: str
) -> None:
    """The upgrade leaves tables with another text: quotes, spaces, the order of what is in them."""
    old = tmp_path / "old.db"
    engine = create_engine(f"sqlite:///{old}")
    upgrade(engine, revision)
    engine.dispose()
    # Also under a name that means something to a search for files.
    place = target.set(database=str(tmp_path / "target" / "site[1].db"))
    restore(place, old, force=False)
    assert ("trigger", "audit_no_delete") in made(place)
    assert list((tmp_path / "target").glob("*before-upgrade*")) == []


def test_no_connection_of_a_store_trusts_what_its_file_says(tmp_path: Path) -> None:
    with Store.open("", tmp_path) as store:
        for session in (store._database.reading, store._database.writing):
            with session() as connection:
                asked = connection.exec_driver_sql("PRAGMA trusted_schema").scalar()
                assert asked == 0, session


@pytest.mark.parametrize("folder", ["bench #3", "100%25", "what?mode=rw", "käse %"])
def test_any_name_that_a_backup_can_have_can_be_restored(tmp_path: Path, folder: str) -> None:
    place = tmp_path / folder
    with Store.open("", place) as store:
        create_key(store, "viewer")
    out = place / f"{folder}.db"
    back_up(database_address("", place), out)
    assert restore(database_address("", place), out, force=True)["api_keys"] == 1
    assert (place / FILE_NAME).is_file()
    assert sorted(one.name for one in tmp_path.iterdir()) == [folder]


@pytest.mark.parametrize("planted", ["backup.db.part", f"{FILE_NAME}.lock"])
def test_no_file_beside_a_store_or_a_backup_is_written_through_a_link(
    tmp_path: Path, planted: str
) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    Store.open("", tmp_path).close()
    (tmp_path / planted).unlink(missing_ok=True)
    (tmp_path / planted).symlink_to(victim)
    if planted.endswith(".lock"):
        with pytest.raises(StoreError, match=r"cannot be locked"):
            lock_database("", tmp_path, lambda: None)
    else:
        back_up(database_address("", tmp_path), tmp_path / "backup.db")
    assert victim.read_text() == "mine"
