"""One alarm for what many assets have of one cause: a lost source, a wrong clock."""

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

from service.alarms.book import AlarmBook
from service.alarms.records import AlarmKey, assets_of
from service.alarms.timers import Timer
from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_kind import CLOCK_AHEAD
from service.domain.causes import STALE_DATA, source_of
from service.store import Alarm

#: What is said of a source for several assets, each of which has figures of its own.
_OF_MANY = {STALE_DATA: "no data", CLOCK_AHEAD: "clock ahead, values uncertain"}


@dataclass(slots=True)
class _Member:
    """What one asset says of a cause; ``has``: with its delays, None while it is not known."""

    condition: AlarmCondition
    has: bool | None
    timer: Timer | None = None

    def take(self, condition: AlarmCondition, now_us: int) -> bool:
        """Record the latest truth; says whether anything has changed."""
        before = self.condition, self.has
        self.condition, holds = condition, condition.active
        if holds is None:
            if self.timer is not None:
                self.timer.pause()
        elif holds == bool(self.has):
            self.has, self.timer = holds, None
        else:
            self.timer = self.timer or Timer()
            delay_s = condition.on_delay_s if holds else condition.off_delay_s
            if self.timer.run(now_us) >= delay_s:
                self.has, self.timer = holds, None
        return before != (condition, self.has)


class SharedCauses:
    """Puts together what the assets of a cell say of causes that they share.

    Each asset has its own settings: it counts after its own delays, and the priority is the most
    urgent one of those that have the cause. The alarm is kept under one of the assets, with which
    it goes to another cell.

    Parameters
    ----------
    book : AlarmBook
        Takes the conditions that are put together.
    """

    def __init__(self, book: AlarmBook) -> None:
        self._book = book
        self._of: defaultdict[AlarmKey, dict[str, _Member]] = defaultdict(dict)
        self._together: dict[AlarmKey, AlarmCondition] = {}
        # Followed here, but not heard of yet.
        self._expected: set[str] = set()

    def expect(self, assets: Iterable[str]) -> None:
        """Wait for the word of assets: until then an alarm that names them stays as it is."""
        self._expected.update(assets)

    def take(self, condition: AlarmCondition, now_us: int) -> None:
        """Record the latest truth of one asset."""
        key, asset = condition.key, condition.asset
        of = self._of[key]
        member = of.get(asset)
        if member is None:
            alarm = self._book.shared().get(key)
            had = alarm is not None and alarm.present and asset in assets_of(alarm)
            member = of[asset] = _Member(condition, True if had else None)
            self._together.pop(key, None)
        if member.take(condition, now_us):
            self._together.pop(key, None)

    def settle(self, asset: str, keys: Collection[AlarmKey]) -> None:
        """Record that an asset has said all; of its sources it says nothing but ``keys`` now."""
        self._expected.discard(asset)
        for key, of in list(self._of.items()):
            if asset in of and key[2] and key not in keys:
                self._part(key, {asset}, ())

    def leave(self, assets: Collection[str]) -> None:
        """Know nothing of some assets any more: another cell follows them."""
        self._forget(assets, None)

    def forget(self, assets: Collection[str]) -> None:
        """Know nothing of assets that are not followed any more; what only they had has ended."""
        self._forget(assets, ())

    def assets_of(self, alarm: Alarm, key: AlarmKey) -> Collection[str]:
        """Give all assets that have, or could have, what an alarm is about."""
        return {*assets_of(alarm), *self._of.get(key, ())}

    def clock_set(self, by_us: int) -> None:
        """Let the delays go on: the clock was set by so much."""
        for of in self._of.values():
            for member in of.values():
                if member.timer is not None:
                    member.timer.clock_set(by_us)

    def evaluate(self) -> None:
        """Judge every cause by what its assets have said so far."""
        alarms = self._book.shared()
        for key, alarm in alarms.items():
            if key not in self._of and self._expected.isdisjoint(assets_of(alarm)):
                self._book.keep_under(key, ())
        self._book.evaluate_all(
            [
                self._together.get(key) or self._put_together(key, alarms.get(key))
                for key in self._of
            ]
        )

    def _put_together(self, key: AlarmKey, alarm: Alarm | None) -> AlarmCondition:
        of = self._of[key]
        having = [one.condition for one in of.values() if one.has]
        chosen = having or [one.condition for one in of.values()]
        # What of the alarm nothing is known of yet stays as it was.
        listed = assets_of(alarm) if alarm is not None and alarm.present else ()
        unheard = self._expected.intersection(listed)
        active: bool | None = bool(having)
        if not having and (unheard or all(one.has is None for one in of.values())):
            active = None
        first = min(chosen, key=lambda one: (one.priority, one.asset))
        assets = tuple(sorted({*(one.asset for one in chosen), *unheard}))
        together = replace(
            first,
            asset=alarm.asset if alarm is not None and alarm.asset in of else min(of),
            active=active,
            message=_message(key, assets, first),
            on_delay_s=0.0,
            off_delay_s=0.0,
            latched=any(one.latched for one in chosen),
            re_alarm_s=min((one.re_alarm_s for one in chosen if one.re_alarm_s), default=0.0),
            covers=tuple(sorted({channel for one in chosen for channel in one.covers})),
            assets=assets,
        )
        if not unheard:
            self._together[key] = together
        return together

    def _forget(self, assets: Collection[str], left: Collection[str] | None) -> None:
        self._expected.difference_update(assets)
        for key in list(self._of):
            self._part(key, assets, left)
        for key, alarm in self._book.shared().items():
            if key not in self._of and alarm.asset in assets:
                self._book.keep_under(key, left)

    def _part(self, key: AlarmKey, assets: Collection[str], left: Collection[str] | None) -> None:
        """Leave some assets out of a cause; ``left``: what becomes of its alarm without any."""
        of = self._of[key]
        gone = [asset for asset in assets if of.pop(asset, None) is not None]
        if not gone:
            return
        self._together.pop(key, None)
        self._book.keep_under(key, of.keys() or left)
        if not of:
            del self._of[key]


def _message(key: AlarmKey, assets: Collection[str], first: AlarmCondition) -> str:
    if len(assets) == 1:
        return first.message
    what = f"{source_of(key[2])}: {_OF_MANY[key[1]]}" if key[1] in _OF_MANY else first.message
    return f"{what}, {len(assets)} assets"
