"""Changes that wait for a store which is away: on the disk, in order, written once."""

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from alarm_bench import STORED
from patience import patience
from postgresql import PostgreSQL
from processes import wait_until
from sqlalchemy import Connection

from service.store import AlarmChange, AlarmTransition, AuditEntry, Outbox, Store, StoreError
from service.store.opening import FILE_NAME
from service.store.outbox import FILE_NAME as OUTBOX_FILE
from service.store.outbox import _checksum

pytestmark = pytest.mark.wires

PATIENCE_S = 30.0


def change(time_us: int, state: str = "UNACK", alarm_id: str = "first") -> AlarmChange:
    alarm = replace(STORED, id=alarm_id, state=state, since_us=time_us)
    line = AlarmTransition(
        alarm_id,
        "a",
        alarm.kind,
        alarm.channel,
        alarm.level,
        time_us,
        "",
        state,
        "eva",
        "",
        1.0,
        "",
    )
    return AlarmChange(alarm, (line,))


def long_change(time_us: int) -> AlarmChange:
    """An event as long as eight usual ones."""
    line = AlarmTransition(None, "a", "", "", "", time_us, "", "", "", "", None, "x" * 8000)
    return AlarmChange(None, (line,))


def audit_line(time_us: int) -> AuditEntry:
    return AuditEntry(time_us, "operator bt_1", "10.0.0.9", "alarm.acknowledge", f"alarm {time_us}")


#: An alarm is over and the next one of its kind is raised: sent again later it would be refused.
STORY = [change(1), audit_line(2), change(3, "ACKED"), change(4, "NORM"), change(5, alarm_id="2nd")]


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Another program holds the right to write."""
    with closing(sqlite3.connect(folder / FILE_NAME, isolation_level=None)) as intruder:
        intruder.execute("BEGIN EXCLUSIVE")
        yield
        intruder.execute("ROLLBACK")


def told(store: Store) -> list[int]:
    """What journal and trail hold, in the order in which each was written."""
    journal = [line.time_us for line in store.alarms.journal().items[::-1]]
    assert [entry.time_us for entry in store.audit.page().items] == [2]
    return journal


def record(outbox: Outbox, *changes: AlarmChange | AuditEntry) -> None:
    for one in changes:
        outbox.record(one)


def written(outbox: Outbox) -> Callable[[], bool]:
    return lambda: outbox.flush(1.0)


def test_changes_are_written_in_order(store: Store, tmp_path: Path) -> None:
    with Outbox.open(tmp_path, store) as outbox:
        record(outbox, *STORY)
        assert outbox.flush(PATIENCE_S)
        assert (outbox.waiting, told(store)) == (0, [1, 3, 4, 5])
        assert [alarm.id for alarm in store.alarms.load()] == ["2nd"]


class Commits:
    """A witness that counts the transactions of a store."""

    def __init__(self, store: Store) -> None:
        self.count = 0
        store.write_if(self)

    def admit(self, connection: Connection) -> int:
        return self.count

    def committed(self, number: int) -> None:
        self.count = number + 1

    def check(self, connection: Connection) -> None: ...


@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.wires)])
def test_what_waits_is_written_in_few_transactions(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    url = request.getfixturevalue("postgresql").database() if kind == "postgresql" else ""
    with Store.open(url, tmp_path) as store:
        with store._database.writing(), Outbox.open(tmp_path, store) as outbox:
            record(outbox, *map(change, range(1, 101)))
            outbox.flush(0)
        commits = Commits(store)
        with Outbox.open(tmp_path, store) as outbox:
            assert outbox.flush(PATIENCE_S)
        assert commits.count == 5
        assert [one.time_us for one in store.alarms.journal().items[::-1]] == [*range(1, 101)]


@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.wires)])
def test_one_that_is_refused_takes_none_of_its_portion_with_it(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    url = request.getfixturevalue("postgresql").database() if kind == "postgresql" else ""
    of_no_alarm = replace(change(50).lines[0], alarm_id="never stored")
    with Store.open(url, tmp_path) as store:
        with store._database.writing(), Outbox.open(tmp_path, store) as outbox:
            record(outbox, *map(change, range(1, 50)), AlarmChange(None, (of_no_alarm,)))
            record(outbox, *map(change, range(51, 101)))
            outbox.flush(0)
        commits = Commits(store)
        with Outbox.open(tmp_path, store) as outbox:
            assert outbox.flush(PATIENCE_S)
            assert outbox.refused == 1
        assert commits.count == 4 + 20
        times = [line.time_us for line in store.alarms.journal(limit=200).items[::-1]]
        assert times == [*range(1, 101)], "the 50th is the line that says that it is refused"
        (refused,) = store.refused.list()
        assert "never stored" in refused.document


def test_a_locked_store_makes_nobody_wait_and_a_restart_writes_first_what_waits(
    sqlite_store: Store, tmp_path: Path
) -> None:
    with locked(tmp_path):
        with Outbox.open(tmp_path, sqlite_store) as outbox:
            record(outbox, *STORY[:4])
            assert not outbox.flush(PATIENCE_S)
            assert outbox.waiting == 4
            assert "locked" in str(outbox.problem)
        with Outbox.open(tmp_path, sqlite_store) as outbox:
            assert outbox.waiting == 4
            assert outbox.load_alarms() == []
            outbox.record(STORY[4])
            outbox.flush(0)
    with Outbox.open(tmp_path, sqlite_store) as outbox:
        assert [alarm.id for alarm in outbox.load_alarms()] == ["2nd"]
        wait_until(written(outbox), PATIENCE_S, "the store has all")
        assert told(sqlite_store) == [1, 3, 4, 5]


@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.wires)])
def test_what_was_written_before_a_crash_is_not_written_again(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """The process dies after the store's commit and before the file has forgotten."""
    url = request.getfixturevalue("postgresql").database() if kind == "postgresql" else ""
    file, before = tmp_path / OUTBOX_FILE, tmp_path / "before.db"
    with Store.open(url, tmp_path) as store, store._database.writing():
        with Outbox.open(tmp_path, store) as outbox:
            record(outbox, *STORY)
            outbox.flush(0)
        shutil.copy(file, before)
    with Store.open(url, tmp_path) as store:
        for _ in range(2):
            with Outbox.open(tmp_path, store) as outbox:
                assert outbox.flush(PATIENCE_S)
            assert told(store) == [1, 3, 4, 5]
            shutil.copy(before, file)
        for number in (6, 7):
            shutil.copy(before, file)  # an old copy of the data directory
            with Outbox.open(tmp_path, store) as outbox:
                assert [alarm.id for alarm in outbox.load_alarms()] == ["2nd"]
                outbox.record(change(number, "ACKED", "2nd"))
                assert outbox.flush(PATIENCE_S)
        assert told(store) == [1, 3, 4, 5, 6, 7], "what is new is not taken for what is known"


_KILLED = """
import os, signal, sys
from pathlib import Path
from test_outbox import STORY, record
from service.store import Outbox, Store
folder = Path(sys.argv[1])
outbox = Outbox.open(folder, Store.open("", folder))
print("open", flush=True)
sys.stdin.readline()
record(outbox, *STORY)
outbox.flush(1)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_loses_nothing(tmp_path: Path) -> None:
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    child = subprocess.Popen(
        [sys.executable, "-c", _KILLED, str(tmp_path)],
        env=os.environ | {"PYTHONPATH": path},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "open\n"
    with locked(tmp_path):
        child.communicate("go on\n", timeout=patience(PATIENCE_S))
    assert child.returncode == -signal.SIGKILL
    with Store.open("", tmp_path) as store:
        assert store.alarms.journal().items == []
        with Outbox.open(tmp_path, store) as outbox:
            assert [alarm.id for alarm in outbox.load_alarms()] == ["2nd"]
            assert outbox.flush(PATIENCE_S)
        assert told(store) == [1, 3, 4, 5]


def test_a_full_disk_still_takes_much_and_what_it_refuses_goes_straight_on(
    sqlite_store: Store, tmp_path: Path
) -> None:
    with Outbox.open(tmp_path, sqlite_store) as outbox:
        with outbox._queue.file.reading() as connection:
            pages = connection.execute("PRAGMA page_count").fetchone()[0]
            # The limit that SQLite itself knows gives the same error as the disk's.
            connection.execute(f"PRAGMA max_page_count = {pages}")
        with locked(tmp_path):
            record(outbox, *(long_change(1000 + number) for number in range(100)))
            assert not outbox.flush(0)
            assert outbox.disk_problem is None
            record(outbox, *(long_change(2000 + number) for number in range(200)))
            assert not outbox.flush(0)
            assert "full" in str(outbox.disk_problem)
        wait_until(written(outbox), PATIENCE_S, "the store has all")
        # Not even the room that was kept: the disk is broken.
        with outbox._queue.file.reading() as connection:
            connection.execute("PRAGMA query_only = ON")
        outbox.record(long_change(3000))
        wait_until(written(outbox), PATIENCE_S, "the store has it without the disk")
        assert "readonly" in str(outbox.disk_problem)
        times = [line.time_us for line in sqlite_store.alarms.journal(limit=2000).items[::-1]]
        assert times == [*range(1000, 1100), *range(2000, 2200), 3000]


def test_a_damaged_file_is_put_aside(sqlite_store: Store, tmp_path: Path) -> None:
    (tmp_path / OUTBOX_FILE).write_bytes(random.Random(1).randbytes(8192))
    with Outbox.open(tmp_path, sqlite_store) as outbox:
        outbox.record(change(1))
        assert outbox.flush(PATIENCE_S)
    assert (tmp_path / "outbox-damaged-1.db").stat().st_size == 8192


def test_what_is_refused_holds_nothing_up_and_is_seen(sqlite_store: Store, tmp_path: Path) -> None:
    of_no_alarm = AlarmTransition(
        "never stored", "a", "limit", "x", "", 3, "", "UNACK", "", "", 1.0, ""
    )
    with locked(tmp_path), Outbox.open(tmp_path, sqlite_store) as outbox:
        record(outbox, change(1), change(2), AlarmChange(None, (of_no_alarm,)), audit_line(4))
        outbox.flush(0)
    with closing(sqlite3.connect(tmp_path / OUTBOX_FILE)) as file:
        file.execute("""UPDATE changes SET document = '{"weather": {}}' WHERE number = 2""")
        (sender,) = file.execute("SELECT sender FROM changes WHERE number = 4").fetchone()
        unknown = (sender, '{"weather": {}}')
        file.execute(
            "UPDATE changes SET document = ?, checksum = ? WHERE number = 4",
            (unknown[1], _checksum(unknown)),
        )
        file.commit()
    for _ in range(2):  # also when it is delivered again
        shutil.copy(tmp_path / OUTBOX_FILE, tmp_path / "copy.db")
        with Outbox.open(tmp_path, sqlite_store) as outbox:
            outbox.record(change(5, "ACKED"))
            assert outbox.flush(PATIENCE_S)
            assert outbox.lost == 1, "the damaged one"
        refused = sqlite_store.refused.list()
        assert [one.assets for one in refused] == ["a", ""]
        assert "FOREIGN KEY" in refused[0].reason
        assert refused[1].reason == "this version cannot read it"
        shutil.copy(tmp_path / "copy.db", tmp_path / OUTBOX_FILE)
    lines = [line for line in sqlite_store.alarms.journal().items if line.kind != STORED.kind]
    assert [(line.kind, line.time_us) for line in lines] == [("change not taken", 3)]
    trail = sqlite_store.audit.page().items
    assert [entry.action for entry in trail] == ["change.refuse", "change.refuse"]
    assert sqlite_store.refused.repeat(refused[0].id, "eva") == "1 lines of the journal"
    assert sqlite_store.alarms.journal().items[0] == replace(of_no_alarm, alarm_id=None)
    with pytest.raises(StoreError, match="not known"):
        sqlite_store.refused.repeat(refused[0].id, "eva")
    with pytest.raises(StoreError, match="cannot read"):
        sqlite_store.refused.repeat(refused[1].id, "eva")


def test_a_text_that_postgresql_cannot_hold_is_refused_and_seen(
    postgresql: PostgreSQL, tmp_path: Path
) -> None:
    url = postgresql.database()
    with Store.open(url, tmp_path) as store, Outbox.open(tmp_path, store) as outbox:
        refused = change(1)
        outbox.record(replace(refused, alarm=replace(STORED, comment="a\0b")))
        outbox.record(change(2))
        assert outbox.flush(PATIENCE_S)
        assert [one.since_us for one in store.alarms.load()] == [2]
        assert ["NUL" in one.reason for one in store.refused.list()] == [True]
