"""What a receiver refuses for its content: when it is tried again, and when it is given up."""

import math
import time
from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Final

from adapters.backoff import Backoff
from service.features.notifications.messages import Item

#: Tries and wall seconds after which is given up what a receiver refuses that accepts nothing.
TRIES: Final = 3
REFUSED_FOR_S: Final = 600.0
#: Wall seconds between two tries, at most.
LAST_S: Final = 60.0


@dataclass(slots=True)
class _Refusal:
    """Events of an alarm that were refused although they came alone.

    - ``accepted``: messages that were accepted before it was refused first, with others or alone.
    - ``is_final``: whether the same message is of no use later either.
    - ``first_at``, ``last_at``: wall (monotonic) times of its tries.
    """

    events: tuple[str, ...]
    accepted: int
    is_final: bool
    first_at: float
    last_at: float
    tries: int = 0


class Refusals:
    """Alarms that one receiver refused alone: they wait while others are sent.

    ``first_s``: wall seconds between the first two tries.
    """

    def __init__(self, first_s: float) -> None:
        self._alone: dict[str, _Refusal] = {}
        # Messages that had been accepted when an alarm was first in one that was refused.
        self._suspects: dict[str, int] = {}
        # Wall (monotonic) time from which one may be tried again.
        self._from = -math.inf
        self._backoff = Backoff(first_s, LAST_S)
        self._accepted = 0

    def holds(self, item: Item) -> bool:
        """Whether these events of an alarm were refused alone."""
        refusal = self._alone.get(item.alarm.id)
        return refusal is not None and refusal.events == item.events

    def due(self) -> list[str]:
        """Give alarms that may be tried again, the one that waits for the longest time first."""
        if time.monotonic() < self._from:
            return []
        return sorted(self._alone, key=lambda id: self._alone[id].last_at)

    def knows_any(self, items: Iterable[Item]) -> bool:
        """Whether a message with some of these alarms was refused."""
        return any(item.alarm.id in self._suspects for item in items)

    def note_together(self, alarm_ids: Iterable[str]) -> None:
        """Note alarms whose common message was refused."""
        for alarm_id in alarm_ids:
            self._suspects.setdefault(alarm_id, self._accepted)

    def note_alone(self, item: Item, *, is_final: bool) -> bool:
        """Note that an alarm was refused alone; gives whether to give it up.

        That is so if the refusal is final and the receiver accepted others since it was refused
        first, or has refused it for too long.
        """
        alarm_id, now = item.alarm.id, time.monotonic()
        # What is refused for good counts from the first time that it is.
        if not self.holds(item) or (is_final and not self._alone[alarm_id].is_final):
            accepted = self._suspects.get(alarm_id, self._accepted)
            self._alone[alarm_id] = _Refusal(item.events, accepted, is_final, now, now)
        refusal = self._alone[alarm_id]
        refusal.tries += 1
        refusal.last_at = now
        self._from = now + self._backoff.next()
        is_odd = refusal.tries > 1 and self._accepted > refusal.accepted
        is_too_long = refusal.tries >= TRIES and now - refusal.first_at >= REFUSED_FOR_S
        return is_final and (is_odd or is_too_long)

    def note_accepted(self, items: Iterable[Item]) -> None:
        """Note that the receiver accepted a message."""
        self._accepted += 1
        self._backoff.reset()
        self._from = -math.inf
        if any(item.alarm.id in self._alone for item in items):
            # It takes what it did not: what else it could not take goes out together again.
            self._alone = {id: one for id, one in self._alone.items() if one.is_final}

    def forget(self, alarm_id: str) -> None:
        """Forget an alarm of which nothing is pending any more, or other events are."""
        self._alone.pop(alarm_id, None)
        self._suspects.pop(alarm_id, None)

    def keep(self, alarm_ids: Container[str]) -> None:
        """Forget all other alarms."""
        for alarm_id in [id for id in {**self._alone, **self._suspects} if id not in alarm_ids]:
            self.forget(alarm_id)
