"""The fleet's answer: bounded pages in the order of urgency, counts, and one letter for each."""

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator
from typing import Any

import pytest
from patience import within

from service.bus import commands as ask
from service.bus.calls import command_type
from service.bus.memory import MemoryBus
from service.bus.replica import digest
from service.bus.replicas import PORTION, Replicas
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.documents.fleet import ATTENTIONS, FleetAlarm, FleetAsset
from service.documents.limits import Limit
from service.domain.errors import CellUnavailableError
from service.web import overview
from service.web.overview import Fit, Overview

PATIENCE_S = 30.0
MANY = 300
ALARM = FleetAlarm(
    id="1", kind="measured limit", priority=1, predicted=False, message="over", since="now"
)


def asset_of(name: str, chance: random.Random) -> FleetAsset:
    """One asset in any state."""
    state = chance.choice(["over", "ahead", "lost", "unknown", "safe", "safe", "waiting"])
    waits = state != "waiting" and chance.random() < 0.3
    told = {"safe": chance.choice([None, None, "not trusted", "not identified", "drifted"])}
    limited = state in ("over", "ahead")
    return FleetAsset.model_validate(
        {
            "id": name,
            "name": f"Machine {name}",
            "group": chance.choice([None, "Hall A", "Hall B"]),
            "family": chance.choice([None, "6016 front"]),
            "bearing": "6311",
            "network": "bearing-14",
            "state": state,
            "attention": "alarm"
            if waits
            else told.get(state, state if state != "waiting" else None),
            "now": "unknown",
            "next_step": "unknown",
            "reason": "",
            "missing": [],
            "limit": Limit(
                channel="t_inner_ring_c", level=chance.choice(["warning", "alarm"]), value_c=90
            ).model_dump()
            if limited
            else None,
            "seconds_to_limit": chance.randrange(9999) if state == "ahead" else None,
            "probability": None,
            "channel": None,
            "value_c": None,
            "value_at": None,
            "unacknowledged": int(waits),
            "alarm": ALARM.model_copy(update={"priority": chance.randint(1, 3)}).model_dump()
            if waits
            else None,
            "model_version": 1,
            "trusted": True,
            "identified": True,
            "drifted": False,
        }
    )


class Cell:
    """A cell that has nothing but summaries, and counts what it is asked."""

    def __init__(self, count: int) -> None:
        chance = random.Random(5)
        names = [f"axle-{number:04d}" for number in range(count)]
        chance.shuffle(names)
        self.assets = {name: asset_of(name, chance) for name in names}
        self.asked: Counter[str] = Counter()
        self.most_at_once = 0
        self.silent = False

    async def names(self, command: Any) -> dict[str, int]:
        return dict.fromkeys(self.assets, 1)

    async def documents(self, command: Any) -> list[ask.PackedDocument]:
        if self.silent:
            raise CellUnavailableError("silent")
        self.most_at_once = max(self.most_at_once, len(command.wanted))
        made = []
        for wanted in command.wanted:
            if wanted.kind == "asset_summary":
                self.asked[wanted.asset] += 1
            text = self.assets[wanted.asset].to_bytes() if wanted.kind == "asset_summary" else b"{}"
            made.append(ask.PackedDocument(digest(text), text))
        return made


class Followed:
    """A cell, and the overview of it."""

    def __init__(self, count: int) -> None:
        self.cell = Cell(count)
        self.joint = MemoryBus()
        self.bus = LiveMessages(ProcessClock())
        self.replicas = Replicas(self.joint)
        self.fleet = Overview(self.replicas, self.bus)


@pytest.fixture
async def followed() -> AsyncIterator[Followed]:
    one = Followed(MANY)
    handlers: dict[Any, Any] = {
        command_type(ask.Assets.names): one.cell.names,
        command_type(ask.Assets.documents): one.cell.documents,
    }
    serving = asyncio.create_task(one.joint.serve(handlers))
    await asyncio.sleep(0)
    await one.replicas.load()
    running = asyncio.create_task(one.fleet.run())
    async with within(PATIENCE_S):
        while not one.fleet.known:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)
    yield one
    for task in (serving, running):
        task.cancel()
    await asyncio.gather(serving, running, return_exceptions=True)


async def test_pages_hold_every_asset_once_in_the_order_of_urgency(followed: Followed) -> None:
    fleet, assets = followed.fleet, followed.cell.assets
    for fit, limit in (
        (Fit(), 7),
        (Fit(group="Hall A", states=("over", "ahead")), 3),
        (Fit(group="Hall A", family="6016 front"), 5),
    ):
        seen: list[FleetAsset] = []
        place = None
        while True:
            page, place = fleet.page(fit, "urgency", limit, place)
            assert len(page.items) <= limit
            seen += page.items
            if place is None:
                break
        together = [
            one
            for one in assets.values()
            if fit.group in (None, one.group) and fit.family in (None, one.family)
        ]
        wanted = [one.id for one in together if not fit.states or one.state in fit.states]
        assert sorted(one.id for one in seen) == sorted(wanted)
        assert page.found == len(wanted)
        ranks = [9 if one.attention is None else ATTENTIONS.index(one.attention) for one in seen]
        assert ranks == sorted(ranks)
        priorities = [one.alarm.priority for one in seen if one.alarm]
        assert priorities == sorted(priorities)
        ahead = [one.seconds_to_limit or 0 for one in seen if one.attention == "ahead"]
        assert ahead == sorted(ahead)
        states = Counter(one.state for one in together)
        assert {state: count for state, count in page.counts.items() if count} == states
        assert page.attention == sum(one.attention is not None for one in together)


async def test_groups_are_known_when_all_assets_are(followed: Followed) -> None:
    fleet = followed.fleet
    assert fleet.names_of("group", "Hall 9") == {"Hall A", "Hall B"}
    followed.replicas.names = {*followed.replicas.names, "late"}
    with pytest.raises(CellUnavailableError, match="being read"):
        fleet.names_of("group", "Hall 9")
    assert "Hall A" in fleet.names_of("group", "Hall A")


async def test_the_map_has_a_letter_for_each_asset_in_the_order_of_ids(followed: Followed) -> None:
    fleet = followed.fleet
    page, _ = fleet.page(Fit(), "id", MANY, None)
    drawn = fleet.map()
    assert page.revision == drawn.revision
    assert [one.id for one in page.items] == sorted(followed.cell.assets)
    kinds = dict(
        zip("abcdefghijk", [*["over"] * 3, *["ahead"] * 2, "lost", "unknown"], strict=False)
    )
    kinds |= dict.fromkeys("hi", "safe") | {"j": "waiting", "k": "unread"}
    for one, mark in zip(page.items, drawn.marks, strict=True):
        assert kinds[mark.lower()] == one.state
        assert mark.isupper() == (one.unacknowledged > 0)


async def test_list_and_map_change_together_with_their_revision(followed: Followed) -> None:
    cell, fleet = followed.cell, followed.fleet
    before, _ = fleet.page(Fit(), "id", MANY, None)
    cell.assets["axle-new"] = asset_of("axle-new", random.Random(1))
    await followed.replicas.load()
    await fleet._learn()
    page, _ = fleet.page(Fit(), "id", MANY + 1, None)
    assert page.revision != before.revision
    assert len(page.items) == page.total == len(fleet.map().marks) == MANY + 1


async def test_the_cell_is_asked_only_while_somebody_looks_and_first_where_an_alarm_came(
    followed: Followed, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, fleet = followed.cell, followed.fleet
    assert set(cell.asked.values()) == {1}  # when it was met
    await asyncio.sleep(3 * overview.FRESH_S / 2)
    assert set(cell.asked.values()) == {1}
    fleet.map()
    async with within(PATIENCE_S):
        while min(cell.asked.values()) < 2:  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.01)
    assert cell.most_at_once <= PORTION
    # From now on nothing gets old by itself.
    monkeypatch.setattr(overview, "FRESH_S", 1e9)
    await asyncio.sleep(2 * PATIENCE_S / 60)
    name = next(iter(cell.assets))
    cell.assets[name] = cell.assets[name].model_copy(
        update={"state": "over", "attention": "alarm", "unacknowledged": 1, "alarm": ALARM}
    )
    async with within(PATIENCE_S):
        while not fleet.page(Fit(search=name.upper()), "urgency", 1, None)[0].unacknowledged:
            followed.bus.publish("alarm", name, ALARM)
            await asyncio.sleep(0.05)


async def test_nothing_old_is_shown_as_it_was(
    followed: Followed, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell, fleet = followed.cell, followed.fleet
    cell.silent = True
    monkeypatch.setattr(overview, "UNREAD_AFTER_S", 0.5)
    await asyncio.sleep(1.0)
    page, _ = fleet.page(Fit(), "urgency", MANY, None)
    assert page.counts["unread"] == MANY
    assert {(one.now, one.attention) for one in page.items} == {("unknown", None)}
    assert set(fleet.map().marks) == {"k"}
    monkeypatch.setattr(MemoryBus, "away_s", 10.0)
    with pytest.raises(CellUnavailableError, match="10 s"):
        fleet.page(Fit(), "urgency", 1, None)


async def test_a_client_pages_through_the_fleet(world: Any) -> None:
    viewer = world.client("viewer")
    world.rig.at_a_glance = {"state": "over", "attention": "over", "now": "not safe"}
    world.context.fleet.replicas.changed(None)
    path = "/api/v1/fleet?limit=1"
    async with within(PATIENCE_S):
        while (await viewer.get(path)).json()["items"][0]["id"] != "rig-2":  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.05)
    first = await viewer.get(path)
    body = first.json()
    assert (body["total"], body["found"], body["counts"]["over"]) == (2, 2, 1)
    second = await viewer.get(first.headers["link"].split("<")[1].split(">")[0])
    assert [one["id"] for one in second.json()["items"]] == ["bench-1"]
    assert second.json()["next"] is None
    fit = await viewer.get("/api/v1/fleet?state=over&state=ahead&search=RIG")
    assert [one["id"] for one in fit.json()["items"]] == ["rig-2"]
    wrong = await viewer.get(f"/api/v1/fleet?sort=id&cursor={body['next']}")
    assert wrong.status_code == 422
    for name in ("group", "family"):  # a wrong one has no answer
        unknown = await viewer.get(f"/api/v1/fleet?{name}=Hall%209")
        assert unknown.status_code == 422
        assert unknown.json()["detail"].startswith(f"{name}: no {name} 'Hall 9'; there is: ")
    drawn = await viewer.get("/api/v1/fleet/map")
    assert drawn.json()["marks"] == "gb"
    again = {"If-None-Match": drawn.headers["etag"]}
    assert (await viewer.get("/api/v1/fleet/map", headers=again)).status_code == 304
    assert (await world.client("gateway").get("/api/v1/fleet")).status_code == 403
