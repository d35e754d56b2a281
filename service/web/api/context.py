"""What the web side needs from the rest of the service."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from prometheus_client import CollectorRegistry

from adapters.protocol import Clock, SourceHealth
from service.bus.stream import Bus
from service.domain.interfaces import AssetTwin, JobManager
from service.site.settings import Settings

if TYPE_CHECKING:
    from service.alarms import AlarmBook
    from service.ingest import Ingest
    from service.store import Outbox, Store


@dataclass(frozen=True, slots=True)
class ServiceContext:
    """Everything the web side leans on, put together by the service."""

    settings: Settings
    clock: Clock
    store: "Store"
    outbox: "Outbox"
    bus: Bus
    ingest: "Ingest"
    alarms: "AlarmBook"
    assets: Mapping[str, AssetTwin]
    jobs: JobManager
    registry: CollectorRegistry
    sources: Callable[[], Sequence[SourceHealth]]
    problems: Callable[[], Mapping[str, str | None]] = dict
