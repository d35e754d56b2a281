"""What the cell finds out about itself: the health of sources, and what is wrong with files."""

import asyncio
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import structlog
from prometheus_client import Counter

from adapters.protocol import SourceHealth
from service.alarms import AlarmCondition
from service.cell.cell_clock import unset_s
from service.cell.core import Core
from service.cell.retention import StoreMaintenance
from service.cell.stored_assets import StoredAssets
from service.clock import is_since_set
from service.documents.messages import ServiceHealth, SourceDocument
from service.domain.causes import HISTORY_NOT_KEPT
from service.live.asset import AssetRuntime
from service.store import Alarm, Store
from service.tasks import Part

#: Samples of a channel are counted up to this number where it is only a hint.
_COUNTED_MAX: Final = 100_000
HEALTH_EVERY_WALL_S: Final = 1.0
#: A cell that was held up for longer does not know yet what is true now.
_HELD_UP_S: Final = 2.0

_log = structlog.get_logger(__name__)


@dataclass
class SelfCheck(Part):
    """Checks the cell itself, and publishes the health of its sources."""

    name = "self check"

    core: Core
    maintenance: StoreMaintenance
    stored_assets: StoredAssets

    def __post_init__(self) -> None:
        # By source: when its last good sample came, and by how much the clock was set since.
        self._moved: dict[str, tuple[int, int]] = {}
        self._clock_steps = Counter(
            "bearing_twin_clock_steps",
            "Times that the process clock was set.",
            registry=self.core.registry,
        )

    def all_problems(self) -> dict[str, str | None]:
        """What is wrong with history and with the files, by check; None where all is well."""
        spool, ingest = self.core.acquisition.spool, self.core.acquisition.ingest
        share = self.core.share
        mended = (
            f"{name} was damaged: {one.salvaged} rows salvaged, {one.lost} lost; kept as "
            f"{one.kept_as.name}"
            for name, one in (("spool", spool.mended), ("outbox", self.core.outbox.mended))
            if one is not None
        )
        files = [*([self.maintenance.damage] if self.maintenance.damage else []), *mended]
        return {
            "assets": self.stored_assets.problem or self._refused_sources(),
            **({} if share is None else {"clock": share.ownership.clock_problem}),
            "history": ingest.too_old_problem or self.maintenance.problem,
            "files": "; ".join(files) or None,
            "changes": self._refused_changes(),
            **{name: why for part in self.core.parts for name, why in part.problems().items()},
        }

    async def run(self) -> None:
        """Report on the sources once a second, until cancelled."""
        while True:
            began_s = unset_s()
            await asyncio.sleep(HEALTH_EVERY_WALL_S)
            held_up_s = unset_s() - began_s - HEALTH_EVERY_WALL_S
            self._report_too_old()
            now_us = self.core.clock.now_us()
            found = self.core.acquisition.health()
            sources = [
                SourceDocument(
                    name=health.name,
                    driver=health.driver,
                    up=health.up,
                    detail=health.detail,
                    age_s=self._age_s(health, now_us),
                )
                for health in found
            ]
            if self.core.kernels.progress:
                sources.append(
                    SourceDocument(
                        name="twin",
                        driver="kernels",
                        up=False,
                        detail=self.core.kernels.progress,
                        age_s=None,
                    )
                )
            # All that it knows of its sources is from before: they have their turn first.
            if held_up_s > _HELD_UP_S:
                sources.append(
                    SourceDocument(
                        name="cell",
                        driver="bus",
                        up=False,
                        detail=f"stood still for {held_up_s:.0f} s",
                        age_s=None,
                    )
                )
            is_well = all(source.is_well for source in found)
            degraded = not (is_well and all(source.up for source in sources))
            self.core.live.publish(
                "health",
                None,
                ServiceHealth(sources=sources, degraded=degraded, clock_rate=self.core.clock.rate),
            )

    def clock_set(self, by_us: int) -> None:
        """Count it, and note how old the last good samples are."""
        self._clock_steps.inc()
        now_us = self.core.clock.now_us()
        for health in self.core.acquisition.health():
            if health.last_good_us and not is_since_set(
                health.last_good_us, now_us, self.core.clock.rate
            ):
                before_us, moved_us = self._moved.get(health.name, (0, 0))
                moved_us = by_us + (moved_us if before_us == health.last_good_us else 0)
                self._moved[health.name] = health.last_good_us, moved_us

    def _age_s(self, health: SourceHealth, now_us: int) -> float | None:
        """Process seconds since a source's last good sample, whenever the clock was set."""
        if not health.last_good_us:
            return None
        before_us, moved_us = self._moved.get(health.name, (0, 0))
        age_us = now_us - health.last_good_us
        return (age_us - moved_us if before_us == health.last_good_us else age_us) / 1e6

    def _refused_changes(self) -> str | None:
        count = self.core.outbox.refused
        if not count:
            return None
        return f"{count} not taken since the start; 'bearing-twin db refused' lists them"

    def _refused_sources(self) -> str | None:
        refused = self.core.acquisition.refused
        return "; ".join(f"source {name}: {why}" for name, why in refused.items()) or None

    def _report_too_old(self) -> None:
        """Raise an alarm for the assets whose samples are not stored because they are too old."""
        now_us = self.core.clock.now_us()
        for asset in self.core.assets:
            problem = self.core.acquisition.ingest.too_old(asset)
            if problem is not None:
                condition = AlarmCondition(
                    asset=asset,
                    kind=HISTORY_NOT_KEPT,
                    channel="",
                    level="",
                    active=bool(problem),
                    value=None,
                    message=problem or "Samples are stored again",
                    priority=2,
                )
                self.core.shared.take(condition, now_us)


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
