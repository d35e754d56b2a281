"""Makes the verdict of a running asset from what is there at the moment."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from adapters.protocol import Clock
from adapters.samples import Quality, Sample, is_good
from service.alarms import AlarmBook
from service.clock import rfc3339
from service.documents.tags import Tag, tag
from service.documents.verdicts import CODES, VerdictDocument
from service.domain.channels import AMBIENT, LOAD, SPEED
from service.live.called_steps import NotSafeCall, called_steps_of, called_steps_to_rows
from service.live.estimate import LiveEstimate
from service.live.forecasting import Forecasting
from service.live.outlook import Outlook
from service.live.readings import Readings
from service.live.verdict import Evidence, called_steps, judge, missing_operation
from service.site.asset_section import AssetSection
from service.site.machines.plausibility import doubts_of_values
from service.site.required_channels import required_channels

#: A verdict looks ahead with no older forecast; process s, and at least this many wall s.
FORECAST_MAX_AGE_S, FORECAST_MAX_AGE_WALL_S = 300.0, 30.0
#: An estimate that was not carried forward for so long does not follow the machine.
ESTIMATE_MAX_AGE_S, ESTIMATE_MAX_AGE_WALL_S = 60.0, 10.0
#: Process seconds in which a doubt about a unit stays as it is.
DOUBTED_FOR_S = 60.0


class Judgement:
    """The verdict of one asset, and when its words last changed.

    Parameters
    ----------
    settings : AssetSection
        Channels, limits and thresholds.
    readings : Readings
        The latest samples.
    estimate : LiveEstimate
        The twin.
    forecasting : Forecasting
        What lies ahead.
    book : AlarmBook
        Knows which limit alarms are there still.
    clock : Clock
        Process time.
    """

    def __init__(
        self,
        settings: AssetSection,
        readings: Readings,
        estimate: LiveEstimate,
        forecasting: Forecasting,
        book: AlarmBook,
        clock: Clock,
    ) -> None:
        self._settings = settings
        self._readings = readings
        self._estimate = estimate
        self._forecasting = forecasting
        self._book = book
        self._clock = clock
        self._published: dict[str, tuple[int, str]] = {}
        self._required = frozenset(required_channels(settings))
        # What of each required channel a verdict depends on, and what the last verdict lacked.
        self._seen: dict[str, tuple[bool, int]] = {}
        self._missing: frozenset[str] = frozenset()
        self._called: tuple[NotSafeCall, ...] = ()
        self._doubts: tuple[str, ...] = ()
        self._doubted_us: int | None = None

    def change(self, settings: AssetSection) -> None:
        """Judge by other limits; the next samples are news."""
        if settings.limits != self._settings.limits:
            self._called = ()
        self._settings = settings
        self._seen = {}

    def clock_set(self, by_us: int) -> None:
        """Keep what was called *not safe*: the clock was set by so much."""
        self._called = tuple(one.moved(by_us) for one in self._called)

    def to_rows(self) -> list[list[float]]:
        """Steps that were called *not safe*, for the next start."""
        return called_steps_to_rows(self._called)

    def restore(self, rows: Sequence[Sequence[float]]) -> None:
        """Go on from the steps that were called *not safe* before.

        Raises
        ------
        ValueError
            Where they are of another form.
        """
        self._called = called_steps_of(rows)

    def document(self, running: bool) -> VerdictDocument:
        """Give the verdict of this moment.

        Parameters
        ----------
        running : bool
            Whether the asset's runtime is at work.
        """
        now_us = self._clock.now_us()
        evidence = self._evidence(now_us, running)
        self._called = called_steps(evidence)
        judged = judge(replace(evidence, called=self._called))
        self._missing = frozenset(judged.missing)
        document = VerdictDocument(**dict(judged), time=rfc3339(now_us))
        for name, verdict in document.by_name.items():
            code = CODES[verdict.word]
            if self._published.get(name, (None,))[0] != code:
                self._published[name] = code, document.time
        return document

    def is_news(self, samples: Iterable[Sample]) -> bool:
        """Whether new samples may give another verdict.

        They do when a required channel becomes good or ceases to be, exceeds another limit than
        before, or was missing.
        """
        news = False
        for sample in samples:
            channel = sample.channel
            if channel not in self._required:
                continue
            limits = self._settings.limits.get(channel)
            value = sample.value
            over = 0 if limits is None else (value >= limits.warning) + (value >= limits.alarm)
            seen = is_good(sample.quality), over
            news |= channel in self._missing or self._seen.get(channel) != seen
            self._seen[channel] = seen
        return news

    def holds_until_us(self, now_us: int) -> float:
        """First process time after now at which time alone may give another verdict.

        A channel gets stale, the estimate or the forecast gets old, or a step of the plan ends.
        """
        rate = self._clock.rate
        moments = [
            self._readings.stale_from_us(name)
            for name in self._required
            if name in self._readings.max_age_s
        ]
        if self._estimate.time_us is not None:
            oldest_s = max(ESTIMATE_MAX_AGE_S, ESTIMATE_MAX_AGE_WALL_S * rate)
            moments.append(self._estimate.time_us + oldest_s * 1e6 + 1.0)
        outlook = self._forecasting.outlook
        if outlook is not None:
            oldest_s = max(FORECAST_MAX_AGE_S, FORECAST_MAX_AGE_WALL_S * rate)
            ends_s = (*(step.end_s for step in outlook.steps), oldest_s)
            moments += [outlook.made_us + end_s * 1e6 + 1.0 for end_s in ends_s]
        return min((moment for moment in moments if moment > now_us), default=math.inf)

    def tags(self, document: VerdictDocument) -> dict[str, Tag]:
        """Tags of the latest verdict; their time is when the word last changed.

        Unknown is a good value, too: who takes good values only must not keep an old *safe*.
        """
        return {
            f"verdict.{name}": tag(CODES[verdict.word], "", Quality.GOOD, self._published[name][1])
            for name, verdict in document.by_name.items()
        }

    @property
    def blind(self) -> list[str]:
        """Speed, load and ambient that the twin would have to know now and does not."""
        return missing_operation(self._settings, self._readings, self._clock.now_us())

    @property
    def assumed_ambient_c(self) -> float | None:
        """What is taken for the ambient temperature where no channel measures it."""
        point = self._estimate.point
        return None if point is None or AMBIENT in self._settings.channels else point.ambient_c

    def _evidence(self, now_us: int, running: bool) -> Evidence:
        active = self._estimate.active
        return Evidence(
            settings=self._settings,
            readings=self._readings,
            now_us=now_us,
            twin_runs=running and self._follows(now_us),
            identified=active.identified,
            outlook=self._outlook(now_us),
            returning=frozenset(
                channel
                for kind, channel, _ in self._book.present(self._settings.id)
                if kind == "measured limit" and channel in self._settings.limits
            ),
            assumed_ambient_c=self.assumed_ambient_c,
            doubts=self._unit_doubts(now_us),
            called=self._called,
        )

    def _unit_doubts(self, now_us: int) -> tuple[str, ...]:
        """What of the operation may be in another unit; words that come and go would be news."""
        before_us = self._doubted_us
        if before_us is None or not 0 <= now_us - before_us < DOUBTED_FOR_S * 1e6:
            operation = {
                name: self._readings.good_value(name, now_us)
                for name in (SPEED, LOAD, AMBIENT)
                if name in self._settings.channels
            }
            doubts = doubts_of_values(self._settings.bearing, operation)
            self._doubts, self._doubted_us = tuple(one.words for one in doubts), now_us
        return self._doubts

    def _follows(self, now_us: int) -> bool:
        time_us = self._estimate.time_us
        if not self._estimate.started or time_us is None:
            return False
        return abs(now_us - time_us) / 1e6 <= max(
            ESTIMATE_MAX_AGE_S, ESTIMATE_MAX_AGE_WALL_S * self._clock.rate
        )

    def _outlook(self, now_us: int) -> Outlook | None:
        """The latest forecast, unless it is old or of a model that is not the active one."""
        outlook = self._forecasting.outlook
        if outlook is None or outlook.model_version != self._estimate.active.version:
            return None
        age_s = abs(now_us - outlook.made_us) / 1e6
        oldest_s = max(FORECAST_MAX_AGE_S, FORECAST_MAX_AGE_WALL_S * self._clock.rate)
        return outlook if age_s <= oldest_s else None
