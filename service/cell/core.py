"""What the parts of a cell are made of."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry

from service.alarms import AlarmBook, SharedCauses
from service.alarms.records import key_of
from service.alarms.silencing import Silencing
from service.bus.following import packed
from service.bus.interface import STREAM_TOPIC, CellBus
from service.bus.stream import LiveMessages
from service.bus.subscription import Message
from service.cell.acquisition import Acquisition
from service.cell.cell_clock import CellClock
from service.cell.kernels import Kernels
from service.cell.share import Share
from service.documents.alarms import alarm_document
from service.ingest.metrics import watch_damage, watch_forecasts, watch_late, watch_outbox
from service.jobs.history import AssetHistory
from service.jobs.manager import IdentificationJobs
from service.live.asset import AssetRuntime
from service.site.settings import Settings
from service.store import Alarm, Outbox, Store
from service.tasks import Part


@dataclass
class Core:
    """What the parts of a cell are made of; a feature's ``part(core)`` gets it too.

    Attributes
    ----------
    kernels
        The compiled kernels; estimates and forecasts begin when they are there.
    share
        Which assets this cell follows, where several cells share them; None: all.
    live
        Live messages.
    shared
        Alarms of causes that assets share.
    silencing
        Of which assets the alarms are not to be sent.
    assets, histories
        Those that are followed, by id.
    parts
        All parts, in the order in which they start.
    loaded_by_us
        By how much the clock was set since the last run: times that are loaded of it are moved by
        so much. None where that is not known; they go by the calendar then.
    jobs
        Identifications; made after this, since they need it.
    """

    settings: Settings
    store: Store
    outbox: Outbox
    clock: CellClock
    acquisition: Acquisition
    bus: CellBus
    kernels: Kernels
    share: Share | None
    registry: CollectorRegistry = field(default_factory=CollectorRegistry)
    assets: dict[str, AssetRuntime] = field(default_factory=dict)
    histories: dict[str, AssetHistory] = field(default_factory=dict)
    parts: list[Part] = field(default_factory=list)
    silencing: Silencing = field(default_factory=Silencing)
    loaded_by_us: int | None = field(init=False)
    jobs: IdentificationJobs = field(init=False)
    live: LiveMessages = field(init=False)
    alarms: AlarmBook = field(init=False)
    shared: SharedCauses = field(init=False)

    def __post_init__(self) -> None:
        # What other cells leave was dated by their clocks.
        by_us = self.clock.since_last_run_us()
        self.loaded_by_us = by_us if self.share is None else None
        self.live = LiveMessages(self.clock, self.bus.epoch, on_message=self._hand_on)
        self.alarms = AlarmBook(
            self.outbox,
            self.clock,
            self._alarm_changed,
            begins_empty=self.share is not None,
            loaded_by_us=self.loaded_by_us,
        )
        self.shared = SharedCauses(self.alarms)
        registry, spool = self.registry, self.acquisition.spool
        registry.register(self.acquisition.registry)
        watch_outbox(lambda: self.outbox.waiting, registry)
        watch_damage(
            {"spool": lambda: spool.mended, "outbox": lambda: self.outbox.mended},
            lambda: self.outbox.lost,
            registry,
        )
        watch_late(lambda: {one.id: one.readings.late for one in self._followed()}, registry)
        watch_forecasts(
            lambda: {one.id: one.forecast_age_s() for one in self._followed()}, registry
        )

    @property
    def run_name(self) -> str:
        """Names this run of a cell, where there are several cells; else empty."""
        return "" if self.share is None else self.share.ownership.cell

    def is_maintenance_leader(self) -> bool:
        """Whether this cell does what is done once for the whole store."""
        return self.share is None or self.share.is_maintenance_leader

    def names_of(self, asset: str) -> tuple[str, str]:
        """Name and family of an asset, also of one that was removed a moment ago."""
        runtime = self.assets.get(asset)
        return (runtime.settings.name or asset, runtime.settings.family) if runtime else (asset, "")

    def _followed(self) -> Sequence[AssetRuntime]:
        return list(self.assets.values())

    def _hand_on(self, message: Message) -> None:
        self.bus.publish(STREAM_TOPIC, message.seq, packed(message))

    def _alarm_changed(self, alarm: Alarm) -> None:
        # Also those that have a source which was lost, and are not in its alarm any more.
        about = self.shared.assets_of(alarm, key_of(alarm))
        for asset in about:
            if asset in self.assets:
                self.assets[asset].alarms_changed()
        # An alarm of several assets is one of the service: every client gets it.
        self.live.publish("alarm", None if len(about) > 1 else alarm.asset, alarm_document(alarm))
        for part in self.parts:
            part.alarm_changed(alarm)
