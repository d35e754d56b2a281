"""What the alarm book knows: every watched condition with its alarm, and which alarms are open."""

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

from service.alarms.records import AlarmKey, key_of, normal_alarm, updated
from service.alarms.states import AlarmState
from service.alarms.timers import Timer
from service.domain.alarm_condition import AlarmCondition
from service.store import Alarm

_NORMAL = AlarmState.NORM.value


class UnknownAlarmError(KeyError):
    """There is no alarm of this id."""


@dataclass(slots=True)
class Watched:
    """One condition that is watched.

    Attributes
    ----------
    alarm : Alarm
        Its alarm: the open one, else the normal one, which may have older figures than these.
    condition : AlarmCondition or None
        Its latest truth; None for an alarm of before a restart until it is evaluated.
    figures : AlarmCondition or None
        The latest figures of a normal alarm, put in when somebody looks at it: of hundreds of
        machines all that is normal is renewed every few seconds.
    timer : Timer or None
        Runs while the condition is known to differ from its alarm.
    """

    alarm: Alarm
    condition: AlarmCondition | None = None
    figures: AlarmCondition | None = None
    timer: Timer | None = None

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
    """Holds the watched conditions by their keys; the alarm book guards it with its lock.

    Parameters
    ----------
    alarms : iterable of Alarm
        Those that were open when the service stopped.

    Attributes
    ----------
    open : dict
        Those whose alarm is not normal.
    shelved : dict
        Keys of the alarms that come back by themselves, in the order in which they were shelved.
    """

    def __init__(self, alarms: Iterable[Alarm]) -> None:
        self._watched: dict[AlarmKey, Watched] = {}
        self.open: dict[AlarmKey, Watched] = {}
        self.shelved: dict[AlarmKey, None] = {}
        self._present: defaultdict[str, set[tuple[str, str, str]]] = defaultdict(set)
        self.add(alarms)

    def add(self, alarms: Iterable[Alarm]) -> None:
        """Take in alarms that are open; nothing is known of their conditions yet."""
        for alarm in alarms:
            key = key_of(alarm)
            self._watched[key] = self.open[key] = Watched(alarm)
            self._note(key, alarm)

    def take(self, condition: AlarmCondition, now_us: int) -> Watched:
        """Take note of the latest truth of a condition, and give what is known of it."""
        key = condition.key
        watched = self._watched.get(key)
        if watched is None:
            watched = self._watched[key] = Watched(normal_alarm(condition, now_us))
        watched.condition = condition
        return watched

    def condition(self, alarm: Alarm) -> AlarmCondition | None:
        """Latest truth of an alarm's condition, if it has been evaluated."""
        watched = self._watched.get(key_of(alarm))
        return None if watched is None else watched.condition

    def find(self, alarm_id: str) -> Alarm:
        """Give one alarm.

        Raises
        ------
        UnknownAlarmError
            If there is no alarm of this id.
        """
        for known in (self.open, self._watched):
            for watched in known.values():
                if watched.alarm.id == alarm_id:
                    return watched.shown
        raise UnknownAlarmError(f"no open alarm {alarm_id!r}")

    def listed(self, asset: str | None, normal: bool) -> list[Alarm]:
        """All alarms that are normal, or that are not, of one asset or of all."""
        return [
            watched.shown
            for key, watched in (self._watched if normal else self.open).items()
            if (asset is None or key[0] == asset) and (key not in self.open) == normal
        ]

    def present(self, asset: str) -> frozenset[tuple[str, str, str]]:
        """Kind, channel and level of every condition of an asset that is there."""
        return frozenset(self._present.get(asset, ()))

    def keep(self, alarm: Alarm) -> None:
        """Take in an alarm that stays in its state."""
        key = key_of(alarm)
        self._watched[key].alarm = alarm
        self._note(key, alarm)

    def move(self, alarm: Alarm, now_us: int) -> None:
        """Take in an alarm that has changed its state; when it is over, its next life begins."""
        key = key_of(alarm)
        watched = self._watched[key]
        watched.alarm, watched.figures = alarm, None
        if alarm.state != _NORMAL:
            self.open[key] = watched
        else:
            self.open.pop(key, None)
            if watched.condition is None:
                del self._watched[key]
            else:
                watched.alarm = normal_alarm(watched.condition, now_us)
                if not alarm.raised_at_us:  # this life has not begun yet
                    watched.alarm = replace(watched.alarm, id=alarm.id)
        self._note(key, alarm)

    def forget(self, assets: Collection[str]) -> None:
        """Know nothing of assets any more; none of their alarms may be open."""
        for key in [key for key in self._watched if key[0] in assets]:
            del self._watched[key]
        for asset in assets:
            self._present.pop(asset, None)

    def _note(self, key: AlarmKey, alarm: Alarm) -> None:
        """Note whether the condition is there, and whether its alarm comes back by itself."""
        if alarm.shelved_until_us is None:
            self.shelved.pop(key, None)
        else:
            self.shelved[key] = None
        is_there = alarm.present and alarm.state != _NORMAL
        present = self._present[key[0]]
        (present.add if is_there else present.discard)(key[1:])
