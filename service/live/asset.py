"""The live runtime of one asset: readings, running estimate, forecast, warnings."""

import asyncio
import contextlib
import itertools
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from concurrent.futures import Executor

import structlog

from adapters.protocol import Clock
from adapters.samples import PlannedProfile, Quality, Sample
from service.alarms import SERVICE, AlarmBook
from service.clock import rfc3339
from service.documents.assets import (
    GreaseRenewed,
    StateMessage,
)
from service.documents.interfaces import Publisher
from service.documents.messages import NewSamples
from service.domain.alarm_guidance import AlarmName, AlarmOverride
from service.domain.channels import AMBIENT
from service.domain.errors import NotReadyError
from service.live import presentation
from service.live.asset_documents import AssetDocuments
from service.live.estimate import ActiveModel, LiveEstimate
from service.live.forecasting import Forecasting
from service.live.guard import Guard
from service.live.judgement import Judgement
from service.live.kept import KeptState, KeptWatch
from service.live.ledger import LedgerRule, issued_forecast
from service.live.readings import Readings, allowed_age_s
from service.live.watch import AlarmWatch
from service.site.asset_section import AssetSection
from service.site.machines.operating_ranges import operating_ranges, refused_beyond
from service.site.wiring import ChannelFacts
from service.store import AuditEntry
from service.store.forecast_records import IssuedForecast

STEP_S = 5.0
# With the step of the twin and the time that computing takes a forecast is never a minute old.
FORECAST_EVERY_S = 45.0
ESTIMATE_EVERY_S = 60.0
SAVE_EVERY_WALL_S = 5.0
LAST_SAVE_WALL_S = 1.0
FORECAST_LEAST_WALL_S = 1.0
SNAPSHOT_WALL_S = 0.1
STATE_LEAST_WALL_S = 0.5
VERDICT_EVERY_WALL_S = 5.0

_log = structlog.get_logger(__name__)

Store = Callable[[Sequence[Sample]], object]
SaveState = Callable[[KeptState, Sequence[AuditEntry]], Awaitable[None]]


class AssetRuntime:
    """Follows one machine: takes samples in, keeps estimate, forecast and alarms up to date.

    All methods are called in the event loop; forecasts are computed in `executor`.

    Parameters
    ----------
    settings : AssetSection
        The asset's configuration.
    channels : mapping of str to ChannelFacts
        Every configured channel.
    active : ActiveModel
        The model version to run on.
    clock, bus, alarms
        Process time, live messages, alarm book.
    executor : concurrent.futures.Executor
        Where forecasts are computed.
    store_samples : callable
        Takes the twin's own estimates for the store.
    save_state : callable
        Keeps the estimate, so that a restart goes on from it.
    keep_forecast : callable
        Takes forecasts that are to be compared with what comes.
    doubt : callable
        Why the latest sample of a channel is not good, where a check or the source can tell.

    Attributes
    ----------
    make_number : int
        Another one for each that is made in this process.
    """

    _numbers = itertools.count(1)

    def __init__(
        self,
        settings: AssetSection,
        channels: Mapping[str, ChannelFacts],
        active: ActiveModel,
        *,
        clock: Clock,
        bus: Publisher,
        alarms: AlarmBook,
        executor: Executor,
        store_samples: Store,
        save_state: SaveState,
        keep_forecast: Callable[[IssuedForecast], None] = lambda issued: None,
        doubt: Callable[[str], str] = lambda channel: "",
    ) -> None:
        self.settings = settings
        self.make_number = next(self._numbers)
        self.facts = channels
        ages_s = {
            name: allowed_age_s(facts.max_age_s, clock.rate) for name, facts in channels.items()
        }
        self.readings = Readings(
            settings.id,
            ages_s,
            clock.now_us(),
            doubt=doubt,
            learned_from_s={
                name: facts.learned_from_s
                for name, facts in channels.items()
                if facts.learned_from_s is not None
            },
            rate=clock.rate,
        )
        self.estimate = LiveEstimate(active, refused_beyond(operating_ranges(settings.bearing)))
        self._clock = clock
        self._bus = bus
        self._alarms = alarms
        self._store_samples = store_samples
        self._save_state = save_state
        self._keep_forecast = keep_forecast
        self._ledger_rule = LedgerRule()
        self._keeping = asyncio.Lock()
        self._audit: list[AuditEntry] = []
        self._forecasting = Forecasting(settings, self.estimate, self.readings, clock, executor)
        self._watch = AlarmWatch(settings, channels, self.readings, self.estimate, alarms)
        self._judgement = Judgement(
            settings, self.readings, self.estimate, self._forecasting, alarms, clock
        )
        self._blind: list[str] = []
        self._forecast_wanted = asyncio.Event()
        self._forecast_due = True
        self._unsent: dict[str, Sample] = {}
        self._verdict_due = True
        self._verdict_holds_us = -math.inf
        self._told_verdict: object = None
        self._told_wall_s = -math.inf
        self._told_state_wall_s = -math.inf
        self._stored_us = 0
        self._had_started = False
        self._estimating = Guard("estimate", settings.id)
        self._guarding_forecasts = Guard("forecast", settings.id)
        self._watching = Guard("watch", settings.id)
        self._noting = Guard("forecast_ledger", settings.id)
        self._saving = Guard("saving_the_estimate", settings.id)
        self.documents = AssetDocuments(
            settings,
            channels,
            self.readings,
            self.estimate,
            self._forecasting,
            self._judgement,
            alarms,
            clock,
            trusted=lambda: self._trusted,
        )

    # ------------------------------------------------------------------ what others ask
    @property
    def id(self) -> str:
        """The asset's id in the configuration."""
        return self.settings.id

    @property
    def active(self) -> ActiveModel:
        """The model version that the twin runs on."""
        return self.estimate.active

    @property
    def _trusted(self) -> bool:
        """A model whose estimate or forecast fails on this machine says nothing about it."""
        return not (self._estimating.failing or self._guarding_forecasts.failing)

    def look(self) -> None:
        """Take note that somebody looks at the forecast: it is an ensemble of now soon."""
        if self._forecasting.look():
            self._forecast_wanted.set()

    def forecast_age_s(self) -> float:
        """Process seconds since the state that the live forecast starts from; NaN before it."""
        return self._forecasting.age_s(self._clock.now_us())

    # ------------------------------------------------------------------ what comes in
    def take(self, samples: Sequence[Sample], plans: Sequence[PlannedProfile]) -> None:
        """Take in a batch from the drivers or from a gateway."""
        news = self.readings.add(samples)
        if self._bus.is_followed(self.id):
            self._unsent |= {sample.channel: sample for sample in news}
        self._verdict_due |= self._judgement.is_news(news)
        self.documents.changed()
        for plan in plans:
            if plan.asset == self.id and self._forecasting.take_plan(plan):
                self._forecast_wanted.set()

    def switch(self, active: ActiveModel, who: str = SERVICE, comment: str = "") -> None:
        """Go on with another model version, without a gap; the journal says who wanted it."""
        before = self.active.version
        self.estimate.swap(active)
        self._watch.switched(before, who, comment)
        self._verdict_due = True
        self.documents.model_switched()
        self._forecast_wanted.set()
        _log.info("model_switched", asset=self.id, version=active.version)

    async def renew_grease(
        self, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        """Take note that the grease was renewed, and keep it for the next start."""
        if not self.estimate.started:
            raise NotReadyError("the twin waits for the first good temperatures, speed and load")
        before = self.estimate.renew_grease()
        self._watch.grease_renewed()
        now_us = self._clock.now_us()
        self._alarms.record_event(
            self.id,
            "grease renewed",
            f"Grease renewed after {before:.0f} revolutions",
            who,
            comment,
        )
        if audit is not None:
            self._audit.append(audit)
        self._forecast_wanted.set()
        await self._keep_state()
        return GreaseRenewed(
            time=rfc3339(now_us),
            revolutions_before=round(before),
            revolutions=round(self.estimate.revolutions),
        )

    def change_alarms(
        self, settings: AssetSection, overrides: Mapping[AlarmName, AlarmOverride]
    ) -> None:
        """Judge by other limits and alarm settings from the next sample on.

        Alarms keep their ids and states. A forecast that tells of the limits before is gone, and
        the next one is made at once.
        """
        limits_changed = settings.limits != self.settings.limits
        self.settings = settings
        self._watch.change(settings, overrides)
        self._judgement.change(settings)
        self.documents.settings_changed(settings)
        self._verdict_due = True
        if limits_changed:
            self._forecasting.change_limits(settings.limits)
            self._forecast_wanted.set()

    def drift_reported(self, text: str) -> None:
        """Write into the journal that the machine has changed."""
        self._alarms.record_event(self.id, "model drift", text)

    def alarms_changed(self) -> None:
        """Note that an alarm of this asset has changed."""
        self._verdict_due = True
        self.documents.alarms_changed()

    # ------------------------------------------------------------------ the running twin
    async def run(self, kept_state: KeptState | None) -> None:
        """Make forecasts and keep the state until cancelled; `service.live.twins` steps it."""
        if AMBIENT not in self.facts:
            _log.warning(
                "ambient_assumed",
                asset=self.id,
                taken="the coldest reading so far",
                expected=f"a channel {AMBIENT}",
            )
        if kept_state is not None:
            self._restore(kept_state)
        self.documents.running = True
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._forecast_live())
                tasks.create_task(self._keep())
        finally:
            self.documents.running = False
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LAST_SAVE_WALL_S):
                    await self._save()

    def _restore(self, kept_state: KeptState) -> None:
        watched: KeptWatch = kept_state.get("watch") or {}
        self._watch.restore_sources(watched)
        if ledger := kept_state.get("ledger"):
            self._ledger_rule.restore(ledger)
        try:
            self.estimate.restore(kept_state)
            self.documents.changed()
            self._watch.restore(watched)
        except ValueError as error:
            _log.warning("estimate_not_restored", asset=self.id, reason=str(error))

    def stepped(self, now_us: int, means: Mapping[str, float], failure: Exception | None) -> None:
        """Judge the alarms after a step of the estimate, and send and store what is due.

        Parameters
        ----------
        now_us : int
            Process time to which the estimate was advanced.
        means : mapping of str to float
            Mean readings that it was given.
        failure : Exception or None
            What it failed of.
        """
        self._note_step(failure)
        with self._watching():
            self._watch.step(now_us, means, self.estimate.innovations, self._trusted)
        if not self.estimate.started:
            return
        quality = Quality.LAST_USABLE if self._blind else Quality.GOOD
        wall_s = asyncio.get_running_loop().time()
        followed = self._bus.is_followed(self.id)
        if followed and wall_s - self._told_state_wall_s >= STATE_LEAST_WALL_S:
            # With the sensors' estimates, so that a chart needs no polling.
            samples = presentation.samples_document(self.estimate.samples(self.id, now_us, quality))
            message = StateMessage(**dict(self.documents.state()), samples=samples)
            self._bus.publish("state", self.id, message)
            self._told_state_wall_s = wall_s
        if now_us - self._stored_us >= ESTIMATE_EVERY_S * 1e6:
            self._store_samples(self.estimate.samples(self.id, now_us, quality))
            self._stored_us = now_us

    def _note_step(self, failure: Exception | None) -> None:
        had_started = self._had_started
        with self._estimating():
            if failure is not None:
                raise failure
        if self._estimating.failing:
            self.estimate.stop()
        blind = self._judgement.blind
        # The first forecast of a run does not wait for its period, whether the estimate begins or
        # goes on from the last run.
        begins = self.estimate.started and (self._forecast_due or not had_started)
        self._verdict_due |= blind != self._blind or had_started != self.estimate.started
        if begins or blind != self._blind:
            self._forecast_due &= not begins
            self._forecast_wanted.set()
        self._blind = blind
        self._had_started = self.estimate.started
        self.documents.changed()

    async def _keep(self) -> None:
        """Keep the estimate from time to time, however long the store takes for it."""
        while True:
            await asyncio.sleep(SAVE_EVERY_WALL_S)
            await self._save()

    async def _forecast_live(self) -> None:
        period_wall_s = max(FORECAST_EVERY_S / self._clock.rate, FORECAST_LEAST_WALL_S)
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(period_wall_s):
                    await self._forecast_wanted.wait()
            self._forecast_wanted.clear()
            if self.estimate.started:
                with self._guarding_forecasts():
                    await self._forecast_once()
            await asyncio.sleep(FORECAST_LEAST_WALL_S)

    async def _forecast_once(self) -> None:
        made = await self._forecasting.make(self._judgement.blind)
        if made:
            self._verdict_due = True
            self.documents.changed()
            latest = self._forecasting.latest if self._bus.is_followed(self.id) else None
            if latest is not None:
                self._bus.publish("forecast", self.id, latest)
            with self._noting():
                self._note_forecast()
            summary = self._forecasting.summary
            self._watch.forecast(self._clock.now_us(), summary.crossings if summary else {})

    def _note_forecast(self) -> None:
        """Keep the latest forecast where it is one that is compared with what comes."""
        issue = self._forecasting.issue
        reason = None if issue is None else self._ledger_rule.reason(issue)
        if issue is None or reason is None:
            return
        sensors, at_us = issue.result.sensors, self._clock.now_us()
        readings_c = {
            name: self.readings.good_value(name, at_us) for name in sensors if name in self.facts
        }
        region = self.settings.low_risk.region
        issued = issued_forecast(self.id, issue, reason, region, self.facts, readings_c)
        if issued is not None:
            self._keep_forecast(issued)

    def tell(self, now_us: int) -> None:
        """Send what is new to those who follow: the latest samples, and the verdict.

        The verdict is sent when it changes, and now and then so that its age can be seen. It is
        made again only when something that it depends on has changed: on a site with hundreds of
        machines hardly anything has.
        """
        if self._unsent:
            samples = presentation.samples_document(self._unsent.values())
            self._unsent = {}
            self._bus.publish("measurement", self.id, NewSamples(samples=samples))
        wall_s = asyncio.get_running_loop().time()
        old = wall_s - self._told_wall_s >= VERDICT_EVERY_WALL_S and self._bus.is_followed(self.id)
        if not (self._verdict_due or old or now_us >= self._verdict_holds_us):
            return
        self._verdict_due = False
        # Also where nobody follows: the tags show since when its words hold.
        verdict = self.documents.verdict()
        self._verdict_holds_us = self._judgement.holds_until_us(now_us)
        words = [(one.word, one.limit) for one in (verdict.now, verdict.next_step)]
        news = words, verdict.missing
        if old or news != self._told_verdict:
            self._told_verdict = news
            if self._bus.is_followed(self.id):
                self._bus.publish("verdict", self.id, verdict)
                self._told_wall_s = wall_s

    async def _save(self) -> None:
        if self.estimate.started:
            with self._saving():
                await self._keep_state()

    async def _keep_state(self) -> None:
        """Save the state, with the lines of the audit trail about what people changed in it.

        A store that is away takes them with the first state that it takes again. Once begun it
        ends, whoever waits: a line that is on its way must not be sent again.
        """
        keeping = asyncio.ensure_future(self._keep_next())
        # No one may be there any more to hear that it failed.
        keeping.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.shield(keeping)

    async def _keep_next(self) -> None:
        async with self._keeping:
            lines = tuple(self._audit)
            await self._save_state(self._kept(), lines)
            del self._audit[: len(lines)]

    async def take_over(self, before: "AssetRuntime") -> KeptState | None:
        """Take what the twin before could not bring into the store; gives what to go on from.

        Parameters
        ----------
        before
            A twin of the same machine that does not run any more.
        """
        async with before._keeping:
            self._audit += before._audit
            before._audit = []
        return before._kept() if before.estimate.started else None

    def _kept(self) -> KeptState:
        return {
            **(self.estimate.to_dict() or {}),
            "watch": self._watch.to_dict(),
            "ledger": self._ledger_rule.to_dict(),
        }
