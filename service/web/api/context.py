"""What the web side leans on."""

from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry

from adapters.protocol import Clock
from service.bus.replica import AssetReplica
from service.bus.stream import Bus
from service.site.settings import Settings
from service.store import Outbox, Store
from service.web.cell import CellAlarms, CellHealth, CellIngest, CellJobs, CellNotifications
from service.web.overview import Overview


async def _nothing(assets: Collection[str] | None) -> None:
    """Bring nothing up to date."""


async def _all_are(assets: Collection[str] | None) -> int:
    """Say that there are all live messages."""
    return 0


async def _no_assets() -> Mapping[str, str]:
    return {}


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """Everything the web side leans on, put together at its start.

    Attributes
    ----------
    settings, clock, store
        Configuration, process time, store.
    outbox
        Where lines of the audit trail wait for the store.
    bus
        Live messages.
    ingest, alarms, notifications, jobs, health
        What the cell does and knows.
    assets
        By id.
    fleet
        All assets at a glance.
    refresh_summaries
        Brings the summaries of some assets, or of all, up to date.
    changed
        Makes the copies of what the cell knows of an asset, or of all, old ones; to be called after
        a change.
    follow
        Has the cell make the live messages of some assets, or of all; gives the number after which
        there are all of them.
    apply_assets
        Has the cell take up the assets that the store holds now; gives which cannot, and why.
    is_known
        Tells whether an asset that is not among `assets` is one all the same, which no cell of the
        fleet follows at the moment.
    apply_file
        Has the service follow the configuration file as it is now; None where only a restart does.
    registry
        Metrics of the web side itself.
    """

    settings: Settings
    clock: Clock
    store: Store
    outbox: Outbox
    bus: Bus
    ingest: CellIngest
    alarms: CellAlarms
    notifications: CellNotifications
    assets: Mapping[str, AssetReplica]
    jobs: CellJobs
    health: CellHealth
    fleet: Overview
    refresh_summaries: Callable[[Collection[str] | None], Awaitable[None]] = _nothing
    changed: Callable[[str | None], None] = lambda asset: None
    follow: Callable[[Collection[str] | None], Awaitable[int]] = _all_are
    apply_assets: Callable[[], Awaitable[Mapping[str, str]]] = _no_assets
    is_known: Callable[[str], bool] = lambda asset: False
    apply_file: Callable[[], None] | None = None
    registry: CollectorRegistry = field(default_factory=CollectorRegistry)
