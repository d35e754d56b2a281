"""Writes changes into the audit trail without ever holding one up for long."""

import structlog
from anyio import to_thread

from service.security.keys import Actor, wall_us
from service.store import AuditEntry, Outbox

PATIENCE_S = 1.0

_log = structlog.get_logger(__name__)


class AuditTrail:
    """Notes what callers did.

    Parameters
    ----------
    outbox : Outbox
        Takes the lines.
    """

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox

    async def note(self, actor: Actor, action: str, target: str = "", detail: str = "") -> None:
        """Write one line; a store that does not answer within a second gets it later."""
        entry = AuditEntry(wall_us(), actor.who, actor.address, action, target, detail)
        _log.info("audit", who=actor.who, address=actor.address, action=action, target=target)
        self._outbox.record(entry)
        await self.flush()

    async def flush(self) -> None:
        """Wait until all is written, or safe on the disk while the store is away."""
        await to_thread.run_sync(self._outbox.flush, PATIENCE_S, abandon_on_cancel=True)
