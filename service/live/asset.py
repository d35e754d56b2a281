"""The live runtime of one asset: readings, running estimate, forecast, warnings."""

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import cast

import structlog

from adapters.protocol import Clock
from adapters.samples import PlannedProfile, Sample
from service.alarms import SERVICE, AlarmBook, SharedCauses
from service.documents.assets import GreaseRenewed
from service.documents.interfaces import LivePublisher
from service.domain.alarm_guidance import AlarmName, AlarmOverride
from service.domain.channels import AMBIENT
from service.domain.errors import NotReadyError
from service.live.asset_documents import AssetDocuments
from service.live.estimate import LiveEstimate, RunningModel
from service.live.forecast_loop import ForecastLoop
from service.live.forecasting import Forecasting
from service.live.guard import Guard
from service.live.issues import ForecastFollower
from service.live.judgement import Judgement
from service.live.kept import KeptState, KeptWatch
from service.live.publishing import Publishing, Store
from service.live.readings import Readings, allowed_age_s
from service.live.reference import Reference
from service.live.saving import SaveState, Saving, move_kept
from service.live.watch import AlarmWatch
from service.site.asset_section import AssetSection
from service.site.machines.operating_ranges import operating_ranges, refused_beyond
from service.site.wiring import ChannelFacts
from service.store import AuditEntry

STEP_S = 5.0
LAST_SAVE_WALL_S = 1.0

_log = structlog.get_logger(__name__)


class AssetRuntime:
    """Follows one machine: takes samples in, keeps estimate, forecast and alarms up to date.

    All methods are called in the event loop; forecasts are computed in `executor`.

    Parameters
    ----------
    settings : AssetSection
        The asset's configuration.
    channels : mapping of str to ChannelFacts
        Every configured channel.
    active : RunningModel
        The model version to run on.
    clock, bus, alarms
        Process time, live messages, alarm book.
    executor : concurrent.futures.Executor
        Where forecasts are computed.
    store_samples : callable
        Takes the twin's own estimates for the store.
    save_state : callable
        Keeps the estimate, so that a restart goes on from it, see `service.live.saving`.
    doubt : callable
        Why the latest sample of a channel is not good, where a check or the source says so.
    ahead_s : callable
        Seconds by which the clock behind a channel's latest sample is ahead; None: it is not.
    shared : SharedCauses, optional
        Puts the alarms of causes together that assets share.

    Attributes
    ----------
    make_number : int
        Another one for each that is made in this process.
    estimates : bool
        Whether there is what estimates are computed with. Until then only alarms are judged.
    """

    _numbers = itertools.count(1)

    def __init__(
        self,
        settings: AssetSection,
        channels: Mapping[str, ChannelFacts],
        active: RunningModel,
        *,
        clock: Clock,
        bus: LivePublisher,
        alarms: AlarmBook,
        executor: Executor,
        store_samples: Store,
        save_state: SaveState,
        doubt: Callable[[str], str] = lambda channel: "",
        ahead_s: Callable[[str], float | None] = lambda channel: None,
        shared: SharedCauses | None = None,
    ) -> None:
        self.settings = settings
        self.make_number = next(self._numbers)
        self.facts = channels
        self._clock = clock
        self.readings = _readings(settings, channels, clock, doubt, ahead_s)
        self.estimate = LiveEstimate(active, refused_beyond(operating_ranges(settings.bearing)))
        forecasting = Forecasting(settings, self.estimate, self.readings, clock, executor)
        self._watch = AlarmWatch(settings, channels, self.readings, self.estimate, alarms, shared)
        self._judgement = Judgement(
            settings, self.readings, self.estimate, forecasting, alarms, clock
        )
        self._forecasts = ForecastLoop(settings.id, forecasting, self._judgement, clock)
        self._estimating = Guard("estimate", settings.id)
        self._watching = Guard("watch", settings.id)
        self.documents = AssetDocuments(
            settings,
            channels,
            self.readings,
            self.estimate,
            forecasting,
            self._judgement,
            alarms,
            clock,
            trusted=partial(_is_trusted, self._estimating, self._forecasts),
        )
        self._publishing = Publishing(
            settings.id, bus, self.documents, self._judgement, store_samples
        )
        parts = self.estimate, self._watch, self._judgement, self._forecasts
        self.saving = Saving(settings.id, save_state, self.estimate, partial(_kept, *parts))
        self.estimates = False
        # The state to go on from, until there is what estimates are computed with.
        self._waits: KeptState | None = None
        self._blind: list[str] = []
        self._had_started = False

    # ------------------------------------------------------------------ what others ask
    @property
    def id(self) -> str:
        """The asset's id in the configuration."""
        return self.settings.id

    @property
    def active(self) -> RunningModel:
        """The model version that the twin runs on."""
        return self.estimate.active

    def follow_forecasts(self, follower: ForecastFollower) -> None:
        """Have each live forecast noted, and what the follower knows kept with the state."""
        self._forecasts.follow(follower)

    def look(self) -> None:
        """Record that somebody looks at the forecast: it is an ensemble of now soon."""
        if self._forecasts.forecasting.look():
            self._forecasts.want()

    def forecast_age_s(self) -> float:
        """Process seconds since the state that the live forecast starts from; NaN before it."""
        return self._forecasts.forecasting.age_s()

    # ------------------------------------------------------------------ what comes in
    def take(self, samples: Sequence[Sample], plans: Sequence[PlannedProfile]) -> None:
        """Take in a batch from the drivers or from a gateway."""
        self._publishing.take(self.readings.add(samples))
        for plan in plans:
            if plan.asset == self.id and self._forecasts.forecasting.take_plan(plan):
                self._forecasts.want()

    def switch(self, active: RunningModel, who: str = SERVICE, comment: str = "") -> None:
        """Go on with another model version, without a gap; the journal says who wanted it."""
        before = self.active.version
        self.estimate.swap(active)
        self._watch.switched(before, who, comment)
        self._publishing.verdict_due = True
        self.documents.model_switched()
        self._forecasts.want()
        _log.info("model_switched", asset=self.id, version=active.version)

    async def renew_grease(
        self, who: str, comment: str, audit: AuditEntry | None = None
    ) -> GreaseRenewed:
        """Record that the grease was renewed, and keep it for the next start."""
        if not self.estimate.started:
            raise NotReadyError("the twin waits for the first good temperatures, speed and load")
        before = self.estimate.renew_grease()
        self._watch.grease_renewed(before, who, comment)
        document = self.documents.grease_renewed(before)
        self._forecasts.want()
        await self.saving.keep(audit)
        return document

    def change_alarms(
        self, settings: AssetSection, overrides: Mapping[AlarmName, AlarmOverride]
    ) -> None:
        """Judge by other limits and alarm settings from the next sample on.

        Alarms keep their ids and states. A forecast with the limits before is gone, and
        the next one is made at once.
        """
        limits_changed = settings.limits != self.settings.limits
        self.settings = settings
        with self._watching():
            self._watch.look(self._clock.now_us())
        self._watch.change(settings, overrides)
        self._judgement.change(settings)
        self.documents.settings_changed(settings)
        self._publishing.verdict_due = True
        if limits_changed:
            if self._waits is not None:
                self._waits["called_steps"] = []
            self._forecasts.forecasting.change_limits(settings.limits)
            self._forecasts.want()

    def clock_set(self, by_us: int) -> None:
        """Follow the machine as before: the clock was set by so much."""
        if self._waits is not None:
            move_kept(self._waits, by_us)
        self.readings.clock_set(by_us, self._clock.now_us())
        self.estimate.clock_set(by_us)
        self._watch.clock_set(by_us)
        self._judgement.clock_set(by_us)
        self._forecasts.forecasting.clock_set(by_us)
        self._publishing.clock_set()
        self.documents.changed()
        self._forecasts.want()

    def drift_reported(self, text: str) -> None:
        """Write into the journal that the machine has changed."""
        self._watch.drift_reported(text)

    def alarms_changed(self) -> None:
        """Note that an alarm of this asset has changed."""
        self._publishing.verdict_due = True
        self.documents.alarms_changed()

    # ------------------------------------------------------------------ the running twin
    async def run(self, kept_state: KeptState | None, ready: asyncio.Event | None = None) -> None:
        """Make forecasts until cancelled; `service.live.twins` steps the twin and saves its state.

        Parameters
        ----------
        kept_state : mapping, optional
            What to go on from.
        ready : asyncio.Event, optional
            Set when there is what estimates are computed with. Until then measured values alone
            are sent and judged.
        """
        if AMBIENT not in self.facts:
            _log.warning(
                "ambient_assumed",
                asset=self.id,
                taken="the coldest reading so far",
                expected=f"a channel {AMBIENT}",
            )
        self._waits = kept_state
        if kept_state is not None:
            self._watch.restore_sources(kept_state.get("watch") or {})
        try:
            if ready is not None and not ready.is_set():
                self.documents.running = True
                await ready.wait()
            self._waits = None
            if kept_state is not None:
                self._restore(kept_state)
            self.estimates = self.documents.running = True
            await self._forecasts.run(self._forecast_made)
        finally:
            self.estimates = self.documents.running = False
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LAST_SAVE_WALL_S):
                    await self.saving.last()

    def _restore(self, kept_state: KeptState) -> None:
        watched: KeptWatch = kept_state.get("watch") or {}
        for follower in self._forecasts.followers:
            if known := cast(Mapping[str, object], kept_state).get(follower.name):
                follower.restore(known)
        try:
            self.estimate.restore(kept_state)
            self.documents.changed()
            self._watch.restore(watched)
            self._judgement.restore(kept_state.get("called_steps") or [])
        except ValueError as error:
            _log.warning("estimate_not_restored", asset=self.id, reason=str(error))

    def used(self, now_us: int, means: Mapping[str, float]) -> Mapping[str, float]:
        """Give what a step uses: the first one also what came before and is still good."""
        if self._had_started:
            return means
        good = {name: self.readings.good_value(name, now_us) for name in self.facts}
        return {name: value for name, value in good.items() if value is not None} | dict(means)

    def stepped(self, now_us: int, failure: Exception | None) -> Reference | None:
        """Record a step of the estimate; gives the model alone where that must be advanced too.

        Parameters
        ----------
        now_us : int
            Process time to which the estimate was advanced.
        failure : Exception or None
            What it failed of.
        """
        self._note_step(failure)
        return self._watch.follow(now_us)

    def judge(self, now_us: int, means: Mapping[str, float]) -> None:
        """Judge the alarms after a step, and send and store what is due.

        Parameters
        ----------
        now_us : int
            Process time of the step.
        means : mapping of str to float
            Mean readings that the estimate was given.
        """
        with self._watching():
            trusted = _is_trusted(self._estimating, self._forecasts)
            self._watch.step(now_us, means, trusted)
        if self._had_started and self.estimate.started:
            self._publishing.stepped(now_us, self.estimate, bool(self._blind))

    def _note_step(self, failure: Exception | None) -> None:
        had_started = self._had_started
        with self._estimating():
            if failure is not None:
                raise failure
        if self._estimating.failing:
            self.estimate.stop()
        started, blind = self.estimate.started, self._judgement.blind
        if blind != self._blind or had_started != started:
            self._publishing.verdict_due = True
        # The first forecast of a run does not wait for its period, whether the estimate begins or
        # goes on from the last run.
        begins = started and (self._forecasts.is_first or not had_started)
        if begins or blind != self._blind:
            self._forecasts.is_first &= not begins
            self._forecasts.want()
        self._blind = blind
        self._had_started = started
        self.documents.changed()

    def _forecast_made(self, now_us: int) -> None:
        self._publishing.forecast(self._forecasts.forecasting)
        summary = self._forecasts.forecasting.summary
        crossings = summary.crossings if summary else {}
        self._watch.forecast(now_us, crossings, self._forecasts.record)

    def publish(self, now_us: int, wall_s: float) -> None:
        """Send what is new to those who follow: the latest samples, and the verdict."""
        self._publishing.publish(now_us, wall_s)

    async def take_over(self, before: "AssetRuntime") -> KeptState | None:
        """Take what the twin before could not bring into the store; gives what to go on from.

        Parameters
        ----------
        before
            A twin of the same machine that does not run any more.
        """
        taken = await self.saving.take_over(before.saving)
        if taken is None and before._waits is not None:
            watched = before._waits.get("watch") or KeptWatch()
            watched["spoken"] = before._watch.spoken
            taken = KeptState(**{**before._waits, "watch": watched})
        return taken


# What the parts of a runtime ask is no method of it: a twin that has ended goes at once then, and
# need not be found by a collection of garbage, which does not look at twins.
def _is_trusted(estimating: Guard, forecasts: ForecastLoop) -> bool:
    """A model whose estimate or forecast fails on this machine says nothing about it."""
    return not (estimating.failing or forecasts.failing)


def _kept(
    estimate: LiveEstimate, watch: AlarmWatch, judgement: Judgement, forecasts: ForecastLoop
) -> KeptState:
    state: KeptState = {
        **(estimate.to_dict() or {}),
        "watch": watch.to_dict(),
        "called_steps": judgement.to_rows(),
    }
    known = {follower.name: follower.to_dict() for follower in forecasts.followers}
    return cast(KeptState, {**state, **known})


def _readings(
    settings: AssetSection,
    channels: Mapping[str, ChannelFacts],
    clock: Clock,
    doubt: Callable[[str], str],
    ahead_s: Callable[[str], float | None],
) -> Readings:
    return Readings(
        settings.id,
        {name: allowed_age_s(facts.max_age_s, clock.rate) for name, facts in channels.items()},
        clock.now_us(),
        doubt=doubt,
        ahead_s=ahead_s,
        learned_from_s={
            name: facts.learned_from_s
            for name, facts in channels.items()
            if facts.learned_from_s is not None
        },
        rate=clock.rate,
    )
