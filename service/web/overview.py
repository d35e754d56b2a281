"""The fleet as callers see it: every asset at a glance, sorted, kept up to date while it is asked.

The cell is asked about some assets at a time, with pauses: thousands of assets that somebody looks
at take a bounded share of its time, and those that nobody looks at take none.
"""

import asyncio
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Final, Literal

from pydantic import BaseModel

from service.bus.interface import AWAY_AFTER_S
from service.bus.replicas import PORTION, Replicas
from service.bus.stream import Bus, SubscriptionClosedError
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
#: Counts and order are made anew at most as often, in wall seconds.
_LISTED_S: Final = 0.5
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
    """One asset, and what is needed to find, sort and mark it."""

    asset: FleetAsset
    tag: bytes
    right_s: float
    key: Key
    text: str
    mark: str


@dataclass(frozen=True, slots=True)
class Fit:
    """Which assets are wanted; None and empty mean all.

    Attributes
    ----------
    group : str or None
        Of this group.
    search : str
        With this text in id, name, group or bearing, in small or capital letters.
    states : collection of str
        In one of these states.
    attention : bool or None
        Only those that need attention, or only the others.
    """

    group: str | None = None
    search: str = ""
    states: Collection[FleetState] = ()
    attention: bool | None = None


@dataclass(slots=True)
class Overview:
    """Every asset at a glance.

    Attributes
    ----------
    replicas : Replicas
        The assets.
    bus : Bus
        Live messages of this process: an alarm makes a glance old.
    """

    replicas: Replicas
    bus: Bus
    _rows: dict[str, _Row] = field(default_factory=dict)
    _order: list[_Row] = field(default_factory=list)
    _revision: str | None = None
    _listed_s: float = -1e9
    _asked_s: float = -1e9
    _wanted: asyncio.Event = field(default_factory=asyncio.Event)
    _soon: set[str] = field(default_factory=set)

    # ------------------------------------------------------------------ keeping it
    async def run(self) -> None:
        """Keep it up to date while somebody asks, until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._heed_alarms())
            while True:
                if time.monotonic() - self._asked_s > WANTED_FOR_S:
                    self._wanted.clear()
                await self._wanted.wait()
                await self._sweep()
                await asyncio.sleep(_LISTED_S)

    async def _sweep(self) -> None:
        """Ask about all assets that were not heard of lately."""
        assets = self.replicas.assets
        due = [name for name, one in assets.items() if one.is_due("glance", FRESH_S)]
        while due or self._soon:
            first = [self._soon.pop() for _ in range(min(len(self._soon), PORTION))]
            names = first + [due.pop() for _ in range(min(len(due), PORTION - len(first)))]
            portion = [assets[name] for name in dict.fromkeys(names) if name in assets]
            begun_s = time.monotonic()
            try:
                await self.replicas.ask_for([(asset, "glance") for asset in portion])
            except CellUnavailableError:
                await asyncio.sleep(_RETRY_S)
                return
            await asyncio.sleep(PAUSE_TIMES * (time.monotonic() - begun_s))

    async def _heed_alarms(self) -> None:
        while True:
            await self._wanted.wait()
            subscription = self.bus.subscribe(types={"alarm"})
            try:
                while True:
                    message = await subscription.get()
                    if message.asset is not None and self._wanted.is_set():
                        self._soon.add(message.asset)
            except SubscriptionClosedError:
                await asyncio.sleep(_RETRY_S)  # the cell has begun anew, or the service stops
            finally:
                subscription.close()

    # ------------------------------------------------------------------ what routes ask
    def page(
        self, fit: Fit, sort: Sort, limit: int, place: Place | None
    ) -> tuple[FleetPage, Place | None]:
        """Give the assets that fit behind a place, and the place where this page ends.

        Parameters
        ----------
        fit : Fit
            Which assets.
        sort : str
            ``urgency`` (the most urgent first) or ``id``.
        limit : int
            Assets at most.
        place : Place, optional
            Where the page before ended.

        Raises
        ------
        CellUnavailableError
            While the cell does not answer.
        """
        rows = self._listing()
        search = fit.search.casefold()
        some = [
            row
            for row in rows
            if (fit.group is None or row.asset.group == fit.group)
            and (not search or search in row.text)
        ]
        counts = Counter(row.asset.state for row in some)
        found = [
            row
            for row in some
            if (not fit.states or row.asset.state in fit.states)
            and fit.attention in (None, row.asset.attention is not None)
        ]

        def key(row: _Row) -> Key:
            return row.key if sort == "urgency" else (0.0, 0.0, 0.0, row.asset.id)

        if sort == "id":
            found.sort(key=key)
        begin = 0 if place is None else bisect_right(found, place.key, key=key)
        items = found[begin : begin + limit]
        more = begin + limit < len(found)
        now_s = time.monotonic()
        heard_s = (row.right_s for row in rows if row.asset.state != "unread")
        page = FleetPage(
            items=[row.asset for row in items],
            total=len(rows),
            found=len(found),
            counts={state: counts[state] for state in STATES},
            attention=sum(row.asset.attention is not None for row in some),
            unacknowledged=sum(row.asset.unacknowledged for row in some),
            age_s=round(now_s - min(heard_s, default=now_s), 1),
            revision=self.replicas.revision,
        )
        return page, Place(sort=sort, key=key(items[-1])) if more else None

    def map(self) -> FleetMap:
        """Give the state of every asset.

        Raises
        ------
        CellUnavailableError
            While the cell does not answer.
        """
        self._listing()
        marks = "".join(self._rows[name].mark for name in sorted(self._rows))
        return FleetMap(revision=self.replicas.revision, marks=marks)

    def _listing(self) -> list[_Row]:
        """All rows, the most urgent first."""
        now_s = self._asked_s = time.monotonic()
        self._wanted.set()
        away_s = self.replicas.reader.away_s
        if away_s > AWAY_AFTER_S:
            raise CellUnavailableError(f"the cell has not answered for {away_s:.0f} s")
        renewed = self.replicas.revision != self._revision
        if not renewed and now_s - self._listed_s < _LISTED_S:
            return self._order
        assets = self.replicas.assets
        if renewed:
            self._rows = {name: row for name, row in self._rows.items() if name in assets}
        for name, replica in assets.items():
            right_s = now_s - replica.age_s("glance")
            old = now_s - right_s > UNREAD_AFTER_S
            row = self._rows.get(name)
            tag = b"" if old else replica.known_tag("glance")
            if row is None or row.tag != tag or renewed:
                self._rows[name] = _row(_unread(replica.glance()) if old else replica.glance(), tag)
            self._rows[name].right_s = right_s
        self._order = sorted(self._rows.values(), key=lambda row: row.key)
        self._listed_s, self._revision = now_s, self.replicas.revision
        return self._order


def _unread(asset: FleetAsset) -> FleetAsset:
    """What is left of an asset that was not heard of lately: nothing of its state."""
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


def _row(asset: FleetAsset, tag: bytes) -> _Row:
    words: Iterable[str | None] = (asset.id, asset.name, asset.group, asset.bearing)
    text = " ".join(word for word in words if word).casefold()
    return _Row(asset, tag, -1e9, _urgency(asset), text, _mark(asset))


def _urgency(asset: FleetAsset) -> Key:
    """Sort key: an alarm by priority, then the shortest time to a limit, then what is missing."""
    if asset.attention is None:
        rank = {"safe": _LAST - 2, "waiting": _LAST - 1}.get(asset.state, _LAST)
        return float(rank), 0.0, 0.0, asset.id
    rank = ATTENTIONS.index(asset.attention)
    seconds = 0.0 if asset.state == "over" else asset.seconds_to_limit
    soon_s = 1e9 if seconds is None else seconds
    first = 0.0
    if asset.alarm is not None:
        # Of one priority what is measured comes first, then lost data, then what is predicted.
        certainty = 2 if asset.alarm.predicted else 1 if asset.state != "over" else 0
        first = asset.alarm.priority + certainty / 4
    elif asset.limit is not None and asset.state == "over":
        first = 0.0 if asset.limit.level == "alarm" else 1.0
    return float(rank), first, soon_s, asset.id


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
