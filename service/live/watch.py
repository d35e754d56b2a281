"""Watches over one asset: brings readings, twin and alarm kinds together for the alarm book."""

from collections.abc import Mapping
from types import MappingProxyType

from service.alarm_kinds import KINDS, measured_limit, rate_of_rise, twin_residual
from service.alarms import AlarmBook, AlarmCondition, SharedCauses
from service.domain.alarm_guidance import AlarmName, AlarmOverride
from service.domain.alarm_kind import LEVELS, AlarmContext, ForecastRecord, no_record
from service.domain.channels import SPEED
from service.live.estimate import LiveEstimate
from service.live.kept import KeptWatch
from service.live.model_comparison import ModelComparison
from service.live.presentation import LimitCrossings
from service.live.rates import RatesOfRise
from service.live.readings import Readings
from service.live.reference import Reference
from service.live.residuals import Residuals, residual_threshold
from service.live.sources import Sources
from service.site.asset_section import AssetSection
from service.site.wiring import ChannelFacts

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
    shared : SharedCauses, optional
        Takes those of causes that the asset shares with others; who gives it evaluates it. Without
        it the asset is alone.
    """

    def __init__(
        self,
        settings: AssetSection,
        channels: Mapping[str, ChannelFacts],
        readings: Readings,
        estimate: LiveEstimate,
        book: AlarmBook,
        shared: SharedCauses | None = None,
    ) -> None:
        self._settings = settings
        self._channels = channels
        self._readings = readings
        self._estimate = estimate
        self._book = book
        self._alone = SharedCauses(book) if shared is None else None
        self._shared = shared or self._alone or SharedCauses(book)
        self._sources = Sources(channels, readings)
        temperatures = tuple(name for name in channels if name.startswith("t_"))
        alarms = settings.alarms
        rules = ((kind, alarms.rule(kind)) for kind in KINDS.values())
        self._rules = [(kind, rule) for kind, rule in rules if rule.enabled]
        self._rates_of_rise = RatesOfRise(alarms.rule(rate_of_rise.KIND).window_s)
        false_alarms = alarms.rule(twin_residual.KIND).false_alarms_per_1000_h
        threshold = residual_threshold(false_alarms, len(temperatures))
        self._comparison = ModelComparison(estimate, temperatures, Residuals(threshold))
        self._overrides: Mapping[AlarmName, AlarmOverride] = {}
        self._standing_since_us: int | None = None
        self._trusted = True
        self._looked = False
        self._withdrawn = False

    def look(self, now_us: int) -> None:
        """Judge what was measured since the last step, where there was one."""
        if self._looked:
            context = self._context(now_us)
            context.between = self._readings.take_between(now_us)
            self._evaluate(context, "step")

    def change(self, settings: AssetSection, overrides: Mapping[AlarmName, AlarmOverride]) -> None:
        """Judge by other limits and settings of alarms; what is disabled ends with the next step.

        What was measured until now is judged by those of before, see `look`.

        Parameters
        ----------
        settings : AssetSection
            The asset, with its limits.
        overrides : mapping of AlarmName to AlarmOverride
            What single alarms have otherwise than their kind says.
        """
        before, limits = self._overrides, self._settings.limits
        changed = {
            name for name in {*before, *overrides} if before.get(name) != overrides.get(name)
        }
        changed |= {
            (measured_limit.KIND.name, channel, level)
            for channel in {*limits, *settings.limits}
            if limits.get(channel) != settings.limits.get(channel)
            for level in LEVELS
        }
        self._book.drop_delays(settings.id, changed)
        self._settings = settings
        self._overrides = overrides
        self._withdrawn = False

    def step(self, now_us: int, means: Mapping[str, float], trusted: bool) -> None:
        """Evaluate everything but the forecast; `follow` comes before.

        Parameters
        ----------
        now_us : int
            Process time.
        means : mapping of str to float
            Means of the good samples since the last step, by channel.
        trusted : bool
            Whether the model can be believed.
        """
        self._report_trust(trusted)
        self._note_standstill(now_us)
        temperatures = {
            name: means[name] for name in self._comparison.temperatures if name in means
        }
        self._rates_of_rise.add(now_us, temperatures)
        self._comparison.step(turns=self._standing_since_us is None)
        self._sources.look(now_us)
        context = self._context(now_us)
        context.between = self._readings.take_between(now_us)
        if not self._looked:
            self._book.pause_delays(self._settings.id)
        self._looked = True
        conditions = self._evaluate(context, "step")
        if not self._withdrawn:
            self._withdraw(context, {condition.key for condition in conditions})
        if self._alone is not None:
            self._alone.evaluate()

    def forecast(
        self, now_us: int, crossings: LimitCrossings, record: ForecastRecord = no_record
    ) -> None:
        """Evaluate what a new forecast says about the limits.

        ``record``: how such forecasts have done.
        """
        context = self._context(now_us, crossings)
        context.record = record
        self._evaluate(context, "forecast")

    def _evaluate(self, context: AlarmContext, judged: str) -> list[AlarmCondition]:
        conditions: list[AlarmCondition] = []
        for kind, rule in self._rules:
            if kind.judged == judged:
                conditions += kind.conditions(context, rule)
        if disabled := self._disabled():
            conditions = [
                one for one in conditions if (one.kind, one.channel, one.level) not in disabled
            ]
        own = []
        for condition in conditions:
            if condition.key[0]:
                own.append(condition)
            else:
                self._shared.take(condition, context.now_us)
        self._book.evaluate_all(own)
        return conditions

    def clock_set(self, by_us: int) -> None:
        """Go on as before: the clock was set by so much."""
        if self._standing_since_us is not None:
            self._standing_since_us += by_us
        self._rates_of_rise.clock_set(by_us)
        self._comparison.clock_set(by_us)
        self._sources.clock_set(by_us)
        if self._alone is not None:
            self._alone.clock_set(by_us)

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

    def grease_renewed(self, revolutions: float, who: str, comment: str) -> None:
        """Let the model alone start again from the estimate, with fresh grease; journal it.

        ``revolutions``: how many the grease before had seen.
        """
        self._comparison.stop()
        self._book.record_event(
            self._settings.id,
            "grease renewed",
            f"Grease renewed after {revolutions:.0f} revolutions",
            who,
            comment,
        )

    def drift_reported(self, text: str) -> None:
        """Write into the journal that the machine has changed."""
        self._book.record_event(self._settings.id, "model drift", text)

    @property
    def spoken(self) -> list[str]:
        """Channels that have ever sent something."""
        return self._sources.spoken

    def to_dict(self) -> KeptWatch:
        """Return what the rules have learnt, as plain JSON types."""
        return {**self._comparison.to_dict(), "spoken": self.spoken}

    def restore_sources(self, kept: KeptWatch) -> None:
        """Take up which channels had sent something, from what `to_dict` gave."""
        spoken = kept.get("spoken")
        if isinstance(spoken, list):
            self._sources.restore([str(channel) for channel in spoken])

    def restore(self, kept: KeptWatch) -> None:
        """Take up what `to_dict` gave; what was learned of a model, if it is the same version."""
        self.restore_sources(kept)
        self._comparison.restore(kept)

    # ------------------------------------------------------------------ what the kinds look at
    def _context(
        self,
        now_us: int,
        crossings: LimitCrossings = MappingProxyType({}),
    ) -> AlarmContext:
        since_us = self._standing_since_us
        residuals = self._comparison.residuals
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
            inputs=self._settings.input_names,
            distrust=None if self._trusted else _NOT_TRUSTED,
            temperatures=self._comparison.temperatures,
            residual_tests={name: chart.cusum for name, chart in residuals.charts.items()},
            residual_threshold=residuals.threshold,
            crossings=crossings,
            identified=self._estimate.active.identified,
            overrides=self._overrides,
        )
        context.rates_k_per_min = self._rates(context)
        context.differences_k = self._comparison.differences_k(context.good_value)
        return context

    def _note_standstill(self, now_us: int) -> None:
        speed_rpm = self._readings.good_value(SPEED, now_us)
        if speed_rpm is None:
            return  # what was last known holds
        if abs(speed_rpm) >= self._settings.alarms.standstill_rpm:
            self._standing_since_us = None
        elif self._standing_since_us is None or self._standing_since_us > now_us:
            self._standing_since_us = now_us

    def follow(self, now_us: int) -> Reference | None:
        """See `ModelComparison.follow`."""
        return self._comparison.follow(now_us, self._settings.low_risk.region)

    def _rates(self, context: AlarmContext) -> dict[str, float | None]:
        return {
            channel: None
            if context.good_value(channel) is None
            else self._rates_of_rise.rate_k_per_min(channel)
            for channel in self._comparison.temperatures
        }

    def _disabled(self) -> frozenset[AlarmName]:
        return frozenset(name for name, one in self._overrides.items() if not one.enabled)

    # ------------------------------------------------------------------ now and then
    def _report_trust(self, trusted: bool) -> None:
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
        self._shared.settle(asset, known)
        disabled = self._disabled()
        for kind, _ in self._rules:
            kept = {(kind.name, channel, level) for channel, level in kind.kept(context)}
            known |= {(asset, *name) for name in kept - disabled}
        self._book.withdraw(asset, known)
