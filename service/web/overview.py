"""The fleet as callers see it: a summary of every asset, sorted, kept up to date on demand.

The cell is asked about some assets at a time, with pauses: thousands of assets that somebody looks
at take a bounded share of its time, and those that no client looks at take none.
"""

import asyncio
import contextlib
import json
import math
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Final, Literal

from pydantic import BaseModel

from service.bus.interface import AWAY_AFTER_S
from service.bus.replica import AssetReplica
from service.bus.replicas import PORTION, Replicas
from service.bus.stream import LiveMessages
from service.bus.subscription import Message, SubscriptionClosedError
from service.documents.fleet import (
    ATTENTIONS,
    STATES,
    FleetAsset,
    FleetMap,
    FleetPage,
    FleetState,
)
from service.domain.errors import CellUnavailableError

#: Wall seconds for which the fleet is kept up to date after somebody asked.
WANTED_FOR_S: Final = 30.0
#: An asset is asked about again after so many wall seconds, and at once when an alarm changes.
FRESH_S: Final = 1.0
#: What was not heard of for so many wall seconds is unread: nothing old is shown as it was.
UNREAD_AFTER_S: Final = 30.0
#: A pause as many times as long as the cell took to answer.
PAUSE_TIMES: Final = 3.0
#: Counts and order are made again at most as often, in wall seconds.
_LISTED_S: Final = 0.5
_LOOK_EVERY_S: Final = 0.25
_RETRY_S: Final = 0.5
_MARKS: Final = {"lost": "f", "unknown": "g", "safe": "h", "waiting": "j", "unread": "k"}
_LAST: Final = len(ATTENTIONS) + 2

Sort = Literal["urgency", "id"]
Key = tuple[float, float, float, str]


class Place(BaseModel):
    """Where a page ended."""

    sort: Sort
    key: Key


@dataclass(slots=True)
class _Row:
    """What is needed of one asset to find, sort, count and mark it."""

    replica: AssetReplica
    tag: bytes
    right_s: float
    key: Key
    group: str | None
    family: str | None
    text: str
    state: FleetState
    attention: bool
    unacknowledged: int
    mark: str


@dataclass(frozen=True, slots=True)
class Fit:
    """Which assets are wanted; None and empty mean all.

    - ``search``: with this text in id, name, group, family or bearing, in lower or upper case.
    - ``states``: in one of these states.
    - ``attention``: only those that need attention, or only the others.
    """

    group: str | None = None
    family: str | None = None
    search: str = ""
    states: Collection[FleetState] = ()
    attention: bool | None = None


@dataclass(slots=True)
class Overview:
    """A summary of every asset."""

    replicas: Replicas
    bus: LiveMessages
    _rows: dict[str, _Row] = field(default_factory=dict)
    _order: list[_Row] = field(default_factory=list)
    _revision: str | None = None
    _dirty: bool = True
    _listed_s: float = -1e9
    _oldest_s: float = -1e9
    _asked_s: float = -1e9
    _wanted: asyncio.Event = field(default_factory=asyncio.Event)
    _soon: set[str] = field(default_factory=set)

    # ------------------------------------------------------------------ keeping it
    async def run(self) -> None:
        """Keep it up to date while somebody asks, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._heed_alarms())
            while True:
                await self._learn()
                if time.monotonic() - self._asked_s <= WANTED_FOR_S:
                    await self._sweep()
                else:
                    self._wanted.clear()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK_EVERY_S):
                        await self._wanted.wait()
                if self._wanted.is_set():
                    await asyncio.sleep(_LOOK_EVERY_S)

    async def _learn(self) -> None:
        """Learn which assets there are; a poll that is due comes between some of them."""
        revision = self.replicas.revision
        if revision == self._revision:
            return
        rows = {}
        for number, (name, replica) in enumerate(list(self.replicas.assets.items())):
            if number % PORTION == 0:
                await asyncio.sleep(0)
            row = self._rows.get(name)
            if row is None or row.tag != replica.known_tag("asset_summary"):
                row = _row(replica)
            row.replica = replica
            rows[name] = row
        self._rows, self._revision, self._dirty = rows, revision, True
        self._listed_s = -1e9  # the next caller gets the list of this revision

    async def _sweep(self) -> None:
        """Ask about all assets that were not heard of lately."""
        rows = self._rows
        due = [name for name, row in rows.items() if row.replica.is_due("asset_summary", FRESH_S)]
        # The oldest last, where they are taken: of a slow cell each has its turn.
        due.sort(key=lambda name: rows[name].right_s, reverse=True)
        while due or self._soon:
            first = [self._soon.pop() for _ in range(min(len(self._soon), PORTION))]
            names = first + [due.pop() for _ in range(min(len(due), PORTION - len(first)))]
            portion = [rows[name].replica for name in dict.fromkeys(names) if name in rows]
            begun_s = time.monotonic()
            try:
                await self.replicas.ask_for([(asset, "asset_summary") for asset in portion])
            except CellUnavailableError:
                await asyncio.sleep(_RETRY_S)
                return
            took_s = time.monotonic() - begun_s
            for asset in portion:
                self._take(rows, asset)
            await asyncio.sleep(PAUSE_TIMES * took_s)

    def _take(self, rows: dict[str, _Row], asset: AssetReplica) -> None:
        row = rows[asset.id]
        right_s = time.monotonic() - asset.age_s("asset_summary")
        if row.tag != asset.known_tag("asset_summary"):
            row = rows[asset.id] = _row(asset)
            self._dirty = True
        row.right_s = right_s

    async def _heed_alarms(self) -> None:
        while True:
            await self._wanted.wait()
            subscription = self.bus.subscribe(types={"alarm"})
            try:
                while True:
                    message = await subscription.get()
                    if self._wanted.is_set():
                        self._soon.update(_about(message))
            except SubscriptionClosedError:
                await asyncio.sleep(_RETRY_S)  # the cell has begun again, or the service stops
            finally:
                subscription.close()

    # ------------------------------------------------------------------ what routes ask
    @property
    def known(self) -> bool:
        """Whether it is known which assets there are."""
        return self._revision is not None

    def names_of(self, kind: Literal["group", "family"], wanted: str) -> set[str]:
        """Give the groups or the families that assets have.

        Raises `CellUnavailableError` while the cell does not answer, or where the wanted one is
        none of them and not all assets are read.
        """
        names = {name for row in self._listing() if (name := getattr(row, kind)) is not None}
        if wanted not in names and not set(self.replicas.names) <= self._rows.keys():
            raise CellUnavailableError("the assets are being read")
        return names

    def page(
        self, fit: Fit, sort: Sort, limit: int, place: Place | None
    ) -> tuple[FleetPage, Place | None]:
        """Give the assets that fit behind a place, and the place where this page ends.

        ``sort``: ``urgency`` (the most urgent first) or ``id``. Raises `CellUnavailableError` while
        the cell does not answer.
        """
        rows = self._listing()
        search = fit.search.casefold()
        some = rows
        if fit.group is not None:
            some = [row for row in some if row.group == fit.group]
        if fit.family is not None:
            some = [row for row in some if row.family == fit.family]
        if search:
            some = [row for row in some if search in row.text]
        found = some
        if fit.states:
            found = [row for row in found if row.state in fit.states]
        if fit.attention is not None:
            found = [row for row in found if row.attention == fit.attention]
        counts = Counter(map(attrgetter("state"), some))

        def key(row: _Row) -> Key:
            return row.key if sort == "urgency" else (0.0, 0.0, 0.0, row.replica.id)

        if sort == "id":
            found = sorted(found, key=lambda row: row.replica.id)
        begin = 0 if place is None else bisect_right(found, place.key, key=key)
        items = found[begin : begin + limit]
        page = FleetPage(
            items=[_shown(row) for row in items],
            total=len(rows),
            found=len(found),
            counts={state: counts[state] for state in STATES},
            attention=sum(map(attrgetter("attention"), some)),
            unacknowledged=sum(map(attrgetter("unacknowledged"), some)),
            age_s=round(max(time.monotonic() - self._oldest_s, 0.0), 1),
            revision=self._revision or "",
        )
        more = begin + limit < len(found)
        return page, Place(sort=sort, key=key(items[-1])) if more else None

    def map(self) -> FleetMap:
        """Give the state of every asset.

        Raises `CellUnavailableError` while the cell does not answer.
        """
        self._listing()
        marks = "".join(self._rows[name].mark for name in sorted(self._rows))
        return FleetMap(revision=self._revision or "", marks=marks)

    def _listing(self) -> list[_Row]:
        """All rows, the most urgent first."""
        now_s = self._asked_s = time.monotonic()
        self._wanted.set()
        away_s = self.replicas.reader.away_s
        if away_s > AWAY_AFTER_S:
            raise CellUnavailableError(f"the cell has not answered for {away_s:.0f} s")
        if not self.known:
            raise CellUnavailableError("the assets are being read")
        if now_s - self._listed_s < _LISTED_S:
            return self._order
        read_since_s = now_s - UNREAD_AFTER_S
        for row in self._rows.values():
            if row.right_s < read_since_s and row.state != "unread":
                _forget(row)
                self._dirty = True
        if self._dirty:
            self._order = sorted(self._rows.values(), key=attrgetter("key"))
        read = [row.right_s for row in self._order if row.state != "unread"]
        self._oldest_s = min(read, default=now_s)
        self._listed_s, self._dirty = now_s, False
        return self._order


def _shown(row: _Row) -> FleetAsset:
    """What is shown of an asset: nothing of its state where it was not heard of lately."""
    asset = row.replica.asset_summary()
    if row.state != "unread":
        return asset
    return asset.model_copy(
        update={
            "state": "unread",
            "attention": None,
            "now": "unknown",
            "next_step": "unknown",
            "reason": "not read yet",
            "missing": [],
            "limit": None,
            "seconds_to_limit": None,
            "probability": None,
            "channel": None,
            "value_c": None,
            "value_at": None,
            "unacknowledged": 0,
            "alarm": None,
        }
    )


def _forget(row: _Row) -> None:
    """Know nothing of the state of an asset any more, until the next answer about it."""
    row.tag = b""
    row.state, row.mark = "unread", _MARKS["unread"]
    row.attention, row.unacknowledged = False, 0
    row.key = (float(_LAST), 0.0, 0.0, row.replica.id)


def _row(replica: AssetReplica) -> _Row:
    asset = replica.asset_summary()
    words: Iterable[str | None] = (
        asset.id,
        asset.name,
        asset.group,
        asset.family,
        asset.bearing,
    )
    return _Row(
        replica=replica,
        tag=replica.known_tag("asset_summary"),
        right_s=time.monotonic() - replica.age_s("asset_summary"),
        key=_urgency(asset),
        group=asset.group,
        family=asset.family,
        text=" ".join(word for word in words if word).casefold(),
        state=asset.state,
        attention=asset.attention is not None,
        unacknowledged=asset.unacknowledged,
        mark=_mark(asset),
    )


def _urgency(asset: FleetAsset) -> Key:
    """Sort key: an alarm by priority, then what is over its limit by most, then the shortest time.

    What is missing comes last.
    """
    if asset.attention is None:
        rank = {"safe": _LAST - 2, "waiting": _LAST - 1}.get(asset.state, _LAST)
        return float(rank), 0.0, 0.0, asset.id
    rank = ATTENTIONS.index(asset.attention)
    seconds = -_excess(asset) if asset.state == "over" else asset.seconds_to_limit
    soon_s = 1e9 if seconds is None else seconds
    first = 0.0
    if asset.alarm is not None:
        # Of one priority what is measured comes first, then lost data, then what is predicted.
        certainty = 2 if asset.alarm.predicted else 1 if asset.state != "over" else 0
        first = asset.alarm.priority + certainty / 4
    elif asset.limit is not None and asset.state == "over":
        first = 0.0 if asset.limit.level == "alarm" else 1.0
    return float(rank), first, soon_s, asset.id


def _excess(asset: FleetAsset) -> float:
    """By how many whole degrees an asset is over its limit; whole ones, so that rows stay."""
    if asset.limit is None or asset.value_c is None:
        return 0.0
    return float(math.floor(max(asset.value_c - asset.limit.value_c, 0.0)))


def _about(message: Message) -> list[str]:
    """The assets that a message of an alarm is about."""
    if message.asset is not None:
        return [message.asset]
    assets: list[str] = json.loads(message.text)["data"]["assets"]
    return assets


def _mark(asset: FleetAsset) -> str:
    level = asset.limit.level if asset.limit else None
    if asset.state == "over":
        mark = "c" if asset.now == "recovering" else "a" if level == "alarm" else "b"
    elif asset.state == "ahead":
        mark = "d" if level == "alarm" else "e"
    else:
        mark = _MARKS[asset.state]
        doubtful = asset.attention in ("not trusted", "not identified", "drifted")
        if asset.state == "safe" and (doubtful or asset.next_step != "safe"):
            mark = "i"
    return mark.upper() if asset.unacknowledged else mark
