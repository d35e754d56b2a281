"""What the web side leans on."""

from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry

from adapters.protocol import Clock
from service.bus.health_reports import HealthReports
from service.bus.replica import AssetReplica
from service.bus.stream import LiveMessages
from service.domain.errors import CellUnavailableError
from service.site.settings import Settings
from service.store import Outbox, Store, StoreUnavailableError
from service.web.cell import AskedCell, CellIngest
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

    - ``outbox``: where lines of the audit trail wait for the store.
    - ``refresh_summaries``: brings the summaries of some assets, or of all, up to date.
    - ``changed``: makes the copies of what the cell knows of some assets, or of all, old ones; to
      be called after a change.
    - ``follow``: has the cell make the live messages of some assets, or of all; gives the number
      after which there are all of them.
    - ``apply_assets``: has the cell take up the assets that the store holds now; gives which
      cannot, and why.
    - ``is_known``: whether an asset that is not among `assets` is one all the same, which no
      cell of the fleet follows at the moment.
    - ``apply_file``: has the service follow the configuration file as it is now; None where only a
      restart does.
    """

    settings: Settings
    clock: Clock
    store: Store
    outbox: Outbox
    bus: LiveMessages
    cell: AskedCell
    ingest: CellIngest
    assets: Mapping[str, AssetReplica]
    health: HealthReports
    fleet: Overview
    refresh_summaries: Callable[[Collection[str] | None], Awaitable[None]] = _nothing
    changed: Callable[[Collection[str] | None], None] = lambda assets: None
    follow: Callable[[Collection[str] | None], Awaitable[int]] = _all_are
    apply_assets: Callable[[], Awaitable[Mapping[str, str]]] = _no_assets
    is_known: Callable[[str], bool] = lambda asset: False
    apply_file: Callable[[], None] | None = None
    registry: CollectorRegistry = field(default_factory=CollectorRegistry)

    async def apply_stored_assets(self) -> Mapping[str, str] | None:
        """Have the cell follow the assets of the store; which cannot, and why.

        None where the cell or the store does not answer now: it follows later.
        """
        try:
            return await self.apply_assets()
        except (CellUnavailableError, StoreUnavailableError):
            return None
