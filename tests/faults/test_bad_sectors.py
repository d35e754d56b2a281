"""A disk with sectors that fail with EIO while the service runs: what it costs is counted.

`bad_sectors.c` stands between the service and the C library and refuses the bytes of a list.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import Station, wait_until
from site_files import asset_text, write_site

from service.clock import rfc3339

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

MEASUREMENTS = "/api/v1/assets/motor-1/measurements"
PAGE = 4096
BEYOND = 2**40
#: Samples of one push: some forty pages of the spool.
PORTION = 2000
STORE, WRITE_AHEAD = "bearing-twin.db", "bearing-twin.db-wal"
SPOOL, OUTBOX = "spool.db", "outbox.db"
KNOWN, WAITING = "bearing_twin_samples_accepted_total", "bearing_twin_spool_samples"


class Disk:
    """The list of bad bytes of files in a data directory."""

    def __init__(self, folder: Path) -> None:
        self.data = folder / "data"
        self.list = folder / "bad-sectors"
        self.list.touch()
        self.bad: dict[str, tuple[int, int, int]] = {}

    def spoil(self, name: str, first: int, last: int = BEYOND) -> None:
        """Spoil bytes of a file; a file that takes its name has other sectors."""
        self.bad[name] = ((self.data / name).stat().st_ino, first, last)
        self._write()

    def heal(self, name: str) -> None:
        del self.bad[name]
        self._write()

    def _write(self) -> None:
        lines = [f"{inode} {first} {last}\n" for inode, first, last in self.bad.values()]
        new = self.list.with_suffix(".new")
        new.write_text("".join(lines))
        new.replace(self.list)


class Pushing(Station):
    """A service that is pushed to, on a disk with bad sectors."""

    def __init__(self, folder: Path) -> None:
        text = asset_text("motor-1", ("speed_rpm", "load_n", "t_inner_ring_c"))
        super().__init__(folder, *write_site(folder, text))
        self.accepted: set[int] = set()
        self.begin_ms = self.now_us() // 1000 - 3_600_000
        self.pushed = 0

    def push_on(self) -> int:
        """Push the next portion; its status. What was refused is not sent again."""
        numbers = range(self.pushed, self.pushed + PORTION)
        self.pushed += PORTION
        samples = [
            {"channel": "load_n", "time": self.time(number), "value": 100.0 + number / 1000}
            for number in numbers
        ]
        answer = self.client.post(MEASUREMENTS, json={"samples": samples})
        if answer.status_code == 200:
            assert answer.json()["rejected"] == []
            self.accepted |= set(numbers)
        return answer.status_code

    def time(self, number: int) -> str:
        return rfc3339((self.begin_ms + number * 10) * 1000)

    def stored(self) -> list[int]:
        """Numbers of all samples in the store, by their values."""
        with self.open_store() as store:
            found = store.samples.read("motor-1", ["load_n"], 0, 2**62, 10**6)
        return sorted(round((one.value - 100.0) * 1000) for one in found)

    def metric(self, name: str) -> float:
        lines = self.client.get("/metrics").text.splitlines()
        return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(name))

    def is_settled(self) -> bool:
        """Return whether nothing waits to be stored.

        The figures are those that the cell published last: they must speak of the last push.
        """
        return self.metric(KNOWN) >= len(self.accepted) and self.metric(WAITING) == 0

    def log(self) -> str:
        return (self.folder / "serve.log").read_text()


@pytest.fixture
def disk(tmp_path: Path) -> Disk:
    return Disk(tmp_path)


@pytest.fixture
def pushing(
    tmp_path: Path, disk: Disk, preloaded: Callable[[str], str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[Pushing]:
    with Pushing(tmp_path) as station:
        monkeypatch.setenv("LD_PRELOAD", preloaded("bad_sectors"))
        monkeypatch.setenv("BAD_SECTORS", str(disk.list))
        station.start_service()
        monkeypatch.undo()
        assert station.push_on() == 200
        yield station


def ends_well(station: Pushing, cell: int) -> None:
    """All is written in the end, by the same processes."""
    assert station.service is not None
    wait_until(lambda: station.push_on() == 200, 120, "a push that is taken", 1.0)
    wait_until(station.is_settled, 240, "an empty spool", 0.2)
    assert station.service.side("cell") == cell, "the cell was started again"


def test_a_store_with_bad_sectors_loses_nothing_that_was_accepted(
    pushing: Pushing, disk: Disk
) -> None:
    assert pushing.service is not None
    cell = pushing.service.side("cell")
    for name, first in ((STORE, 2 * PAGE), (WRITE_AHEAD, 0), (WRITE_AHEAD, 512)):
        disk.spoil(name, first, BEYOND if name == WRITE_AHEAD else first + 512)
        answers = [pushing.push_on() for _ in range(3)]
        assert set(answers) <= {200, 503}, answers
        disk.heal(name)
        ends_well(pushing, cell)
    stored = pushing.stored()
    assert len(stored) == len(set(stored)), "one twice"
    assert pushing.accepted <= set(stored)
    assert '"event": "store_unavailable"' in pushing.log()


def test_what_bad_sectors_of_the_spool_cost_is_counted(pushing: Pushing, disk: Disk) -> None:
    assert pushing.service is not None
    cell = pushing.service.side("cell")
    disk.spoil(WRITE_AHEAD, 0)  # the store takes nothing: samples wait on the spool
    for _ in range(30):  # more than SQLite keeps of its pages in memory
        wait_until(lambda: pushing.push_on() == 200, 60, "a push that the spool takes")
    size = (disk.data / SPOOL).stat().st_size
    assert size > 600 * PAGE
    at = size // 2 // PAGE * PAGE
    disk.spoil(SPOOL, at, at + 512)
    disk.heal(WRITE_AHEAD)
    ends_well(pushing, cell)
    stored = pushing.stored()
    lost = pushing.accepted - set(stored)
    assert len(stored) == len(set(stored)), "one twice"
    counted = pushing.metric('bearing_twin_samples_skipped_total{reason="damaged"}')
    assert 0 < len(lost) <= 100, "a page of the spool"
    assert counted >= len(lost)
    assert list(disk.data.glob("spool-damaged-*.db")), "set aside for people"


def test_a_change_of_an_alarm_is_answered_only_where_store_or_outbox_takes_it(
    pushing: Pushing, disk: Disk
) -> None:
    watched = wait_until(
        lambda: pushing.get("/api/v1/alarms", state="NORM")["items"] or None, 60, "a condition"
    )
    alarm = watched[0]
    made: list[str] = []

    def shelve(hours: int) -> int:
        for action, body in (("shelve", {"duration_s": 3600 * hours}), ("unshelve", {})):
            path = f"/api/v1/alarms/{alarm['id']}/{action}"
            status = pushing.client.post(path, json=body).status_code
            if body and status in (200, 503):  # made, and 503: not kept yet
                made.append(f"duration_s: {body['duration_s']}")
        return status

    assert shelve(1) == 200
    disk.spoil(OUTBOX, 0)  # the store takes it
    assert shelve(2) == 200
    disk.spoil(WRITE_AHEAD, 0)  # nobody takes it
    assert shelve(3) == 503
    disk.heal(OUTBOX)  # the outbox takes it
    wait_until(lambda: shelve(4) == 200, 60, "an answer", 1.0)
    disk.heal(WRITE_AHEAD)

    def lines() -> list[str]:
        items = pushing.get("/api/v1/audit", limit=200)["items"]
        return [one["detail"] for one in items if one["action"] == "alarm.shelve"]

    wait_until(lambda: sorted(lines()) == sorted(made), 60, "every change in the store, once")
    wait_until(lambda: pushing.metric("bearing_twin_outbox_changes") == 0, 60, "an empty outbox")
