"""Reads every source of a configuration once, through the same drivers as the service."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from prometheus_client import CollectorRegistry

from adapters.protocol import Driver
from adapters.samples import Quality, Sample, is_good, meaning
from service.clock import ProcessClock
from service.ingest.quality import QualityChecks
from service.site.machines.plausibility import doubts_of_values
from service.site.settings import Settings
from service.site.wiring import PUSH, SourceWiring, Wiring

PROBE_WALL_S = 10.0
_CANCEL_AGAIN_WALL_S = 1.0


@dataclass(frozen=True, slots=True)
class ProbedSource:
    """How a source answered; ``detail`` is "ok" or says what is wrong."""

    name: str
    driver: str
    up: bool
    detail: str


@dataclass(frozen=True, slots=True)
class ProbedChannel:
    """The value of a channel; ``value`` and ``age_s`` are None where there is none.

    - ``quality``: OPC DA byte; None where no sample came.
    - ``detail``: why the value is not good, or what a pushed channel waits for; else empty.
    """

    asset: str
    channel: str
    source: str
    value: float | None
    quality: int | None
    age_s: float | None
    detail: str

    @property
    def is_wrong(self) -> bool:
        """Whether a source was asked for the value and gave no good one."""
        return self.source != PUSH and (self.quality is None or not is_good(self.quality))


@dataclass(frozen=True, slots=True)
class ProbedPlan:
    """The planned profile of an asset's controller; ``steps`` is None when it was not read."""

    asset: str
    source: str
    steps: int | None


@dataclass(slots=True)
class _Answer:
    """What a source gave within its time."""

    source: SourceWiring
    latest: dict[tuple[str, str], Sample] = field(default_factory=dict)
    steps: dict[str, int] = field(default_factory=dict)
    up: bool = False
    detail: str = "did not start"
    problems: Mapping[str, str] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether everything has come; a device that is not ready yet may be a moment later."""
        samples = (self.latest.get((one.asset, one.channel)) for one in self.source.channels)
        # A plan that cannot be read is named in the detail of its source.
        return all(
            one is not None and one.quality != Quality.WAITING_FOR_INITIAL_DATA for one in samples
        ) and all(
            plan.asset in self.steps or f"plan of {plan.asset}" in self.detail
            for plan in self.source.plans
        )


@dataclass(frozen=True, slots=True)
class Probe:
    """What all sources gave."""

    sources: Sequence[ProbedSource]
    channels: Sequence[ProbedChannel]
    plans: Sequence[ProbedPlan]

    @property
    def problems(self) -> list[str]:
        """What is wrong, one line each; of a source that is down only the source."""
        down = {one.name for one in self.sources if not one.up}
        lines = [f"source {one.name!r}: {one.detail}" for one in self.sources if not one.up]
        lines += [
            f"channel {one.asset}/{one.channel} (source {one.source!r}): {one.detail}"
            for one in self.channels
            if one.is_wrong and one.source not in down
        ]
        details = {one.name: one.detail for one in self.sources}
        lines += [
            f"plan of {one.asset} (source {one.source!r}): not read; {details[one.source]}"
            for one in self.plans
            if one.steps is None and one.source not in down
        ]
        return lines

    @property
    def warnings(self) -> list[str]:
        """What a source says of itself though it is up and gives good values."""
        wrong = {one.source for one in self.channels if one.is_wrong}
        return [
            f"source {one.name!r}: {one.detail}"
            for one in self.sources
            if one.up and one.detail != "ok" and one.name not in wrong
        ]


def unit_doubts(settings: Settings | None, probe: Probe) -> list[str]:
    """Say which good values may be in another unit than their channel, one line each."""
    good: dict[str, dict[str, float | None]] = {}
    for one in probe.channels:
        if one.quality is not None and is_good(one.quality):
            good.setdefault(one.asset, {})[one.channel] = one.value
    return [
        f"asset {asset.id}: {doubt.text}"
        for asset in (settings.assets if settings is not None else ())
        for doubt in doubts_of_values(asset.bearing, good.get(asset.id, {}))
    ]


async def probe(wiring: Wiring, limit_s: float = PROBE_WALL_S) -> Probe:
    """Connect to every source, side by side, and read each channel once."""
    clock = ProcessClock()
    answers = await asyncio.gather(*(_ask(source, clock, limit_s) for source in wiring.sources))
    latest = {key: sample for answer in answers for key, sample in answer.latest.items()}
    problems = {key: text for answer in answers for key, text in answer.problems.items()}
    checks = QualityChecks(wiring.check_limits, CollectorRegistry())
    judged = {(one.asset, one.channel): one for one in checks.judge(list(latest.values()))}
    now_us = clock.now_us()

    def channel(asset: str, name: str, source: str) -> ProbedChannel:
        sample = judged.get((asset, name))
        if sample is None:
            waits = "waits for pushes" if source == PUSH else f"no value within {limit_s:g} s"
            return ProbedChannel(asset, name, source, None, None, None, waits)
        quality = sample.quality
        why = problems.get(f"{asset}/{name}") or checks.reason(asset, name) or meaning(quality)
        value = None if sample.value != sample.value else sample.value
        age_s = None if value is None else max(now_us - sample.time_us, 0) / 1e6
        detail = "" if is_good(quality) else why
        return ProbedChannel(asset, name, source, value, int(quality), age_s, detail)

    return Probe(
        [
            ProbedSource(one.source.name, one.source.config.driver, one.up, one.detail)
            for one in answers
        ],
        [
            channel(asset, name, facts.source)
            for asset, channels in wiring.channels.items()
            for name, facts in channels.items()
        ],
        [
            ProbedPlan(plan.asset, one.source.name, one.steps.get(plan.asset))
            for one in answers
            for plan in one.source.plans
        ],
    )


async def _ask(source: SourceWiring, clock: ProcessClock, limit_s: float) -> _Answer:
    answer = _Answer(source)
    task = asyncio.create_task(_listen(answer, clock))
    await asyncio.wait({task}, timeout=limit_s)
    while not task.done():
        # `asyncio.wait_for` of Python 3.11, which pymodbus uses, can swallow a cancellation.
        task.cancel()
        await asyncio.wait({task}, timeout=_CANCEL_AGAIN_WALL_S)
    error = None if task.cancelled() else task.exception()
    if error is not None:
        answer.up, answer.detail = False, f"{error}" or type(error).__name__
    return answer


async def _listen(answer: _Answer, clock: ProcessClock) -> None:
    driver: Driver = answer.source.create(clock)
    async with driver:
        try:
            async for batch in driver.batches():
                answer.latest |= {(one.asset, one.channel): one for one in batch.samples}
                answer.steps |= {plan.asset: len(plan.steps) for plan in batch.plans}
                settled = _note(answer, driver)
                if (answer.complete and settled) or not answer.up:
                    return
        finally:
            _note(answer, driver)


def _note(answer: _Answer, driver: Driver) -> bool:
    """Note how a source is doing; whether that is all there is to be known."""
    health = driver.health()
    answer.up, answer.detail, answer.problems = health.up, health.detail, dict(health.problems)
    return health.settled
