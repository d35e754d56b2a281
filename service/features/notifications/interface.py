"""What is asked of the notifications of a cell, and what several cells answer together."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import msgspec

from service.bus.messages import WHILE_S, Call
from service.domain.roles import ENGINEER
from service.store import AuditEntry


class NotificationState(msgspec.Struct, frozen=True, array_like=True):
    """How one notification is (wall time, UTC microseconds).

    Attributes
    ----------
    id
        Of the notification.
    waiting
        Alarms with something pending.
    held
        Of these, alarms that quiet hours or a silence hold back.
    sent_us
        When the latest message was accepted; None: none since the start.
    failing_since_us
        When the first of the tries failed that have failed in a row; None where the last did not.
    tries
        How many these are.
    error
        What was wrong last; also what was refused for some of several receivers.
    given_up
        Alarms with events that the receiver refused for good, since the start.
    """

    id: str
    waiting: int = 0
    held: int = 0
    sent_us: int | None = None
    failing_since_us: int | None = None
    tries: int = 0
    error: str = ""
    given_up: int = 0


def merged(answers: Iterable[Sequence[NotificationState]]) -> list[NotificationState]:
    """Make one state of each notification of those of several cells."""
    merged_states: dict[str, NotificationState] = {}
    for state in (state for states in answers for state in states):
        other = merged_states.get(state.id)
        merged_states[state.id] = state if other is None else _together(other, state)
    return list(merged_states.values())


def _together(one: NotificationState, other: NotificationState) -> NotificationState:
    worse = max(one, other, key=lambda state: (state.tries, bool(state.error)))
    since = [us for us in (one.failing_since_us, other.failing_since_us) if us is not None]
    return NotificationState(
        id=one.id,
        waiting=one.waiting + other.waiting,
        held=one.held + other.held,
        sent_us=max(one.sent_us or 0, other.sent_us or 0) or None,
        failing_since_us=min(since, default=None),
        tries=worse.tries,
        error=worse.error,
        given_up=one.given_up + other.given_up,
    )


class Notifications(Protocol):
    """The notifications of the cell."""

    @Call(shared=True, merge=merged)
    async def states(self) -> list[NotificationState]:
        """How each notification is, in the order of the configuration."""

    @Call(ENGINEER, patience_s=WHILE_S, of_any=True)
    async def test(
        self, notification: str, who: str, audit: AuditEntry | None = None
    ) -> tuple[bool, str]:
        """Send a test message; gives whether it was accepted, and why not or by whom not."""
