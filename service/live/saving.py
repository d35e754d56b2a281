"""Keeps the state of one asset for the next start, with what people changed in it."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from service.live.called_steps import called_steps_of, called_steps_to_rows
from service.live.estimate import LiveEstimate
from service.live.guard import Guard
from service.live.kept import KeptState
from service.store import AuditEntry

SaveState = Callable[[KeptState, Sequence[AuditEntry]], Awaitable[None]]
"""Keeps a state, in the order of the calls; may give the same future to many that go together."""


class Saving:
    """Saves the state of one asset, with the lines of the audit trail about what changed it.

    - ``save_state``: takes both.
    - ``state``: gives the present state, which there is to keep when the estimate has started.
    """

    __slots__ = ("_audit", "_estimate", "_guard", "_keeping", "_save_state", "_state")

    def __init__(
        self,
        asset: str,
        save_state: SaveState,
        estimate: LiveEstimate,
        state: Callable[[], KeptState],
    ) -> None:
        self._save_state = save_state
        self._estimate = estimate
        self._state = state
        self._keeping = asyncio.Lock()
        self._audit: list[AuditEntry] = []
        self._guard = Guard("saving_the_estimate", asset)

    def begin(self) -> "asyncio.Future[None] | None":
        """Begin to save; `ended` must be informed when the future is done.

        None where there is nothing to keep.
        """
        if not self._estimate.started:
            return None
        if self._audit or self._keeping.locked():
            saved = asyncio.ensure_future(self.keep())
        else:
            saved = asyncio.ensure_future(self._save_state(self._state(), ()))
        saved.add_done_callback(_read_outcome)
        return saved

    def ended(self, error: BaseException | None) -> None:
        """Log that saving fails, or works again."""
        with self._guard():
            if error is not None:
                raise error

    async def last(self) -> None:
        """Save a last time."""
        if self._estimate.started:
            with self._guard():
                await self.keep()

    async def keep(self, line: AuditEntry | None = None) -> None:
        """Save the state, with the lines of the audit trail about what people changed in it.

        A store that is away takes them with the first state that it takes again. Once begun it
        ends, also if the caller goes: a line that is on its way must not be sent again.
        """
        if line is not None:
            self._audit.append(line)
        keeping = asyncio.ensure_future(self._keep_next())
        keeping.add_done_callback(_read_outcome)
        await asyncio.shield(keeping)

    async def _keep_next(self) -> None:
        async with self._keeping:
            lines = tuple(self._audit)
            await asyncio.shield(self._save_state(self._state(), lines))
            del self._audit[: len(lines)]

    async def take_over(self, before: "Saving") -> KeptState | None:
        """Take the lines that another could not bring into the store; gives its last state."""
        async with before._keeping:
            self._audit += before._audit
            before._audit = []
        return before._state() if before._estimate.started else None


def _read_outcome(done: "asyncio.Future[None]") -> None:
    """Read how it went: perhaps no caller is left who would, and Python would log an error."""
    if not done.cancelled():
        done.exception()


def move_kept(state: KeptState, by_us: int) -> None:
    """Move the times of a state, as the clock was set by so much; what is of no use stays."""
    time_us = state.get("time_us")
    if isinstance(time_us, int):
        state["time_us"] = time_us + by_us
    try:
        called = called_steps_of(state.get("called_steps") or [])
    except ValueError:
        return
    state["called_steps"] = called_steps_to_rows(one.moved(by_us) for one in called)
