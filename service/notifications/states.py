"""How notifications are: what cells say of them, and what of several cells is said once."""

from collections.abc import Iterable, Sequence

import msgspec


class NotificationState(msgspec.Struct, frozen=True, array_like=True):
    """How one notification is (wall time, UTC microseconds).

    Attributes
    ----------
    id
        Of the notification.
    waiting
        Alarms of which something has to be told.
    held
        Of these, alarms that quiet hours or a silence hold back.
    told_us
        When the latest message was told; None: not since the start.
    failing_since_us
        When the first of the tries failed that have failed in a row; None where the last did not.
    tries
        How many these are.
    error
        What was wrong last; also what was refused for some of several receivers.
    """

    id: str
    waiting: int = 0
    held: int = 0
    told_us: int | None = None
    failing_since_us: int | None = None
    tries: int = 0
    error: str = ""


def merged(answers: Iterable[Sequence[NotificationState]]) -> list[NotificationState]:
    """Say of several cells together how each notification is."""
    found: dict[str, NotificationState] = {}
    for state in (state for states in answers for state in states):
        known = found.get(state.id)
        found[state.id] = state if known is None else _together(known, state)
    return list(found.values())


def _together(one: NotificationState, other: NotificationState) -> NotificationState:
    worse = max(one, other, key=lambda state: (state.tries, bool(state.error)))
    since = [us for us in (one.failing_since_us, other.failing_since_us) if us is not None]
    return NotificationState(
        id=one.id,
        waiting=one.waiting + other.waiting,
        held=one.held + other.held,
        told_us=max(one.told_us or 0, other.told_us or 0) or None,
        failing_since_us=min(since, default=None),
        tries=worse.tries,
        error=worse.error,
    )
