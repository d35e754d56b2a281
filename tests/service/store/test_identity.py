"""Which store this is, and whether it has what it confirmed: restores, failovers, other files."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import psycopg
import pytest
from postgresql import running_postgresql
from processes import wait_until

from adapters.samples import Sample
from service.bus.directory import Directory
from service.cell.start import deliver_earlier
from service.site.settings import load_settings
from service.store import AuditEntry, Outbox, Store, StoreUnavailableError
from service.store.backup import back_up, restore
from service.store.errors import StoreDoubtedError
from service.store.identity import FILE_NAME, Witness, forget
from service.store.opening import FILE_NAME as STORE_FILE
from service.store.opening import database_address

CONFIRM = AuditEntry(1, "eva", "", "store.confirm", "store")


def sample(asset: str, value: float) -> Sample:
    return Sample(asset, "x", int(value), value, 192, int(value))


def values(store: Store, asset: str) -> list[float | None]:
    return [one.value for one in store.samples.read(asset, None, 0, 2**62, 100)]


class Opened(ExitStack):
    """A store as a cell has it."""

    def __init__(self, folder: Path, url: str = "", begin_again: Callable[[], object] = int):
        super().__init__()
        self.store = self.enter_context(Store.open(url, folder))
        self.witness = self.enter_context(Witness(folder, "the store", begin_again))
        self.store.write_if(self.witness)

    def write(self, value: float) -> None:
        self.store.samples.write([sample("a", value)])


@pytest.mark.wires
def test_an_older_copy_files_no_sample_under_another_machine(tmp_path: Path) -> None:
    """Without any witness: numbers of channels are not older than the connection."""
    with running_postgresql() as server, Store.open(server.database(), tmp_path) as store:
        copy = server.folder / "copy"
        store.samples.write([sample("a1", 101), sample("a4", 401)])
        server.copy(copy)
        store.samples.write([sample("a2", 201)])
        server.fail_over(copy)
        for one in (sample("a3", 300), sample("a2", 203), sample("a3", 301)):
            for _ in range(3):
                try:
                    store.samples.write([one])
                    break
                except StoreUnavailableError:
                    continue
        assert values(store, "a3") == [300, 301]
        assert values(store, "a2") == [203]


@pytest.mark.wires
def test_an_older_copy_is_not_written_to_until_a_person_confirms_it(tmp_path: Path) -> None:
    ended: list[bool] = []
    with running_postgresql() as server:
        url = server.database()
        with Opened(tmp_path, url, lambda: ended.append(True)) as cell:
            copy = server.folder / "copy"
            cell.write(1)
            server.copy(copy)
            cell.write(2)
            cell.write(3)
            server.fail_over(copy)
            for _ in range(2):
                with pytest.raises(StoreDoubtedError, match="lacks 2 of 3 transactions"):
                    cell.write(4)
                with pytest.raises(StoreDoubtedError, match="bearing-twin db confirm"):
                    cell.store.identity.check()
            server.fail_over(copy)
            cell.store.identity.check()
            cell.write(4)  # the right one is there again
            server.fail_over(copy)
            with Store.open(url, tmp_path) as command:
                command.identity.confirm(CONFIRM)
                assert command.audit.page().items[0].action == "store.confirm"
            # What this process knows is of the other one: it ends, and the next one goes on.
            for _ in range(2):
                with pytest.raises(StoreDoubtedError, match="begins again"):
                    cell.write(5)
            assert ended == [True]
        with Opened(tmp_path, url) as cell:
            cell.write(5)
            assert values(cell.store, "a") == [1, 5]
        # The first one again: it was left behind, and a person has confirmed the other.
        server.fail_over(copy)
        with Opened(tmp_path, url) as cell, pytest.raises(StoreDoubtedError, match="another store"):
            cell.write(6)


def test_a_file_that_was_put_back_is_an_older_copy(tmp_path: Path) -> None:
    with Opened(tmp_path) as cell:
        cell.write(1)
    shutil.copy(tmp_path / STORE_FILE, tmp_path / "copy.db")
    with Opened(tmp_path) as cell:
        cell.write(2)
    shutil.copy(tmp_path / "copy.db", tmp_path / STORE_FILE)
    with Opened(tmp_path, begin_again=lambda: pytest.fail("nothing is known yet")) as cell:
        with pytest.raises(StoreDoubtedError, match="lacks 1 of 2 transactions"):
            cell.write(3)
        cell.store.write_if(None)
        cell.store.identity.confirm(CONFIRM)
        cell.store.write_if(cell.witness)
        cell.write(3)
        assert values(cell.store, "a") == [1, 3]


def test_a_confirmation_has_every_running_cell_begin_again(tmp_path: Path) -> None:
    """What others wrote may be missing, though nothing of this cell's own is."""
    ended: list[bool] = []
    with Opened(tmp_path, begin_again=lambda: ended.append(True)) as cell:
        cell.write(1)
        with Store.open("", tmp_path) as command:
            command.identity.confirm(CONFIRM)
        with pytest.raises(StoreDoubtedError, match="begins again"):
            cell.write(2)
        assert ended == [True]
    with Opened(tmp_path, begin_again=lambda: pytest.fail("it has just begun")) as cell:
        cell.write(2)


def test_a_web_process_learns_the_assets_of_another_store(tmp_path: Path) -> None:
    """Revisions of an older copy are no continuation of those that are known."""
    file = tmp_path / "site.toml"
    file.write_text('[service]\ndata_dir = "data"\n')
    settings = load_settings(file)
    with Store.open("", settings.data_dir) as store:
        directory = Directory(settings, store)
        for name in ("a", "b"):
            store.assets.change({name: {"bearing": "6311"}}, 1)
        directory.look()
        assert list(directory.ids()) == ["a", "b"]
        # An older copy: b was never there, and c gets the revision that b had.
        with store._database.writing() as connection:
            connection.exec_driver_sql("DELETE FROM provisioned_assets WHERE id = 'b'")
        store.assets.change({"c": {"bearing": "6311"}}, 1)
        store.identity.confirm(CONFIRM)
        directory.look()
        assert list(directory.ids()) == ["a", "c"]


def test_a_store_that_was_confirmed_once_is_not_confirmed_for_ever(tmp_path: Path) -> None:
    copy = tmp_path / "copy.db"

    def confirm() -> None:
        with Store.open("", tmp_path) as store:
            store.identity.confirm(CONFIRM)

    with Opened(tmp_path) as cell:
        cell.write(1)
    confirm()
    with Opened(tmp_path) as cell:
        cell.write(2)
    shutil.copy(tmp_path / STORE_FILE, copy)
    confirm()
    with Opened(tmp_path) as cell:
        cell.write(3)
    shutil.copy(copy, tmp_path / STORE_FILE)
    with Opened(tmp_path) as cell, pytest.raises(StoreDoubtedError, match="another store"):
        cell.write(4)


@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.wires)])
def test_a_restore_makes_another_store_of_it(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "postgresql":
        url = request.getfixturevalue("postgresql").database()
        with psycopg.connect(url) as admin:
            found = admin.execute("SELECT setting FROM pg_config WHERE name = 'BINDIR'").fetchone()
        assert found is not None
        monkeypatch.setenv("PATH", str(found[0]))
    else:
        url = ""
    address, backup = database_address(url, tmp_path), tmp_path / "backup"
    with Opened(tmp_path, url) as cell:
        cell.write(1)
        back_up(address, backup)
        cell.write(2)
    restore(address, backup, force=True)
    with Opened(tmp_path, url) as cell, pytest.raises(StoreDoubtedError, match="from a backup"):
        cell.write(3)
    forget(tmp_path)  # as the command does for its own data directory
    with Opened(tmp_path, url) as cell:
        cell.write(3)
        assert values(cell.store, "a") == [1, 3]


def test_another_data_directory_takes_the_store_that_is_there(tmp_path: Path) -> None:
    with Opened(tmp_path) as cell:
        cell.write(1)
    other = tmp_path / "other"
    with Opened(other, f"sqlite:///{tmp_path / STORE_FILE}") as cell:
        cell.write(2)
    with Opened(tmp_path) as cell:
        cell.write(3)
        assert values(cell.store, "a") == [1, 2, 3]


KILLED = """
import os, pathlib, sys
from service.store import Store
from service.store.identity import Witness
from adapters.samples import Sample
folder = pathlib.Path(sys.argv[1])
store, witness = Store.open("", folder), Witness(folder, "the store")
store.write_if(witness)
for k in range(7):
    store.samples.write([Sample("a", "x", k, 1.0, 192, k)])
os._exit(9)
"""


@pytest.mark.wires
def test_a_killed_process_leaves_what_was_confirmed(tmp_path: Path) -> None:
    with Opened(tmp_path) as cell:
        cell.write(100)
    shutil.copy(tmp_path / STORE_FILE, tmp_path / "copy.db")
    assert subprocess.run([sys.executable, "-c", KILLED, tmp_path], check=False).returncode == 9
    for name in (STORE_FILE, f"{STORE_FILE}-wal", f"{STORE_FILE}-shm"):
        (tmp_path / name).unlink(missing_ok=True)
    shutil.copy(tmp_path / "copy.db", tmp_path / STORE_FILE)
    with Opened(tmp_path) as cell, pytest.raises(StoreDoubtedError, match="lacks 7 of 8"):
        cell.write(8)


def test_a_transaction_that_was_rolled_back_is_not_expected(tmp_path: Path) -> None:
    with Opened(tmp_path) as cell:
        cell.write(1)
        with pytest.raises(ZeroDivisionError), cell.store._database.writing():
            raise ZeroDivisionError
        cell.write(2)
        assert values(cell.store, "a") == [1, 2]


@pytest.mark.parametrize("content", [b"", b"\xff", b"12\n{}", b"00000000000000000009 00000000\n{}"])
def test_a_damaged_file_of_what_was_seen_holds_nothing_up(tmp_path: Path, content: bytes) -> None:
    with Opened(tmp_path) as cell:
        cell.write(1)
    (tmp_path / FILE_NAME).write_bytes(content)
    with Opened(tmp_path) as cell:
        cell.write(2)
        assert values(cell.store, "a") == [1, 2]


@pytest.mark.parametrize("replaced", [True, False])
def test_a_file_that_is_replaced_or_removed_under_a_running_service_is_not_written_to(
    tmp_path: Path, replaced: bool
) -> None:
    """What goes to the open connection would go to a file that has no name any more."""
    with Store.open("", tmp_path) as store:
        store.samples.write([sample("a", 1)])
        back_up(database_address("", tmp_path), tmp_path / "backup.db")
        if replaced:
            (tmp_path / "backup.db").replace(tmp_path / STORE_FILE)
        else:
            (tmp_path / STORE_FILE).unlink()
        with pytest.raises(StoreDoubtedError, match="removed or replaced while the service runs"):
            store.samples.write([sample("a", 2)])


def test_a_cell_of_a_fleet_reads_its_devices_though_its_store_is_another_one(
    tmp_path: Path,
) -> None:
    """What earlier runs left must not hold it up until a person comes."""
    with Opened(tmp_path) as cell:
        cell.write(1)
    shutil.copy(tmp_path / STORE_FILE, tmp_path / "copy.db")
    with Opened(tmp_path) as cell:
        cell.write(2)
    shutil.copy(tmp_path / "copy.db", tmp_path / STORE_FILE)
    with Opened(tmp_path) as cell, Outbox.open(tmp_path, cell.store) as outbox:
        outbox.record(CONFIRM)
        assert not outbox.flush(30.0)
        deliver_earlier(tmp_path, cell.store, outbox)
        assert outbox.waiting == 1
        with Store.open("", tmp_path) as command:
            command.identity.confirm(CONFIRM)
        wait_until(lambda: outbox.flush(1.0), 30.0, "delivered")
        deliver_earlier(tmp_path, cell.store, outbox)


def test_a_violated_key_is_no_fault_of_the_sample(store: Store) -> None:
    """As with a database whose channels are not those that the process remembers."""
    store.samples.write([sample("a", 1)])
    with store._database.writing() as connection:
        if connection.dialect.name == "sqlite":
            connection.exec_driver_sql("PRAGMA defer_foreign_keys = ON")
        for table in ("samples", "stale_rollups", "channels"):
            connection.exec_driver_sql(f"DELETE FROM {table}")
    hour_us = 3_600_000_000
    with pytest.raises(StoreUnavailableError, match="do not fit together"):
        store.samples.write([sample("a", hour_us)])
    assert store.samples.write([sample("a", hour_us)]) == (1, 0)
    assert values(store, "a") == [hour_us]
