"""Writes changes into the audit trail without ever holding one up for long."""

import threading
from collections import deque

import structlog
from anyio import CapacityLimiter, move_on_after, to_thread

from service.security.keys import Actor, wall_us
from service.store import AuditEntry, Store, StoreUnavailableError

PATIENCE_S = 1.0

_log = structlog.get_logger(__name__)


class AuditTrail:
    """A queue in front of the store: what it cannot take now is written with the next line.

    Parameters
    ----------
    store : Store
        Where the trail is kept.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._waiting: deque[AuditEntry] = deque()
        self._writing = threading.Lock()
        self._limiter = CapacityLimiter(1)

    async def note(self, actor: Actor, action: str, target: str = "", detail: str = "") -> None:
        """Write one line; a store that does not answer within a second gets it later."""
        entry = AuditEntry(wall_us(), actor.who, actor.address, action, target, detail)
        _log.info("audit", who=actor.who, address=actor.address, action=action, target=target)
        self._waiting.append(entry)
        await self.flush()

    async def flush(self) -> None:
        """Write what waits, for at most a second."""
        with move_on_after(PATIENCE_S):
            await to_thread.run_sync(self._write, limiter=self._limiter, abandon_on_cancel=True)

    def _write(self) -> None:
        # A thread that was left behind after a second may still be at it.
        with self._writing:
            while self._waiting:
                try:
                    self._store.add_audit_entry(self._waiting[0])
                except StoreUnavailableError as error:
                    _log.warning("audit_waits", lines=len(self._waiting), error=str(error))
                    return
                self._waiting.popleft()
