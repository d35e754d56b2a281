"""What the cell says of itself by itself: the health of sources, and what is wrong with files."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import structlog
from prometheus_client import CollectorRegistry, Counter

from service.alarms import AlarmBook, AlarmCondition
from service.bus.stream import Bus
from service.cell.acquisition import Acquisition
from service.cell.provisioning import Provisioning
from service.cell.retention import StoreMaintenance
from service.cell.share import Share
from service.clock import ClockWatch, ProcessClock
from service.documents.messages import ServiceHealth, SourceDocument
from service.live.asset import AssetRuntime
from service.notifications.notifier import Notifier
from service.store import Alarm, Outbox, Store

#: Samples of a channel are counted up to this number where it is only a hint.
_COUNTED_MAX: Final = 100_000
HEALTH_EVERY_WALL_S: Final = 1.0

_log = structlog.get_logger(__name__)


@dataclass
class Reports:
    """Reports what the parts of a cell say of themselves."""

    clock: ProcessClock
    bus: Bus
    alarms: AlarmBook
    assets: Mapping[str, AssetRuntime]
    outbox: Outbox
    acquisition: Acquisition
    maintenance: StoreMaintenance
    provisioning: Provisioning
    notifier: Notifier
    share: Share | None
    registry: CollectorRegistry

    def __post_init__(self) -> None:
        self._clock_steps = Counter(
            "bearing_twin_clock_steps",
            "Times that the process clock was set.",
            registry=self.registry,
        )

    def problems(self) -> dict[str, str | None]:
        """What is wrong with history and with the files, by check; None where all is well."""
        spool, ingest = self.acquisition.spool, self.acquisition.ingest
        mended = (
            f"{name} was damaged: {one.salvaged} rows salvaged, {one.lost} lost; kept as "
            f"{one.kept_as.name}"
            for name, one in (("spool", spool.mended), ("outbox", self.outbox.mended))
            if one is not None
        )
        files = [*([self.maintenance.damage] if self.maintenance.damage else []), *mended]
        return {
            "assets": self.provisioning.problem or self._refused_sources(),
            **({} if self.share is None else {"clock": self.share.ownership.clock_problem}),
            "history": ingest.too_old_problem or self.maintenance.problem,
            "files": "; ".join(files) or None,
            "notifications": self.notifier.problem(),
        }

    async def tell(self) -> None:
        """Tell of the sources once a second, until cancelled."""
        watch = ClockWatch(self.clock)
        while True:
            await asyncio.sleep(HEALTH_EVERY_WALL_S)
            step_s = watch.step_s()
            if step_s:
                self._clock_steps.inc()
                _log.warning("clock_set", by_s=round(step_s, 3))
            self._report_too_old()
            now_us = self.clock.now_us()
            sources = [
                SourceDocument(
                    name=health.name,
                    driver=health.driver,
                    up=health.up,
                    detail=health.detail,
                    age_s=(now_us - health.last_good_us) / 1e6 if health.last_good_us else None,
                )
                for health in self.acquisition.health()
            ]
            degraded = not all(source.up for source in sources)
            self.bus.publish(
                "health",
                None,
                ServiceHealth(sources=sources, degraded=degraded, clock_rate=self.clock.rate),
            )

    def _refused_sources(self) -> str | None:
        refused = self.acquisition.refused
        return "; ".join(f"source {name}: {why}" for name, why in refused.items()) or None

    def _report_too_old(self) -> None:
        """Raise an alarm for the assets whose samples are not stored because they are too old."""
        for asset in self.assets:
            problem = self.acquisition.ingest.too_old(asset)
            if problem is not None:
                self.alarms.evaluate(
                    AlarmCondition(
                        asset=asset,
                        kind="history not kept",
                        channel="",
                        level="",
                        active=bool(problem),
                        value=None,
                        message=problem or "Samples are stored again",
                        priority=2,
                    )
                )


def report_unconfigured(
    store: Store, assets: Mapping[str, AssetRuntime], alarms: Sequence[Alarm]
) -> None:
    """Warn once of what the store holds and the configuration names no more."""
    samples: dict[str, int] = {}
    for (asset, channel), count in store.samples.counts(_COUNTED_MAX).items():
        if asset not in assets or channel not in _channels(assets[asset]):
            name = f"{asset}/{channel}" if asset in assets else asset
            samples[name] = samples.get(name, 0) + count
    if samples or alarms:
        _log.warning(
            "not_configured",
            samples=samples,
            alarms_withdrawn=len(alarms),
            hint="'bearing-twin export --asset NAME' exports its stored data",
        )


def _channels(asset: AssetRuntime) -> Collection[str]:
    return asset.documents.channels
