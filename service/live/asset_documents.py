"""The documents of one asset, made of what its twin has in memory."""

from collections.abc import Callable, Mapping

from adapters.protocol import Clock
from adapters.samples import Quality
from service.alarms import AlarmBook
from service.clock import rfc3339
from service.documents import assets as documents
from service.documents.alarms import alarm_summary
from service.documents.assets import (
    AssetDocument,
    ChannelDocument,
    Controller,
    GreaseRenewed,
    HealthOfAsset,
    IdentificationSettings,
    State,
    VerdictSettings,
)
from service.documents.fleet import FleetAsset
from service.documents.forecasts import LiveForecast
from service.documents.limits import LowRisk
from service.documents.machine import AssetFacts, PresentMachine
from service.documents.tags import Snapshot, Tag, tag
from service.documents.verdicts import VerdictDocument
from service.domain.channels import CONTROLLER_CHANNELS, unit_of
from service.live import presentation
from service.live.asset_summary import asset_summary
from service.live.estimate import LiveEstimate
from service.live.forecasting import Forecasting
from service.live.judgement import Judgement
from service.live.readings import Readings
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts

SNAPSHOT_WALL_S = 0.1
TWIN_SOURCE = "twin"


class _TagTimes:
    """Times of what changes rarely, so that an unchanged snapshot stays the same to the byte."""

    def __init__(self, began: str) -> None:
        self.began = self.switched = self.alarms_changed = self.trust_changed = began
        self.trusted = True


class AssetDocuments:
    """Shows one asset: configuration, tags, state, verdict, forecast.

    Parameters
    ----------
    settings : AssetSection
        The asset's configuration.
    channels : mapping of str to ChannelFacts
        Every configured channel.
    readings, estimate, forecasting, judgement, alarms, clock
        The parts of the live twin.
    trusted : callable
        Whether the model can be believed.

    Attributes
    ----------
    running : bool
        Whether the live twin is at work.
    """

    def __init__(
        self,
        settings: AssetSection,
        channels: Mapping[str, ChannelFacts],
        readings: Readings,
        estimate: LiveEstimate,
        forecasting: Forecasting,
        judgement: Judgement,
        alarms: AlarmBook,
        clock: Clock,
        *,
        trusted: Callable[[], bool],
    ) -> None:
        self.running = False
        self._settings = settings
        self._facts = channels
        self._readings = readings
        self._estimate = estimate
        self._forecasting = forecasting
        self._judgement = judgement
        self._alarms = alarms
        self._clock = clock
        self._trusted = trusted
        self._times = _TagTimes(rfc3339(clock.now_us()))
        self._snapshot: Snapshot = {"tags": {}}
        self._snapshot_us = 0
        self._shown: tuple[LiveForecast | None, LiveForecast | None] = None, None

    def changed(self) -> None:
        """Have the next snapshot made again."""
        self._snapshot_us = 0

    def settings_changed(self, settings: AssetSection) -> None:
        """Show other limits."""
        self._settings = settings
        self.changed()

    def model_switched(self) -> None:
        """Note that the twin runs on another model version."""
        self._times.switched = rfc3339(self._clock.now_us())
        self.changed()

    def grease_renewed(self, revolutions: float) -> GreaseRenewed:
        """Show that the grease was renewed now; ``revolutions``: what that before had seen."""
        return GreaseRenewed(
            time=rfc3339(self._clock.now_us()),
            revolutions_before=round(revolutions),
            revolutions=round(self._estimate.revolutions),
        )

    def alarms_changed(self) -> None:
        """Note that an alarm of this asset has changed."""
        self._times.alarms_changed = rfc3339(self._clock.now_us())
        self.changed()

    @property
    def channels(self) -> Mapping[str, str]:
        """Every channel with the name of its source."""
        configured = {channel: facts.source for channel, facts in self._facts.items()}
        sensors = self._estimate.active.model.sensor_names
        return configured | {f"{sensor}.twin": TWIN_SOURCE for sensor in sensors}

    @property
    def temperature_names(self) -> tuple[str, ...]:
        """Sensors and nodes of the model."""
        model = self._estimate.active.model
        return tuple(dict.fromkeys((*model.sensor_names, *model.node_names)))

    def channels_without_good_data(self) -> list[str]:
        """Configured channels whose latest sample is bad or old."""
        return self._readings.without_good_data(self._facts, self._clock.now_us())

    def summary(self) -> AssetDocument:
        """Configuration, health and active model."""
        now_us = self._clock.now_us()
        settings, active = self._settings, self._estimate.active
        bad = self.channels_without_good_data()
        identified_at_us = active.identified_at_us
        return AssetDocument(
            id=self._settings.id,
            name=settings.name or self._settings.id,
            group=settings.group or None,
            family=settings.family or None,
            bearing=settings.bearing.name if settings.bearing else None,
            network=settings.network_name,
            clock_rate=self._clock.rate,
            low_risk=LowRisk(**settings.low_risk.model_dump()),
            limits=presentation.limits_document(settings.limits),
            channels=[
                self._channel(name, source, now_us) for name, source in self.channels.items()
            ],
            alarms=alarm_summary(self._alarms.active(self._settings.id)),
            ambient_assumed_c=self._judgement.assumed_ambient_c,
            verdict=VerdictSettings(**settings.verdict.model_dump()),
            health=HealthOfAsset(
                status="degraded" if bad else "good",
                twin_running=self.running and self._estimate.started,
                channels_without_good_data=bad,
            ),
            active_model=documents.ActiveModel(
                version=active.version,
                model=active.model.name,
                trusted=self._trusted(),
                identified=active.identified,
                identified_at=rfc3339(identified_at_us) if identified_at_us else None,
            ),
            identification=IdentificationSettings(**settings.identification.model_dump()),
            controller=self._controller(now_us),
        )

    def _channel(self, name: str, source: str, now_us: int) -> ChannelDocument:
        known = name in self._facts
        return ChannelDocument(
            name=name,
            source=source,
            unit=unit_of(name),
            reason=(known and self._readings.reason(name, now_us)) or None,
            max_age_s=round(self._readings.age_limit_s(name), 1) if known else None,
        )

    def _controller(self, now_us: int) -> Controller | None:
        values = {
            name: self._readings.usable_value(name, now_us)
            for name in CONTROLLER_CHANNELS
            if name in self._facts
        }
        if not values and self._forecasting.plan is None:
            return None
        steps = self._forecasting.steps_ahead(now_us) if self._forecasting.plan else None
        return Controller(
            phase=values.get("phase"),
            speed_setpoint_rpm=values.get("speed_setpoint_rpm"),
            load_setpoint_n=values.get("load_setpoint_n"),
            plan=None if steps is None else presentation.steps_document(steps),
        )

    def snapshot(self) -> Snapshot:
        """Flat tags for a SCADA system, from memory; the same object until a tag changes."""
        now_us = self._clock.now_us()
        age_s = abs(now_us - self._snapshot_us) / 1e6
        # While no sample comes, time alone makes values stale.
        if age_s >= SNAPSHOT_WALL_S * self._clock.rate:
            tags = self._tags(now_us)
            if tags != self._snapshot["tags"]:
                self._snapshot = {"tags": tags}
            self._snapshot_us = now_us
        return self._snapshot

    def _tags(self, now_us: int) -> dict[str, Tag]:
        tags: dict[str, Tag] = {}
        times = self._times
        for channel in self._facts:
            sample = self._readings.latest.get(channel)
            tags[channel] = tag(
                self._readings.usable_value(channel, now_us),
                unit_of(channel),
                self._readings.quality(channel, now_us),
                rfc3339(sample.time_us) if sample else times.began,
            )
        blind = bool(self._judgement.blind)
        tags |= presentation.estimate_tags(self._estimate, times.began, blind)
        tags |= presentation.forecast_tags(
            self._settings.limits,
            self._forecasting.summary,
            times.began,
            blind,
            prior=not self._estimate.active.identified,
        )
        tags |= self._judgement.tags(self.verdict())
        alarms = self._alarms.active(self._settings.id)
        tags |= presentation.alarm_tags(alarms, times.alarms_changed)
        tags["model.version"] = tag(self._estimate.active.version, "", Quality.GOOD, times.switched)
        trusted = self._trusted()
        if trusted != times.trusted:
            times.trusted, times.trust_changed = trusted, rfc3339(now_us)
        tags["model.trusted"] = tag(int(trusted), "", Quality.GOOD, times.trust_changed)
        return tags

    def state(self) -> State:
        """Mean and standard deviation of the node temperatures."""
        return presentation.state_document(
            self._estimate, self._clock.now_us(), self._judgement.blind
        )

    def verdict(self) -> VerdictDocument:
        """Return whether the machine is safe now, and whether its next step is."""
        return self._judgement.document(self.running)

    def asset_summary(self) -> FleetAsset:
        """Show the asset as the fleet does."""
        active = self._estimate.active
        return asset_summary(
            self._settings,
            self._readings,
            self.verdict(),
            self._alarms.active(self._settings.id),
            version=active.version,
            trusted=self._trusted(),
            identified=active.identified,
            drifted=active.drifted,
        )

    def forecast(self) -> LiveForecast | None:
        """Return the latest live forecast, the same object until it changes; None before it."""
        latest, missing = self._forecasting.latest, self._judgement.blind
        if latest is None:
            return None
        of, shown = self._shown
        if shown is None or of is not latest or shown.missing != missing:
            shown = latest.model_copy(update={"missing": missing})
            self._shown = latest, shown
        return shown

    def description(self) -> AssetFacts:
        """What others must know of the asset before they ask anything."""
        return AssetFacts(
            running=self.running,
            channels=dict(self.channels),
            temperature_names=list(self.temperature_names),
        )

    def machine(self) -> PresentMachine:
        """The present state: what answers to callers are computed from."""
        now_us = self._clock.now_us()
        state = self._estimate.state()
        ahead = self._forecasting.steps_ahead(now_us)
        return PresentMachine(
            version=self._estimate.active.version,
            estimate=None if state is None else state.document(),
            planned=[(step.speed_rpm, step.load_n) for step in ahead],
            missing=self._judgement.blind,
            measured_c={
                name: self._readings.good_value(name, now_us)
                for name in self._estimate.active.model.sensor_names
                if name in self._facts
            },
        )
