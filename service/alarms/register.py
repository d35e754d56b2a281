"""What the alarm book knows: every watched condition with its alarm, and which alarms are open."""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

from service.alarms.records import (
    AlarmKey,
    assets_of,
    key_of,
    moved,
    normal_alarm,
    updated,
    urgency,
)
from service.alarms.states import SET_ASIDE_STATES, AlarmState
from service.alarms.timers import Timer
from service.domain.alarm_condition import AlarmCondition
from service.domain.alarm_guidance import AlarmName
from service.domain.errors import BearingTwinError
from service.store import Alarm

_NORMAL = AlarmState.NORM.value


class UnknownAlarmError(BearingTwinError, KeyError):
    """There is no alarm of this id."""


@dataclass(slots=True)
class Watched:
    """One condition that is watched.

    - ``condition``: its latest truth; None for an alarm of before a restart until it is evaluated.
    - ``figures``: the latest figures of a normal alarm, put in when somebody looks at it: of
      hundreds of machines all that is normal is renewed every few seconds.
    - ``timer``: runs while the condition is known to differ from its alarm.
    - ``had``: of a shared cause: the assets that have had it in this life of the alarm.
    - ``judged_from_us``: samples of before it count no more: the alarm was set aside then.
    """

    alarm: Alarm
    condition: AlarmCondition | None = None
    figures: AlarmCondition | None = None
    timer: Timer | None = None
    had: frozenset[str] = frozenset()
    judged_from_us: int = 0

    def join(self, condition: AlarmCondition) -> frozenset[str]:
        """Note who has the condition now; gives those that are new in this life of the alarm."""
        if not condition.assets or not condition.active:
            return frozenset()
        new = frozenset(condition.assets) - self.had
        self.had |= new
        return new

    @property
    def is_normal(self) -> bool:
        """Whether the alarm is normal."""
        return self.alarm.state == _NORMAL

    @property
    def rests(self) -> bool:
        """Whether the alarm is normal, and no delay is running towards anything else."""
        return self.timer is None and self.alarm.state == _NORMAL

    @property
    def shown(self) -> Alarm:
        """The alarm with its latest figures."""
        figures = self.figures
        if figures is None or self.alarm.state != _NORMAL:
            return self.alarm
        return updated(self.alarm, figures)


class Register:
    """Holds the watched conditions by asset and key; the alarm book guards it with its lock.

    What is asked of one alarm, or of one asset, never goes through the conditions of all.

    ``surplus``: open alarms of a shared cause that has another one.
    """

    def __init__(self, alarms: Iterable[Alarm]) -> None:
        self._watched: defaultdict[str, dict[AlarmKey, Watched]] = defaultdict(dict)
        # Those of them whose alarm is not normal.
        self._open: defaultdict[str, dict[AlarmKey, Watched]] = defaultdict(dict)
        self._keys: dict[str, AlarmKey] = {}  # by the id of the alarm
        # Alarms that come back at a time, in the order in which they were shelved.
        self._shelved: dict[AlarmKey, int] = {}
        self._looked_us, self._none_before_us = math.inf, -math.inf
        self._present: defaultdict[str, set[tuple[str, str, str]]] = defaultdict(set)
        # Of shared causes: the assets that an open alarm lists, and the alarms that list an asset.
        self._lists: dict[AlarmKey, tuple[str, ...]] = {}
        self._listing: defaultdict[str, dict[AlarmKey, None]] = defaultdict(dict)
        self.surplus: list[Alarm] = []
        # By id: since when alarms are in their state that were dated by another clock.
        self._elsewhere: dict[str, int] = {}
        self.add(alarms)

    def add(self, alarms: Iterable[Alarm]) -> None:
        """Take in alarms that are open; nothing is known of their conditions yet.

        Earlier versions had an alarm of a shared cause for each asset, and so has another cell for
        its own assets: one that is open here, else the most urgent one, is kept.
        """
        for alarm in sorted(alarms, key=urgency):
            key = key_of(alarm)
            known = self._open[key[0]].get(key)
            if known is None or key[0]:
                self.drop(key)
                known = self._watched[key[0]][key] = self._open[key[0]][key] = Watched(alarm)
                self._keys[alarm.id] = key
                self._elsewhere[alarm.id] = alarm.since_us
                self._note(key, alarm)
            else:
                self.surplus.append(alarm)
            if alarm.present:
                known.had |= frozenset(assets_of(alarm))
                if alarm is not known.alarm and known.alarm.present:
                    both = {*assets_of(known.alarm), *assets_of(alarm)}
                    self.keep(replace(known.alarm, assets=tuple(sorted(both))))
        self._looked_us = math.inf  # the clock may have been set since they were shelved

    def take(self, condition: AlarmCondition, now_us: int) -> Watched:
        """Record the latest truth of a condition, and give what is known of it."""
        key = condition.key
        of_asset = self._watched[key[0]]
        watched = of_asset.get(key)
        if watched is None:
            watched = of_asset[key] = Watched(normal_alarm(condition, now_us))
            self._keys[watched.alarm.id] = key
        watched.condition = condition
        return watched

    def condition(self, alarm: Alarm) -> AlarmCondition | None:
        """Latest truth of an alarm's condition, if it has been evaluated."""
        key = key_of(alarm)
        watched = self._watched.get(key[0], {}).get(key)
        return None if watched is None else watched.condition

    def find(self, alarm_id: str) -> Alarm:
        """Give one alarm. Raises `UnknownAlarmError` if there is no alarm of this id."""
        key = self._keys.get(alarm_id)
        if key is None:
            raise UnknownAlarmError(f"no open alarm {alarm_id!r}")
        return self._watched[key[0]][key].shown

    def open_of(self, asset: str) -> list[Alarm]:
        """All alarms of an asset that are not normal."""
        return [watched.alarm for watched in self.listed(asset, normal=False)]

    def shared(self) -> dict[AlarmKey, Alarm]:
        """All alarms of shared causes that are not normal."""
        return {key: watched.alarm for key, watched in self._open[""].items()}

    def assets(self, normal: bool) -> list[str]:
        """Assets with alarms that are normal, or that are not, in the order of their ids."""
        known = self._watched if normal else self._open
        return sorted(asset for asset, some in known.items() if some)

    def listed(self, asset: str | None, normal: bool) -> list[Watched]:
        """All conditions whose alarm is normal, or is not, of one asset or of all."""
        known = self._watched if normal else self._open
        if asset is None:
            found = [watched for one in known.values() for watched in one.values()]
        else:
            found = list(known.get(asset, {}).values())
            if normal:
                shared = self._watched[""].values()
                found += [one for one in shared if asset in assets_of(one.shown)]
            else:
                found += [self._open[""][key] for key in self._listing.get(asset, ())]
        return [watched for watched in found if watched.is_normal == normal]

    def present(self, asset: str) -> frozenset[tuple[str, str, str]]:
        """Kind, channel and level of every condition of an asset that is there."""
        return frozenset(self._present.get(asset, ()))

    def shelving_over(self, now_us: int, longest_us: int, most: int) -> list[Alarm]:
        """Some of the alarms whose time is over, or lies further ahead than any may.

        ``longest_us``: no alarm is shelved for longer than that, but by another clock;
        ``most``: so many at most; the next call gives the next ones.
        """
        if self._looked_us <= now_us < self._none_before_us:
            return []
        self._looked_us = now_us
        over = [
            key
            for key, until_us in self._shelved.items()
            if not 0 < until_us - now_us <= longest_us
        ]
        waiting = self._shelved.keys() - over
        ends_us = min((self._shelved[key] for key in waiting), default=math.inf)
        self._none_before_us = ends_us if len(over) <= most else now_us
        return [self._open[key[0]][key].alarm for key in over[:most]]

    def dated_elsewhere(self) -> set[str]:
        """Give the ids of open alarms whose times are by another clock, and go by the calendar."""
        return {
            watched.alarm.id
            for of_asset in self._open.values()
            for watched in of_asset.values()
            if self._elsewhere.get(watched.alarm.id) == watched.alarm.since_us
        }

    def dated_here(self) -> None:
        """Take the times of all alarms for times by this clock."""
        self._elsewhere.clear()

    def clock_set(self, by_us: int) -> list[Alarm]:
        """Move all times, as the clock was set by so much; gives the open alarms as they are then.

        An alarm that was never raised and is not set aside has no time that counts.
        """
        elsewhere = self.dated_elsewhere()
        for of_asset in self._watched.values():
            for watched in of_asset.values():
                watched.judged_from_us += by_us
                if watched.timer is not None:
                    watched.timer.clock_set(by_us)
        open_alarms = [
            moved(watched.alarm, by_us)
            for of_asset in self._open.values()
            for watched in of_asset.values()
            if watched.alarm.id not in elsewhere
        ]
        for alarm in open_alarms:
            self.keep(alarm)
        self._looked_us, self._none_before_us = math.inf, -math.inf
        return open_alarms

    def pause_timers(self, asset: str) -> None:
        """Let the delays of an asset's conditions stand still until they are known again."""
        for watched in self._watched.get(asset, {}).values():
            if watched.timer is not None:
                watched.timer.pause()

    def drop_timers(self, asset: str, names: Collection[AlarmName]) -> None:
        """Let delays begin from zero, by kind, channel and level."""
        known = self._watched.get(asset, {})
        for name in names:
            if (watched := known.get((asset, *name))) is not None:
                watched.timer = None

    def keep(self, alarm: Alarm) -> None:
        """Take in an alarm that stays in its state."""
        key = key_of(alarm)
        self._watched[key[0]][key].alarm = alarm
        self._note(key, alarm)

    def move(self, alarm: Alarm, now_us: int) -> None:
        """Take in an alarm that has changed its state; when it is over, its next life begins."""
        key = key_of(alarm)
        watched = self._watched[key[0]][key]
        is_back = watched.alarm.state in SET_ASIDE_STATES and alarm.state not in SET_ASIDE_STATES
        if is_back:
            watched.judged_from_us = now_us
        if is_back or watched.alarm.present != alarm.present:
            watched.timer = None
        watched.alarm, watched.figures = alarm, None
        if alarm.state != _NORMAL:
            self._open[key[0]][key] = watched
        else:
            self._open[key[0]].pop(key, None)
            watched.had = frozenset()
            if watched.condition is None:
                self.drop(key)
            else:
                watched.alarm = normal_alarm(watched.condition, now_us)
                if not alarm.raised_at_us:  # this life has not begun yet
                    watched.alarm = replace(watched.alarm, id=alarm.id)
                self._keys.pop(alarm.id, None)
                self._elsewhere.pop(alarm.id, None)
                self._keys[watched.alarm.id] = key
        self._note(key, alarm)

    def forget(self, assets: Collection[str]) -> None:
        """Know nothing of assets any more."""
        for asset in assets:
            for key in list(self._watched.get(asset, ())):
                self.drop(key)
            for known in (self._watched, self._open, self._present):
                known.pop(asset, None)

    def drop(self, key: AlarmKey) -> None:
        """Know nothing of one condition any more."""
        watched = self._watched[key[0]].pop(key, None)
        self._open[key[0]].pop(key, None)
        if watched is not None:
            self._keys.pop(watched.alarm.id, None)
            self._elsewhere.pop(watched.alarm.id, None)
            self._note(key, replace(watched.alarm, state=_NORMAL, shelved_until_us=None))

    def _note(self, key: AlarmKey, alarm: Alarm) -> None:
        """Note whether the condition is there, and when a shelved alarm comes back."""
        if alarm.shelved_until_us is None:
            self._shelved.pop(key, None)
        else:
            self._shelved[key] = alarm.shelved_until_us
            self._none_before_us = min(self._none_before_us, alarm.shelved_until_us)
        is_open = alarm.state != _NORMAL
        if key[0]:
            about: tuple[str, ...] = (key[0],)
        else:
            about = assets_of(alarm) if is_open else ()
            before = self._lists.pop(key, ())
            for asset in before if before != about else ():
                self._listing[asset].pop(key, None)
                self._present[asset].discard(key[1:])
            for asset in about:
                self._listing[asset][key] = None
            if about:
                self._lists[key] = about
        for asset in about:
            present = self._present[asset]
            (present.add if alarm.present and is_open else present.discard)(key[1:])
