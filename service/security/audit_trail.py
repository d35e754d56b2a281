"""Writes changes into the audit trail without ever holding one up for long."""

import asyncio
from dataclasses import dataclass

import structlog
from anyio import to_thread

from service.clock import wall_us
from service.security.keys import Actor
from service.security.sites import site_of
from service.store import AuditEntry, Outbox

PATIENCE_S = 1.0
FOLD_S = 60.0
_MOST_FOLDS = 1024

_log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Fold:
    """What came again within a minute."""

    actor: Actor
    action: str
    more: int = 0
    detail: str = ""


class AuditTrail:
    """Notes what callers did. ``fold_s``: seconds for which `note_repeated` writes one line."""

    def __init__(self, outbox: Outbox, fold_s: float = FOLD_S) -> None:
        self._outbox = outbox
        self._fold_s = fold_s
        self._folds: dict[tuple[str, str, str], _Fold] = {}

    async def note(self, actor: Actor, action: str, target: str = "", detail: str = "") -> None:
        """Write one line; a store that does not answer within a second gets it later."""
        entry = AuditEntry(wall_us(), actor.who, actor.address, action, target, detail)
        _log.info("audit", who=actor.who, address=actor.address, action=action, target=target)
        self._outbox.record(entry)
        await self.flush()

    async def note_repeated(self, actor: Actor, action: str, detail: str = "") -> None:
        """Write what anybody may cause as often as he likes: one line a minute for each address.

        The first is written at once; of those that follow within a minute, one line with their
        number. No one can fill the trail, which cannot be trimmed for a year.
        """
        name = (action, actor.who, site_of(actor.address))
        if name not in self._folds and len(self._folds) >= _MOST_FOLDS:
            actor, name = Actor(actor.who, "several"), (action, actor.who, "several")
        fold = self._folds.get(name)
        if fold is not None:
            fold.more += 1
            fold.detail = detail
            return
        self._begin(name, actor)
        await self.note(actor, action, "", detail)

    def settle(self) -> None:
        """Write what has been counted and not written; the service ends."""
        for name in list(self._folds):
            self._write(self._folds.pop(name))

    def _begin(self, name: tuple[str, str, str], actor: Actor) -> None:
        self._folds[name] = _Fold(actor, name[0])
        asyncio.get_running_loop().call_later(self._fold_s, self._end, name)

    def _end(self, name: tuple[str, str, str]) -> None:
        fold = self._folds.pop(name, None)
        if fold is not None and fold.more:
            self._write(fold)
            self._begin(name, fold.actor)  # whatever goes on is counted again

    def _write(self, fold: _Fold) -> None:
        if not fold.more:
            return
        who, address = fold.actor.who, fold.actor.address
        last = fold.detail or "the same"
        detail = f"{fold.more} more within {self._fold_s:g} s, the last: {last}"
        self._outbox.record(AuditEntry(wall_us(), who, address, fold.action, "", detail))

    async def flush(self) -> None:
        """Wait until all is written, or safe on the disk while the store is away."""
        await to_thread.run_sync(self._outbox.flush, PATIENCE_S, abandon_on_cancel=True)
