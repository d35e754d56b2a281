"""Watches over one asset: brings readings, twin and alarm kinds together for the alarm book."""

from collections.abc import Mapping
from types import MappingProxyType

from service.alarm_kinds import KINDS, rate_of_rise, twin_residual
from service.alarms import AlarmBook, AlarmCondition
from service.domain.alarm_guidance import AlarmName, AlarmOverride
from service.domain.alarm_kind import AlarmContext
from service.domain.channels import SPEED
from service.live.estimate import LiveEstimate
from service.live.kept import KeptWatch
from service.live.presentation import LimitCrossings
from service.live.rates import RatesOfRise
from service.live.readings import Readings
from service.live.reference import Reference
from service.live.residuals import Residuals, residual_threshold
from service.live.sources import Sources
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts
from twin_core.models import ThermalModel
from twin_core.observer import Innovation
from twin_core.windows import MEASURED_TOLERANCE

# A machine is at standstill when it has been slow for so long.
_STANDSTILL_AFTER_S = 60.0
_NOT_TRUSTED = "the model is not trusted"


class AlarmWatch:
    """Evaluates all alarm conditions of one asset and writes its events.

    Parameters
    ----------
    settings : AssetSection
        The asset's configuration.
    channels : mapping of str to ChannelFacts
        Every configured channel.
    readings : Readings
        What they say.
    estimate : LiveEstimate
        The twin.
    book : AlarmBook
        Takes the conditions.
    """

    def __init__(
        self,
        settings: AssetSection,
        channels: Mapping[str, ChannelFacts],
        readings: Readings,
        estimate: LiveEstimate,
        book: AlarmBook,
    ) -> None:
        self._settings = settings
        self._channels = channels
        self._readings = readings
        self._estimate = estimate
        self._book = book
        self._sources = Sources(channels, readings)
        self._temperatures = tuple(name for name in channels if name.startswith("t_"))
        self._inputs = settings.input_names
        alarms = settings.alarms
        rules = ((kind, alarms.rule(kind)) for kind in KINDS.values())
        self._rules = [(kind, rule) for kind, rule in rules if rule.enabled]
        self._rates_of_rise = RatesOfRise(alarms.rule(rate_of_rise.KIND).window_s)
        self._reference = Reference()
        self._residuals = Residuals(
            residual_threshold(
                alarms.rule(twin_residual.KIND).false_alarms_per_1000_h, len(self._temperatures)
            )
        )
        self._overrides: Mapping[AlarmName, AlarmOverride] = {}
        self._disabled: frozenset[AlarmName] = frozenset()
        self._version = estimate.active.version
        self._model: ThermalModel | None = None
        self._known: tuple[str, ...] = ()
        self._standing_since_us: int | None = None
        self._stepped_us: int | None = None
        self._comparable = False
        self._trusted = True
        self._withdrawn = False

    def change(self, settings: AssetSection, overrides: Mapping[AlarmName, AlarmOverride]) -> None:
        """Judge by other limits and settings of alarms; what is disabled ends with the next step.

        Parameters
        ----------
        settings : AssetSection
            The asset, with its limits.
        overrides : mapping of AlarmName to AlarmOverride
            What single alarms have otherwise than their kind says.
        """
        self._settings = settings
        self._overrides = overrides
        self._disabled = frozenset(name for name, one in overrides.items() if not one.enabled)
        self._withdrawn = False

    def step(
        self,
        now_us: int,
        means: Mapping[str, float],
        innovations: Mapping[str, Innovation],
        trusted: bool,
    ) -> None:
        """Evaluate everything but the forecast.

        Parameters
        ----------
        now_us : int
            Process time.
        means : mapping of str to float
            Means of the good samples since the last step, by channel.
        innovations : mapping of str to Innovation
            What the observer made of them.
        trusted : bool
            Whether the model can be believed.
        """
        self._tell_trust(trusted)
        self._note_standstill(now_us)
        temperatures = {name: means[name] for name in self._temperatures if name in means}
        self._rates_of_rise.add(now_us, temperatures)
        self._follow_the_model(now_us, innovations)
        self._sources.look(now_us)
        context = self._context(now_us)
        conditions = self._evaluate(context, "step")
        if not self._withdrawn:
            self._withdraw(context, {condition.key for condition in conditions})

    def forecast(self, now_us: int, crossings: LimitCrossings) -> None:
        """Evaluate what a new forecast says about the limits."""
        self._evaluate(self._context(now_us, crossings), "forecast")

    def _evaluate(self, context: AlarmContext, judged: str) -> list[AlarmCondition]:
        conditions: list[AlarmCondition] = []
        for kind, rule in self._rules:
            if kind.judged == judged:
                conditions += kind.conditions(context, rule)
        if self._disabled:
            conditions = [
                one
                for one in conditions
                if (one.kind, one.channel, one.level) not in self._disabled
            ]
        self._book.evaluate_all(conditions)
        return conditions

    def switched(self, before: int, who: str, comment: str) -> None:
        """Write into the journal that the twin runs on another model version.

        Parameters
        ----------
        before : int
            The version until now.
        who, comment : str
            For the journal.
        """
        version = self._estimate.active.version
        if version == before:
            return
        back = version < before
        self._book.record_event(
            self._settings.id,
            "model rolled back" if back else "model activated",
            f"The twin {'returned to' if back else 'runs on'} model version {version} "
            f"(was {before})",
            who,
            comment,
        )

    def grease_renewed(self) -> None:
        """Let the model alone start again from the estimate, with fresh grease."""
        self._reference.stop()

    def to_dict(self) -> KeptWatch:
        """Return what the rules have learnt, as plain JSON types."""
        return {
            "version": self._version,
            "spoken": self._sources.spoken,
            "reference": self._reference.to_dict(),
            "residuals": self._residuals.to_dict(),
        }

    def restore_sources(self, kept: KeptWatch) -> None:
        """Take up which channels had sent something, from what `to_dict` gave."""
        spoken = kept.get("spoken")
        if isinstance(spoken, list):
            self._sources.restore([str(channel) for channel in spoken])

    def restore(self, kept: KeptWatch) -> None:
        """Take up what `to_dict` gave; what was learned of a model, if it is the same version."""
        self.restore_sources(kept)
        if kept.get("version") != self._version:
            return
        reference, residuals = kept.get("reference"), kept.get("residuals")
        if isinstance(reference, Mapping):
            self._reference.restore(self._estimate.active.model, reference)
        if isinstance(residuals, Mapping):
            self._residuals.restore(residuals)

    # ------------------------------------------------------------------ what the kinds look at
    def _context(
        self,
        now_us: int,
        crossings: LimitCrossings = MappingProxyType({}),
    ) -> AlarmContext:
        since_us = self._standing_since_us
        residuals = self._residuals
        present = self._book.present(self._settings.id)
        context = AlarmContext(
            asset=self._settings.id,
            limits=self._settings.limits,
            channels=self._channels,
            readings=self._readings,
            sources=self._sources,
            now_us=now_us,
            is_present=lambda kind, channel, level: (kind, channel, level) in present,
            at_standstill=since_us is not None and now_us - since_us >= _STANDSTILL_AFTER_S * 1e6,
            inputs=self._inputs,
            distrust=None if self._trusted else _NOT_TRUSTED,
            temperatures=self._temperatures,
            residual_tests={name: chart.cusum for name, chart in residuals.charts.items()},
            residual_threshold=residuals.threshold,
            crossings=crossings,
            overrides=self._overrides,
        )
        context.rates_k_per_min = self._rates(context)
        context.differences_k = self._differences_k(context)
        return context

    def _note_standstill(self, now_us: int) -> None:
        speed_rpm = self._readings.good_value(SPEED, now_us)
        if speed_rpm is None:
            return  # what was last known holds
        if abs(speed_rpm) >= self._settings.alarms.standstill_rpm:
            self._standing_since_us = None
        elif self._standing_since_us is None or self._standing_since_us > now_us:
            self._standing_since_us = now_us

    def _follow_the_model(self, now_us: int, innovations: Mapping[str, Innovation]) -> None:
        estimate, since_us = self._estimate, self._stepped_us
        self._stepped_us = now_us
        point = estimate.point
        if not estimate.started or point is None:
            self._reference.stop()
            return
        if estimate.active.version != self._version:
            self._version = estimate.active.version
            self._residuals.begin_anew()
            self._reference.stop()
        region = self._settings.low_risk.region
        safe = bool(region.contains(point.speed_rpm, point.load_n, MEASURED_TOLERANCE))
        duration_s = 0.0 if since_us is None else max(now_us - since_us, 0) / 1e6
        # Outside the region of its data the model alone is no judge; it starts again inside.
        if safe and self._reference.started:
            self._reference.step(estimate.active, duration_s, point)
        else:
            self._reference.start(estimate.observer)
        self._comparable = safe
        if not self._identified:
            return
        self._residuals.expect(self._known_to(estimate.active.model))
        if self._standing_since_us is None:
            self._residuals.add(innovations, duration_s, safe)

    @property
    def _identified(self) -> bool:
        return self._estimate.active.identified_at_us is not None

    def _known_to(self, model: ThermalModel) -> tuple[str, ...]:
        """The measured temperatures that a model knows."""
        if model is not self._model:
            known = {*model.sensor_names, *model.node_names}
            self._model = model
            self._known = tuple(name for name in self._temperatures if name in known)
        return self._known

    def _rates(self, context: AlarmContext) -> dict[str, float | None]:
        return {
            channel: None
            if context.good_value(channel) is None
            else self._rates_of_rise.rate_k_per_min(channel)
            for channel in self._temperatures
        }

    def _differences_k(self, context: AlarmContext) -> dict[str, float | None]:
        """Measured minus the model alone, for every sensor that the model knows."""
        model = self._estimate.active.model
        differences: dict[str, float | None] = dict.fromkeys(self._known_to(model))
        if self._identified and self._comparable:
            for channel in differences:
                value = context.good_value(channel)
                expected_c = self._reference.expected_c(model, channel)
                if value is not None and expected_c is not None:
                    differences[channel] = round(value - expected_c, 3)
        return differences

    # ------------------------------------------------------------------ now and then
    def _tell_trust(self, trusted: bool) -> None:
        if trusted != self._trusted:
            self._trusted = trusted
            version = self._estimate.active.version
            if trusted:
                message = f"Model version {version} recovered"
                self._book.record_event(self._settings.id, "model trusted again", message)
            else:
                message = f"Model version {version} failed on the data of this machine"
                self._book.record_event(self._settings.id, "model not trusted", message)

    def _withdraw(self, context: AlarmContext, known: set[tuple[str, str, str, str]]) -> None:
        """End what an earlier configuration left behind, once."""
        self._withdrawn = True
        asset = self._settings.id
        for kind, _ in self._rules:
            kept = {(kind.name, channel, level) for channel, level in kind.kept(context)}
            known |= {(asset, *name) for name in kept - self._disabled}
        self._book.withdraw(asset, known)
