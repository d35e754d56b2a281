"""Whether the machine is safe now, to the end of its present step, and in its next step.

One rule for page, REST, tags and stream. *Safe* needs its inputs: good and fresh temperatures,
speed and load (ambient too where it is configured) and a twin that runs; what lies ahead also
needs an identified model and a forecast of it. Whatever is missing is named, and the word is then
*unknown*. A temperature that is measured above its limit stands among the reasons all the same,
with that limit. *Recovering* is a word for a limit that is exceeded, never for one that only will
be.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.samples import meaning
from service.clock import rfc3339
from service.documents.limits import Level, Limit
from service.documents.verdicts import (
    Judgements,
    TimeToLimit,
    VerdictOf,
    VerdictOfPresentStep,
    Word,
)
from service.domain.channels import AMBIENT, label
from service.live.called_steps import NotSafeCall, call, call_of, span_us
from service.live.outlook import ChannelOutlook, Outlook, StepOutlook
from service.live.presentation import LimitCrossing
from service.live.readings import Readings
from service.site.asset_section import AssetSection
from service.site.required_channels import OPERATION, required_channels

TWIN, IDENTIFIED_MODEL, FORECAST = "twin", "identified model", "forecast"
"""What can be missing and is no channel."""
_WHY = {
    TWIN: "the twin does not run",
    IDENTIFIED_MODEL: "the model was never identified",
    FORECAST: "there is no recent forecast of the present model",
}


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a verdict is made from.

    Attributes
    ----------
    settings : AssetSection
        Channels, limits and thresholds.
    readings : Readings
        The latest samples.
    now_us : int
        Process time.
    twin_runs : bool
        Whether the estimate follows the machine now.
    identified : bool
        Whether its model was identified.
    outlook : Outlook or None
        The forecast, None unless it is recent and of the present model.
    returning : collection of str
        Channels with a measured-limit alarm that is there still.
    assumed_ambient_c : float or None
        What is taken for the ambient temperature where no channel measures it.
    doubts : tuple of str
        What of the operation may be in another unit.
    called : tuple of NotSafeCall
        Steps that were called *not safe* before, see `called_steps`.
    """

    settings: AssetSection
    readings: Readings
    now_us: int
    twin_runs: bool
    identified: bool
    outlook: Outlook | None
    returning: frozenset[str] = frozenset()
    assumed_ambient_c: float | None = None
    doubts: tuple[str, ...] = ()
    called: tuple[NotSafeCall, ...] = ()


def missing_channels(settings: AssetSection, readings: Readings, now_us: int) -> list[str]:
    """Required channels without a good and fresh value now."""
    return [
        name
        for name in required_channels(settings)
        if name not in readings.max_age_s or readings.good_value(name, now_us) is None
    ]


def missing_operation(settings: AssetSection, readings: Readings, now_us: int) -> list[str]:
    """What the twin would have to know of the operation now and does not."""
    missing = missing_channels(settings, readings, now_us)
    return [name for name in missing if name in (*OPERATION, *settings.input_names, AMBIENT)]


def judge(evidence: Evidence) -> Judgements:
    """Give the verdict, but for its time."""
    steps = _steps_ahead(evidence)
    absent, absent_ahead = _absent(evidence, steps)
    ambient = _assumption(evidence)
    why = {name: _why(name, evidence) for name in absent_ahead}
    now = _now(evidence, absent, None if absent_ahead else steps[0], why, ambient)
    if absent_ahead:
        ahead = _verdict("unknown", tuple(why[name] for name in absent_ahead))
        present, following = _present_step(ahead, None), ahead
    else:
        rest, *others = (_step(evidence, step, ambient) for step in steps[:2])
        present = _present_step(_not_better(rest, now), _ends_at(evidence, steps[0]))
        # With nothing planned after the present step, the question is about that one.
        following = others[0] if others else rest
    return Judgements(
        now=now,
        present_step=present,
        next_step=following,
        time_to_limit=None if absent_ahead else _time_to_limit(evidence),
        missing=absent_ahead,
    )


def called_steps(evidence: Evidence) -> tuple[NotSafeCall, ...]:
    """Steps that were called *not safe* as the next one, until they end or are changed.

    A step that only begins over a limit, because of the one before, and cools is not among them.
    While there is no word on what lies ahead, or no plan, all stay as they are.
    """
    steps = _steps_ahead(evidence)
    outlook = evidence.outlook
    if outlook is None or _absent(evidence, steps)[1] or steps[0].plan is None:
        return tuple(one for one in evidence.called if one.end_us > evidence.now_us)
    called = []
    for place, step in enumerate(steps[:2]):
        before = call_of(evidence.called, step, outlook.made_us)
        if before is None and place == 1 and _rising(step, evidence.settings):
            probability = _worst(step, evidence.settings)[1].warning.probability
            before = call(step, outlook.made_us, evidence.now_us, probability)
        if before is not None:
            called.append(before)
    return tuple(called)


def _absent(evidence: Evidence, steps: Sequence[StepOutlook]) -> tuple[list[str], list[str]]:
    """What the word for now lacks, and what the words for the steps lack."""
    settings = evidence.settings
    absent = missing_channels(settings, evidence.readings, evidence.now_us)
    if not settings.limits:
        absent.append("limits")
    if not evidence.twin_runs:
        absent.append(TWIN)
    ahead = list(absent)
    if not evidence.identified:
        ahead.append(IDENTIFIED_MODEL)
    if not steps:
        ahead.append(FORECAST)
    return absent, ahead


# ------------------------------------------------------------------------------------- now
def _now(
    evidence: Evidence,
    absent: Sequence[str],
    step: StepOutlook | None,
    why: Mapping[str, str],
    ambient: tuple[str, ...],
) -> VerdictOf:
    exceeded = _exceeded(evidence)
    lost = tuple(why[name] for name in absent)
    if exceeded:
        limit, _ = exceeded[0]
        reasons = tuple(
            f"{label(one.channel)} {celsius:.1f} °C, over {one.level} {one.value_c:g} °C"
            for one, celsius in exceeded
        )
        cools = step is not None and all(step.channels[one.channel].cools for one, _ in exceeded)
        word: Word = "recovering" if cools and limit.level == "warning" else "not safe"
        if word == "recovering":
            reasons += ("the present step cools it",)
        if absent:
            word = "unknown"
        return _verdict(word, reasons + lost, limit, 1.0, 0.0)
    returning = sorted(evidence.returning & set(evidence.settings.limits))
    if absent:
        stood = tuple(f"{label(name)}: its limit alarm stands" for name in returning)
        return _verdict("unknown", stood + lost)
    if returning:
        reasons = tuple(f"{label(name)}: its limit alarm is returning" for name in returning)
        cools = step is not None and not _rising(step, evidence.settings)
        return _verdict("recovering" if cools else "not safe", reasons)
    return _verdict("safe", ("all temperatures are below their limits", *ambient))


def _exceeded(evidence: Evidence) -> list[tuple[Limit, float]]:
    """Limits that a good and fresh temperature exceeds, alarms first, then the furthest."""
    found = []
    for name, pair in evidence.settings.limits.items():
        if name not in evidence.readings.max_age_s:
            continue
        value_c = evidence.readings.good_value(name, evidence.now_us)
        if value_c is not None and value_c >= pair.warning:
            level: Level = "alarm" if value_c >= pair.alarm else "warning"
            found.append((_limit(evidence, name, level), value_c))
    return sorted(found, key=lambda one: (one[0].level != "alarm", one[0].value_c - one[1]))


# ------------------------------------------------------------------------------------- the steps
def _step(evidence: Evidence, step: StepOutlook, ambient: tuple[str, ...]) -> VerdictOf:
    """The verdict on a step ahead, or on what is left of the present one."""
    settings, made_us = evidence.settings, _made_us(evidence)
    name, worst = _worst(step, settings)
    limit = _limit(evidence, name, "warning")
    probability = worst.warning.probability
    likely = probability >= settings.verdict.safe_below_probability
    called = call_of(evidence.called, step, made_us)
    cools = likely and not _rising(step, settings)
    word: Word = "safe"
    if called is not None or likely:
        recovers = called is None and cools and _over_now(evidence, step)
        word = "recovering" if recovers else "not safe"
    point = f"{step.speed_rpm:.0f} rpm, {step.load_n:.0f} N"
    reasons = [
        f"{label(name)} over warning {limit.value_c:g} °C with {_percent(probability)} at {point}; "
        f"upper bound (97.5 %) {worst.upper_c:.1f} °C"
    ]
    if cools:
        reasons.append("the step begins over the warning and cools below it")
    if called is not None and not likely:
        reasons.append(
            f"the step was called not safe before ({_percent(called.probability)}): "
            "that stands until it has ended or was changed"
        )
    return _verdict(
        word,
        (*reasons, *ambient),
        limit,
        probability,
        _seconds_left(worst.warning.earliest_s, (evidence.now_us - made_us) / 1e6),
        worst.alarm.probability,
    )


def _not_better(rest: VerdictOf, now: VerdictOf) -> VerdictOf:
    """What is left of the present step begins now: it is never better than now."""
    if now.word == "not safe" or (now.word == "recovering" and rest.word == "safe"):
        return now
    return rest


def _present_step(verdict: VerdictOf, ends_at: str | None) -> VerdictOfPresentStep:
    return VerdictOfPresentStep(**dict(verdict), ends_at=ends_at)


def _ends_at(evidence: Evidence, step: StepOutlook) -> str | None:
    """When the present step ends by the plan."""
    return None if step.plan is None else rfc3339(span_us(step, _made_us(evidence))[1])


def _made_us(evidence: Evidence) -> int:
    """When the forecast was made; now where there is none."""
    return evidence.now_us if evidence.outlook is None else evidence.outlook.made_us


def _over_now(evidence: Evidence, step: StepOutlook) -> bool:
    """Whether each temperature that a step brings below its warning is over it at this moment.

    Measured, or its limit alarm has not returned; where nothing measures it, by the estimate that
    the forecast starts from.
    """
    settings, present = evidence.settings, _steps_ahead(evidence)[0]
    over = {limit.channel for limit, _ in _exceeded(evidence)} | evidence.returning
    over |= {
        name
        for name, channel in present.channels.items()
        if name not in evidence.readings.max_age_s and channel.begins_over
    }
    safe_below = settings.verdict.safe_below_probability
    return all(
        name in over
        for name, channel in step.channels.items()
        if channel.warning.probability >= safe_below
    )


def _steps_ahead(evidence: Evidence) -> list[StepOutlook]:
    """What is left of the steps, if the forecast speaks of every limit."""
    if evidence.outlook is None:
        return []
    elapsed_s = (evidence.now_us - evidence.outlook.made_us) / 1e6
    steps = [step.from_time(elapsed_s) for step in evidence.outlook.steps if step.end_s > elapsed_s]
    limits = set(evidence.settings.limits)
    return steps if limits and all(limits <= set(step.channels) for step in steps) else []


def _worst(step: StepOutlook, settings: AssetSection) -> tuple[str, ChannelOutlook]:
    """Of all limited temperatures the one that most probably exceeds its limit."""

    def rank(item: tuple[str, ChannelOutlook]) -> tuple[float, float, float]:
        name, channel = item
        margin_k = channel.upper_c - settings.limits[name].warning
        return channel.warning.probability, channel.alarm.probability, margin_k

    return max(step.channels.items(), key=rank)


def _rising(step: StepOutlook, settings: AssetSection) -> bool:
    """Whether any temperature may exceed its warning in another way than by beginning above it."""
    safe_below = settings.verdict.safe_below_probability
    return any(
        one.warning.probability >= safe_below and not one.cools for one in step.channels.values()
    )


def _time_to_limit(evidence: Evidence) -> TimeToLimit | None:
    """How long until a limit, along all that is planned: of the limit that comes soonest.

    Where the warning is exceeded already, the question is about the alarm limit.
    """
    outlook = evidence.outlook
    if outlook is None or not outlook.steps:
        return None
    elapsed_s = (evidence.now_us - outlook.made_us) / 1e6
    over = {limit.channel for limit, _ in _exceeded(evidence)}
    asked_level: dict[str, Level] = {
        name: "alarm" if name in over else "warning" for name in outlook.crossings
    }
    asked = [
        (_limit(evidence, name, level), outlook.crossings[name][level])
        for name, level in asked_level.items()
    ]
    if not asked:
        return None
    safe_below = evidence.settings.verdict.safe_below_probability
    end_s = outlook.steps[-1].end_s

    def rank(item: tuple[Limit, LimitCrossing]) -> tuple[bool, float, float]:
        crossing = item[1]
        soon_s = end_s if crossing.earliest_s is None else crossing.earliest_s
        return crossing.probability < safe_below, soon_s, -crossing.probability

    limit, crossing = min(asked, key=rank)
    return TimeToLimit(
        limit=limit,
        expected=crossing.probability >= safe_below,
        probability=round(crossing.probability, 4),
        earliest_s=_rounded(_seconds_left(crossing.earliest_s, elapsed_s), 0),
        median_s=_rounded(_seconds_left(crossing.median_s, elapsed_s), 0),
        horizon_s=round(max(end_s - elapsed_s, 0.0)),
    )


# ------------------------------------------------------------------------------------- words
def _why(name: str, evidence: Evidence) -> str:
    if name in _WHY:
        return _WHY[name]
    if name == "limits":
        return "no temperature has a limit"
    if name not in evidence.readings.max_age_s:
        return f"{label(name)}: no channel is configured"
    return f"{label(name)}: {meaning(evidence.readings.quality(name, evidence.now_us))}"


def _assumption(evidence: Evidence) -> tuple[str, ...]:
    if evidence.assumed_ambient_c is None:
        return evidence.doubts
    return (f"ambient assumed {evidence.assumed_ambient_c:.0f} °C", *evidence.doubts)


def _seconds_left(at_s: float | None, elapsed_s: float) -> float | None:
    return None if at_s is None else max(at_s - elapsed_s, 0.0)


def _percent(probability: float) -> str:
    if probability < 0.01:
        return "less than 1 %"
    return "more than 99 %" if probability > 0.99 else f"{100 * probability:.0f} %"


def _verdict(
    word: Word,
    reasons: Sequence[str],
    limit: Limit | None = None,
    probability: float | None = None,
    seconds_to_limit: float | None = None,
    alarm_probability: float | None = None,
) -> VerdictOf:
    return VerdictOf(
        word=word,
        reasons=list(reasons),
        limit=limit,
        probability=_rounded(probability, 4),
        seconds_to_limit=_rounded(seconds_to_limit, 0),
        alarm_probability=_rounded(alarm_probability, 4),
    )


def _limit(evidence: Evidence, channel: str, level: Level) -> Limit:
    pair = evidence.settings.limits[channel]
    return Limit(channel=channel, level=level, value_c=getattr(pair, level))


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
