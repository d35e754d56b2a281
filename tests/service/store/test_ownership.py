"""Cells share partitions without a leader, and no one writes for what another cell owns."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import psycopg
import pytest
from postgresql import PostgreSQL, running_postgresql
from processes import wait_until
from sqlalchemy.engine import make_url

from service.cell.start import deliver_earlier, fence_earlier
from service.features.notifications.tables import (
    Notification,
    NotificationChange,
    NotificationRecords,
)
from service.site.settings import load_settings
from service.store import (
    Alarm,
    AlarmChange,
    AlarmTransition,
    AuditEntry,
    DatabaseInUseError,
    NotOwnerError,
    Outbox,
    Store,
    StoreError,
    StoreUnavailableError,
    lock_database,
)
from service.store.ownership import Ownership, owned_by, run_name
from service.store.partition_shares import DEAD_S

PARTITIONS = 8
PATIENCE_S = 60.0

#: Owns partitions in a process of its own, so that it can be stopped and killed.
_OTHER = """
import sys, time
from service.store.ownership import Ownership, run_name
from sqlalchemy.engine import make_url
lost = []
url, count = make_url(sys.argv[1]), int(sys.argv[2])
one = Ownership(url, run_name(), count, lambda: None, lambda: lost.append(1))
print(one.cell, flush=True)
while not lost:
    if one.leaving:
        one.leave(one.leaving)
    time.sleep(0.05)
print("lost", flush=True)
"""


class Cells:
    """Runs of cells on one database."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.open: list[Ownership] = []
        self.processes: list[subprocess.Popen[str]] = []

    def begin(self, count: int = PARTITIONS, on_lost: Callable[[], object] = int) -> Ownership:
        one = Ownership(make_url(self.url), run_name(), count, lambda: None, on_lost)
        self.open.append(one)
        return one

    def begin_process(self) -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen(
            [sys.executable, "-c", _OTHER, self.url, str(PARTITIONS)],
            stdout=subprocess.PIPE,
            text=True,
        )
        self.processes.append(process)
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        return process, next(line for line in lines if line.startswith("bearing-twin ")).strip()

    def owners(self) -> dict[int, tuple[int, str]]:
        with psycopg.connect(self.url) as connection:
            rows = connection.execute("SELECT id, epoch, owner FROM partitions").fetchall()
        return {id: (epoch, owner) for id, epoch, owner in rows}

    def owned_by(self, cell: str) -> list[int]:
        return [id for id, (_, owner) in self.owners().items() if owner == cell]

    def close(self) -> None:
        for one in self.open:
            one.close()
        for process in self.processes:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait(30)
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def closing(cells: Cells) -> Iterator[Cells]:
    try:
        yield cells
    finally:
        cells.close()


@pytest.fixture
def cells(postgresql: PostgreSQL) -> Iterator[Cells]:
    with closing(Cells(postgresql.database())) as cells:
        yield cells


def wait(look: Callable[[], bool], what: str) -> None:
    wait_until(look, PATIENCE_S, what)


def test_cells_share_and_hand_over(cells: Cells) -> None:
    one = cells.begin()
    wait(lambda: len(one.owned) == PARTITIONS, "all for one")
    first = dict(one.owned)
    other = cells.begin()
    wait(lambda: len(one.leaving) == PARTITIONS // 2, "half are to be left")
    # Until they are left they are this cell's alone.
    time.sleep(1.5)
    assert not other.owned
    assert len(cells.owned_by(one.cell)) == PARTITIONS
    left = one.leaving
    one.leave(left)
    wait(lambda: set(other.owned) == left, "the other has them")
    assert set(one.owned).isdisjoint(other.owned)
    assert all(other.owned[id] == first[id] + 1 for id in left)
    other.close()
    wait(lambda: len(one.owned) == PARTITIONS, "all come back")


@pytest.mark.wires
def test_a_killed_cell_is_replaced_at_once(cells: Cells) -> None:
    process, name = cells.begin_process()
    wait(lambda: len(cells.owned_by(name)) == PARTITIONS, "all for one")
    other = cells.begin()
    wait(lambda: len(other.owned) == PARTITIONS // 2, "half")
    process.kill()
    wait(lambda: len(other.owned) == PARTITIONS, "all")


@pytest.mark.wires
def test_a_stopped_cell_is_replaced_and_ends_when_it_wakes(cells: Cells) -> None:
    process, name = cells.begin_process()
    other = cells.begin()
    wait(lambda: len(other.owned) == PARTITIONS // 2 == len(cells.owned_by(name)), "halves")
    process.send_signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    wait(lambda: len(other.owned) == PARTITIONS, "all")
    assert time.monotonic() - stopped_s > DEAD_S / 2, "a pause of a moment costs nothing"
    before = cells.owners()
    process.send_signal(signal.SIGCONT)
    assert process.stdout is not None
    assert "lost\n" in iter(process.stdout.readline, "")
    assert cells.owners() == before


@pytest.mark.wires
def test_after_a_restart_of_the_server_everyone_keeps_what_he_had(tmp_path: Path) -> None:
    with running_postgresql() as server, closing(Cells(server.database())) as cells:
        lost: list[int] = []
        one = cells.begin(on_lost=lambda: lost.append(1))
        other = cells.begin(on_lost=lambda: lost.append(2))
        wait(lambda: len(one.leaving) + len(other.leaving) > 0 or len(one.owned) == 4, "shares")
        for cell in (one, other):
            cell.leave(cell.leaving)
        wait(lambda: len(one.owned) == len(other.owned) == 4, "halves")
        epochs = dict(one.owned), dict(other.owned)
        server.stop()
        time.sleep(1.0)
        server.start()
        # Both are there again when both have had a heartbeat of after the start.
        wait(lambda: _beats(cells.url) == 2, "heartbeats")
        time.sleep(1.5)
        assert (dict(one.owned), dict(other.owned)) == epochs
        assert not lost


def _beats(url: str) -> int:
    with psycopg.connect(url) as connection:
        row = connection.execute(
            "SELECT count(*) FROM cells WHERE beat_at > pg_postmaster_start_time()"
        ).fetchone()
    return int(row[0]) if row else 0


def test_a_service_without_fleet_and_cells_do_not_meet(cells: Cells, tmp_path: Path) -> None:
    with lock_database(cells.url, tmp_path, int), pytest.raises(DatabaseInUseError):
        cells.begin()
    cells.begin()
    with pytest.raises(DatabaseInUseError):
        lock_database(cells.url, tmp_path, int)
    with pytest.raises(StoreError, match="partitions = 16"):
        cells.begin(16)


class _Fence:
    """All assets are in partition 0."""

    def __init__(self, ownership: Ownership) -> None:
        self._ownership = ownership

    def held(self, connection: object, assets: object) -> object:
        return assets if self._ownership.held(connection, {0}) else ()  # type: ignore[arg-type]

    def deliverable(self, connection: object, assets: object, run: str) -> object:
        return assets if owned_by(connection, {0}, run) else ()  # type: ignore[arg-type]


def _alarm(id: str) -> Alarm:
    return Alarm(
        id=id, asset="axle-1", kind="limit", channel="t_outer_ring_c", level=id, state="UNACK",
        priority=1, message="", predicted=False, raised_at_us=1, since_us=1, returned_at_us=None,
        acknowledged_at_us=None, acknowledged_by=None, value=1.0, limit_value=0.5, unit="°C",
        lead_time_s=None, probability=None, present=True, latched=False, shelved_until_us=None,
        shelved_by=None, suppressed_reason=None, comment=None,
    )  # fmt: skip


def test_only_the_owner_writes_what_was_derived(cells: Cells, tmp_path: Path) -> None:
    one = cells.begin()
    wait(lambda: len(one.owned) == PARTITIONS, "all")
    with Store.open(cells.url, tmp_path / "a") as store, Store.open(cells.url, tmp_path) as free:
        store.write_only_what(_Fence(one))  # type: ignore[arg-type]
        store.states.save("axle-1", {"by": "one"})
        number = store.models.add("axle-1", "candidate", "", {}, 1)
        job, _ = store.jobs.add("axle-1", {}, 1)
        one.close()
        with psycopg.connect(cells.url, autocommit=True) as connection:
            connection.execute("UPDATE partitions SET epoch = epoch + 1, owner = 'another'")
        store.states.save("axle-1", {"by": "one, late"})
        assert free.states.load("axle-1") == {"by": "one"}
        with pytest.raises(NotOwnerError):
            store.models.add("axle-1", "candidate", "", {}, 2)
        with pytest.raises(NotOwnerError):
            store.models.activate("axle-1", number, "somebody", "", 2)
        with pytest.raises(NotOwnerError):
            store.jobs.update(job.id, progress=0.5)
        assert [one.status for one in free.models.versions("axle-1")] == ["candidate"]
        assert free.jobs.get(job.id) == job


def test_what_a_killed_run_left_is_written_unless_another_has_taken_over(
    cells: Cells, tmp_path: Path
) -> None:
    one = cells.begin()
    wait(lambda: len(one.owned) == PARTITIONS, "all")
    with Store.open(cells.url, tmp_path) as store:
        store.write_only_what(_Fence(one))  # type: ignore[arg-type]
        for owner, written in ((one.cell, True), ("another", False)):
            with psycopg.connect(cells.url, autocommit=True) as connection:
                connection.execute("UPDATE partitions SET owner = %s", (owner,))
            # A run that recorded a change, and the next one of the same directory.
            folder = tmp_path / owner[-4:]
            folder.mkdir()
            alarm = _alarm("late" if not written else "in time")
            with Outbox.open(folder, store, run=one.cell) as outbox:
                outbox.record(AlarmChange(alarm))
                outbox.record(
                    NotificationChange((Notification("mail", alarm, pending=("raised:1",)),))
                )
                assert outbox.flush(PATIENCE_S)
            assert (alarm.id in {kept.id for kept in store.alarms.load()}) == written
            notified = {kept.alarm.id for kept in store.part(NotificationRecords).load()}
            assert (alarm.id in notified) == written


def _take_all(url: str, owner: str) -> None:
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute("UPDATE partitions SET epoch = epoch + 1, owner = %s", (owner,))


def test_a_store_of_a_fleet_opens_with_a_fence_that_refuses_everything(
    cells: Cells, tmp_path: Path
) -> None:
    with Store.open(cells.url, tmp_path, run=run_name()) as store:
        writes: list[Callable[[], object]] = [
            lambda: store.alarms.save(_alarm("one")),
            lambda: store.states.save("axle-1", {}),
            lambda: store.models.add("axle-1", "candidate", "", {}, 1),
            lambda: store.jobs.add("axle-1", {}, 1),
            lambda: store.part(NotificationRecords).save(
                (Notification("mail", _alarm("one"), pending=("raised:1",)),)
            ),
        ]
        for write in writes:
            with pytest.raises(StoreUnavailableError, match="own"):
                write()
        with Outbox.open(tmp_path, store, run="an earlier run") as outbox:
            outbox.record(AlarmChange(_alarm("one")))
            assert not outbox.flush(PATIENCE_S)
            assert outbox.waiting == 1, "it waits for a fence that knows"
        assert store.alarms.load() == []


def test_a_run_that_returns_does_not_bring_back_an_alarm_that_another_has_ended(
    cells: Cells, tmp_path: Path
) -> None:
    """Findings 1.2: the outbox of a killed cell is sent when it returns, whatever the order."""
    settings = load_settings(_fleet_file(tmp_path, cells.url))
    folder = tmp_path / "a"
    folder.mkdir()
    raised = _alarm("first")
    line = AlarmTransition(
        "first", "axle-1", "limit", "t_outer_ring_c", "first", 2, "UNACK", "ACKED", "eva", "", 1.0,
        "", "acknowledge",
    )  # fmt: skip
    trail = AuditEntry(2, "operator bt_1", "10.0.0.9", "alarm.acknowledge", "first")
    with Store.open(cells.url, tmp_path / "b") as free:
        _open_rows(cells.url)
        _take_all(cells.url, "A")
        free.alarms.save(raised)
        # The acknowledgement is on the disk of A when A is killed; B takes over and ends the alarm.
        with Outbox.open(folder, _Away(free), run="A") as outbox:  # type: ignore[arg-type]
            outbox.record(AlarmChange(replace(raised, state="ACKED", since_us=2), (line,), trail))
            outbox.flush(0)
        _take_all(cells.url, "B")
        free.alarms.save(replace(raised, state="NORM", since_us=3, present=False))
        with Store.open(cells.url, folder, run=run_name()) as store:
            fence_earlier(settings, store)
            with Outbox.open(folder, store, run="A again") as outbox:
                deliver_earlier(folder, store, outbox)
                assert outbox.refused == 1
                assert outbox.load_alarms() == []
        assert free.alarms.load() == [], "an alarm that has ended has come back"
        # What was refused is seen, and its records can be written.
        (refused,) = free.refused.list()
        assert (refused.assets, refused.sender.partition("/")[0]) == ("axle-1", "A")
        assert [(one.kind, one.asset) for one in free.alarms.journal().items] == [
            ("change not taken", "axle-1")
        ]
        assert [one.action for one in free.audit.page().items] == ["change.refuse"]
        assert free.refused.repeat(refused.id, "eva") == "1 lines of the journal"
        assert free.refused.list() == [] == free.alarms.load()
        assert free.alarms.journal().items[0] == line
        actions = [one.action for one in free.audit.page().items]
        assert actions == ["change.repeat", "alarm.acknowledge", "change.refuse"]


def test_what_returns_with_its_partitions_unowned_meanwhile_is_delivered(
    cells: Cells, tmp_path: Path
) -> None:
    settings = load_settings(_fleet_file(tmp_path, cells.url))
    _open_rows(cells.url)
    _take_all(cells.url, "A")
    with Store.open(cells.url, tmp_path / "free") as free:
        with Outbox.open(tmp_path, _Away(free), run="A") as outbox:  # type: ignore[arg-type]
            outbox.record(AlarmChange(_alarm("first")))
            outbox.flush(0)
        with Store.open(cells.url, tmp_path, run=run_name()) as store:
            fence_earlier(settings, store)
            with Outbox.open(tmp_path, store, run="A again") as outbox:
                deliver_earlier(tmp_path, store, outbox)
        assert [one.id for one in free.alarms.load()] == ["first"]
        assert free.refused.list() == []


def test_a_change_for_assets_of_two_cells_is_taken_in_part_and_the_rest_is_seen(
    cells: Cells, tmp_path: Path
) -> None:
    with Store.open(cells.url, tmp_path) as store:
        store.write_only_what(_Named({"axle-1"}))  # type: ignore[arg-type]
        other = replace(_alarm("other"), asset="axle-2")
        two = [Notification("mail", one, pending=("raised:1",)) for one in (_alarm("one"), other)]
        with Outbox.open(tmp_path, store, run="A") as outbox:
            outbox.record(NotificationChange(tuple(two)))
            assert outbox.flush(PATIENCE_S)
        assert [one.alarm.id for one in store.part(NotificationRecords).load()] == ["one"]
        assert [one.assets for one in store.refused.list()] == ["axle-2"]


class _Named:
    """A fence around some assets."""

    def __init__(self, assets: set[str]) -> None:
        self._assets = assets

    def held(self, connection: object, assets: set[str]) -> set[str]:
        return self._assets & assets

    def deliverable(self, connection: object, assets: set[str], run: str) -> set[str]:
        return self._assets & assets


class _Away:
    """A store that does not answer; changes wait on the disk."""

    def __init__(self, store: Store) -> None:
        self.alarms = self.audit = self.refused = self

    def part(self, kind: object) -> "_Away":
        return self

    def save(self, *arguments: object) -> None:
        raise StoreUnavailableError("offline")


def _open_rows(url: str) -> None:
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute(
            "INSERT INTO partitions SELECT id, 0, '' FROM generate_series(0, 63) AS id"
        )


def _fleet_file(folder: Path, url: str) -> Path:
    file = folder / "fleet.toml"
    file.write_text(
        f'[fleet]\ndatabase_url = "{url}"\nnats_url = "nats://127.0.0.1:4222"\n'
        '[[assets]]\nid = "axle-1"\nbearing = "6311"\n'
        "low_risk = { speed_rpm_max = 4300, load_n_max = 3400 }\n"
        '[assets.channels]\nt_outer_ring_c = { source = "push" }\n'
    )
    return file


@pytest.mark.wires
@pytest.mark.endurance
def test_a_server_that_pauses_costs_no_cell_anything() -> None:
    """Findings 1.3: PostgreSQL stopped for 5 s, and whoever came back first ended the others."""
    with running_postgresql() as server, closing(Cells(server.database())) as cells:
        lost: list[int] = []
        three = [cells.begin(9, partial(lost.append, number)) for number in range(3)]

        def shared() -> bool:
            for one in three:
                one.leave(one.leaving)
            return all(len(one.owned) == 3 for one in three)

        wait(shared, "thirds")
        epochs = [dict(one.owned) for one in three]
        time.sleep(DEAD_S)  # each has watched the others
        for _ in range(2):
            with server.frozen():
                time.sleep(DEAD_S + 1.0)
            time.sleep(DEAD_S + 1.0)
            assert not lost
            assert [dict(one.owned) for one in three] == epochs
