"""Upkeep of the store beside the work: rollups are computed, what is old is removed."""

import asyncio

import structlog
from anyio import to_thread

from adapters.drivers import Clock
from service.security.keys import wall_us
from service.store import Retention, Store, StoreUnavailableError

#: Wall seconds between two looks for hours to condense, and for samples that are too old.
ROLLUPS_EVERY_S = 30.0
EXPIRE_EVERY_S = 600.0
#: Process time that a finished hour is given for late samples; later ones are right as well,
#: but cost another computation.
_SETTLE_US = 120_000_000
_DAY_US = 86_400_000_000

_log = structlog.get_logger(__name__)


async def keep_up(store: Store, clock: Clock, retention: Retention) -> None:
    """Keep rollups up to date and the store within its retention, until cancelled.

    Parameters
    ----------
    store
        Open store.
    clock
        Process time.
    retention
        How long each resolution is kept.
    """
    expire_at_s = 0.0
    while True:
        now_s = asyncio.get_running_loop().time()
        try:
            await to_thread.run_sync(_refresh, store, clock.now_us() - _SETTLE_US)
            if now_s >= expire_at_s:
                expire_at_s = now_s + EXPIRE_EVERY_S
                removed = await to_thread.run_sync(_expire, store, retention, clock.now_us())
                if removed:
                    _log.info("expired", rows=removed)
        except StoreUnavailableError as error:
            _log.warning("upkeep_postponed", error=str(error))
        await asyncio.sleep(ROLLUPS_EVERY_S)


def _expire(store: Store, retention: Retention, now_us: int) -> int:
    removed = store.expire(retention, now_us)
    if retention.journal_days:
        removed += store.expire_journal(now_us - round(retention.journal_days * _DAY_US))
    if retention.audit_days:  # the trail goes by the wall clock
        removed += store.expire_audit(wall_us() - round(retention.audit_days * _DAY_US))
    return removed


def _refresh(store: Store, before_us: int) -> None:
    while store.refresh_rollups(before_us):
        pass
