"""A publisher of a package of its own: what it takes to add one, and what is promised to it."""

import asyncio
import importlib
import json
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from processes import wait_until
from prometheus_client import CollectorRegistry

from adapters.samples import Quality
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.domain.errors import CellUnavailableError
from service.plant import publishers, rounds
from service.plant.protocol import Host
from service.plant.rounds import PublisherRounds, make_publishers
from service.site.configuration import SettingsError
from service.site.settings import Settings

PATIENCE_S = 60.0

#: The whole publisher: it appends all that it is told to a file, and fails when there is a file
#: that says so.
PACKAGE = """
import asyncio, json
from pathlib import Path
from service.plant.protocol import PublisherEntry

class Journal:
    def __init__(self, folder):
        self._folder = folder
    def _note(self, what, *more):
        with (self._folder / "journal").open("a") as file:
            print(json.dumps([what, *more]), file=file)
    async def open(self, host):
        self._note("open")
    async def run(self):
        self._note("run")
        while not (self._folder / "lose").exists():
            await asyncio.sleep(0.01)
        (self._folder / "lose").unlink()
        raise ConnectionError("lost")
    async def publish_tags(self, asset, tags):
        self._note("tags", asset, tags)
        return [tag for tag in tags if tag.startswith("refused")]
    async def withdraw_tags(self, asset, tags):
        if (self._folder / "deaf").exists():
            (self._folder / "deaf").unlink()
            raise ConnectionError("lost")
        self._note("withdraw", asset, sorted(tags))
    async def publish_alarm(self, asset, alarm):
        if (self._folder / "busy").exists():
            (self._folder / "busy").unlink()
            raise TimeoutError("busy")
        self._note("alarm", asset, alarm)
    async def close(self):
        self._note("close")

PUBLISHER = PublisherEntry(
    name="journal",
    package="json",
    period_s=0.01,
    is_enabled=lambda settings: "journal" in settings.publishers,
    make=lambda settings: Journal(Path(settings.publishers["journal"]["folder"])),
)
"""


@pytest.fixture
def journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Add the publisher as its folder and one line; gives the folder of its journal."""
    package = tmp_path / "packages" / "journal_publisher"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(PACKAGE)
    monkeypatch.syspath_prepend(str(package.parent))
    added = importlib.import_module("journal_publisher").PUBLISHER
    monkeypatch.setattr(publishers, "PUBLISHERS", (*publishers.PUBLISHERS, added))
    monkeypatch.setattr(rounds, "REOPEN_FIRST_S", 0.01)
    yield tmp_path
    del sys.modules["journal_publisher"]


def tag(value: float) -> dict[str, Any]:
    return {"value": value, "unit": "", "quality": 192, "time": "2026-11-21T08:00:00.000Z"}


class Asset:
    """An asset whose tags a test sets."""

    def __init__(self) -> None:
        self.tags = {"a": tag(1.0), "b": tag(2.0)}

    def snapshot(self) -> dict[str, Any]:
        return {"tags": dict(self.tags)}


class Journal:
    """What the publisher was told, read as it comes."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "journal"

    @property
    def lines(self) -> list[list[Any]]:
        return [json.loads(line) for line in self._path.read_text().splitlines()]

    async def has(self, line: list[Any], times: int = 1) -> None:
        await asyncio.to_thread(
            wait_until,
            lambda: self._path.exists() and self.lines.count(line) >= times,
            PATIENCE_S,
            f"{line} {times} times",
            every_s=0.01,
        )


@asynccontextmanager
async def publishing(
    folder: Path, asset: Asset, bus: LiveMessages, host: Host, assets: dict[str, Any] | None = None
) -> AsyncIterator[tuple[Journal, CollectorRegistry]]:
    settings = Settings(publishers={"journal": {"folder": str(folder)}})
    publishers.check_ports(settings)
    registry = CollectorRegistry()
    shown = assets or {"bench-1": asset}
    (one,) = make_publishers(settings, shown, bus, host, registry)  # type: ignore[arg-type]
    running = asyncio.create_task(one.run())
    try:
        yield Journal(folder), registry
        assert not running.done(), running
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def test_it_gets_all_tags_then_those_that_change(journal: Path, host: Host) -> None:
    asset = Asset()
    async with publishing(journal, asset, LiveMessages(ProcessClock()), host) as (told, _):
        await told.has(["run"])
        asset.tags |= {"b": tag(3.0), "new": tag(4.0)}
        await told.has(["tags", "bench-1", {"b": tag(3.0), "new": tag(4.0)}])
    assert told.lines == [
        ["open"],
        ["tags", "bench-1", {"a": tag(1.0), "b": tag(2.0)}],
        ["run"],
        ["tags", "bench-1", {"b": tag(3.0), "new": tag(4.0)}],
        ["close"],
    ]


async def test_a_round_that_is_lost_is_followed_by_one_with_all_tags(
    journal: Path, host: Host
) -> None:
    asset = Asset()
    async with publishing(journal, asset, LiveMessages(ProcessClock()), host) as (told, registry):
        await told.has(["run"])
        (journal / "lose").touch()
        await told.has(["run"], times=2)

        def up() -> float | None:
            return registry.get_sample_value("bearing_twin_publisher_up", {"publisher": "journal"})

        assert up() == 1.0
        asset.tags["refused"] = tag(5.0)
        await told.has(["tags", "bench-1", {"refused": tag(5.0)}], times=2)  # offered again
        assert up() == 0.0
    all_tags = ["tags", "bench-1", {"a": tag(1.0), "b": tag(2.0)}]
    a_round = [["open"], all_tags, ["run"], ["close"]]
    assert told.lines[:7] == (2 * a_round)[:7]


async def test_an_alarm_that_was_not_taken_comes_again_and_in_order(
    journal: Path, host: Host
) -> None:
    bus = LiveMessages(ProcessClock())
    async with publishing(journal, Asset(), bus, host) as (told, _):
        await told.has(["run"])
        (journal / "busy").touch()
        for number in range(3):
            bus.publish("alarm", "bench-1", {"id": number})
        await told.has(["alarm", "bench-1", {"id": 2}])
    alarms = [line[2]["id"] for line in told.lines if line[0] == "alarm"]
    assert alarms == [0, 1, 2]
    assert told.lines.count(["close"]) == told.lines.count(["open"]) == 2


async def test_tags_of_assets_that_come_and_go_are_handed_on_and_withdrawn(
    journal: Path, host: Host
) -> None:
    assets: dict[str, Any] = {"bench-1": Asset()}
    async with publishing(journal, Asset(), LiveMessages(ProcessClock()), host, assets) as (
        told,
        _,
    ):
        await told.has(["run"])
        assets["bench-2"] = Asset()
        await told.has(["tags", "bench-2", {"a": tag(1.0), "b": tag(2.0)}])
        del assets["bench-1"]
        await told.has(["withdraw", "bench-1", ["a", "b"]])
        del assets["bench-2"].tags["b"]  # the active model has no such node any more
        await told.has(["withdraw", "bench-2", ["b"]])
        assets["bench-1"] = Asset()
        all_tags = ["tags", "bench-1", {"a": tag(1.0), "b": tag(2.0)}]
        await told.has(all_tags, times=2)
    gone = {"value": None, "quality": Quality.OUT_OF_SERVICE}
    assert told.lines == [
        ["open"],
        all_tags,
        ["run"],
        ["tags", "bench-2", {"a": tag(1.0), "b": tag(2.0)}],
        ["tags", "bench-1", {"a": tag(1.0) | gone, "b": tag(2.0) | gone}],
        ["withdraw", "bench-1", ["a", "b"]],
        ["tags", "bench-2", {"b": tag(2.0) | gone}],
        ["withdraw", "bench-2", ["b"]],
        all_tags,
        ["close"],
    ]


async def test_what_could_not_be_withdrawn_is_withdrawn_in_the_next_round(
    journal: Path, host: Host
) -> None:
    assets: dict[str, Any] = {"bench-1": Asset(), "bench-2": Asset()}
    async with publishing(journal, Asset(), LiveMessages(ProcessClock()), host, assets) as (
        told,
        _,
    ):
        await told.has(["run"])
        (journal / "deaf").touch()
        del assets["bench-2"]
        await told.has(["run"], times=2)
    assert told.lines.count(["withdraw", "bench-2", ["a", "b"]]) == 1
    assert told.lines.index(["close"]) < told.lines.index(["withdraw", "bench-2", ["a", "b"]])


async def test_assets_that_change_while_a_publisher_takes_its_time_are_no_fault(
    journal: Path, host: Host, capsys: pytest.CaptureFixture[str]
) -> None:
    assets: dict[str, Any] = {f"bench-{number}": Asset() for number in range(5)}

    class Leaving(Asset):
        """Takes others with it while it is asked, as another task would across an await."""

        def snapshot(self) -> dict[str, Any]:
            assets.pop("bench-1", None)
            assets["bench-9"] = Asset()
            return super().snapshot()

    class Unknown(Asset):
        """So new that the cell has not answered yet."""

        def snapshot(self) -> dict[str, Any]:
            raise CellUnavailableError("the cell has not answered yet")

    assets |= {"bench-0": Leaving(), "bench-4": Unknown()}
    async with publishing(journal, Asset(), LiveMessages(ProcessClock()), host, assets) as (
        told,
        _,
    ):
        await told.has(["tags", "bench-9", {"a": tag(1.0), "b": tag(2.0)}])
        await told.has(["withdraw", "bench-1", ["a", "b"]])
        assets["bench-4"] = Asset()
        await told.has(["tags", "bench-4", {"a": tag(1.0), "b": tag(2.0)}])
    assert told.lines.count(["open"]) == 1
    assert "failed" not in "".join(capsys.readouterr())


async def test_two_looks_at_a_time_withdraw_a_tag_once(host: Host) -> None:
    withdrawn: list[str] = []

    class Slow:
        async def publish_tags(self, asset: str, tags: dict[str, Any]) -> list[str]:
            await asyncio.sleep(0)
            return []

        async def withdraw_tags(self, asset: str, tags: list[str]) -> None:
            await asyncio.sleep(0)
            withdrawn.extend(tags)

    assets: dict[str, Any] = {"bench-1": Asset(), "bench-2": Asset()}
    one = PublisherRounds("slow", Slow(), 1.0, assets, LiveMessages(ProcessClock()), host)  # type: ignore[arg-type]
    await one.publish_tags()
    del assets["bench-1"], assets["bench-2"].tags["b"]
    await asyncio.gather(one.publish_tags(), one.publish_tags())
    assert sorted(withdrawn) == ["a", "b", "b"]
    assert one.problem is None


def test_a_publisher_that_there_is_not_is_named() -> None:
    with pytest.raises(SettingsError, match=r"publishers.mqtt2: unknown publisher; .*mqtt"):
        publishers.check_extras(Settings(publishers={"mqtt2": {}}))
