"""The forecast ledger: kept forecasts with what came of them, and how good they were."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from service.clock import MICROSECONDS, rfc3339
from service.documents.base import Document, Number, Page, Time, time_or_none
from service.documents.profiles import ForecastStep
from service.store.forecast_records import (
    ForecastPage,
    Interrupted,
    Outcome,
    PointState,
    Reason,
    StoredForecast,
    all_degrees,
    degrees,
)
from twin_core.scores import mean_absolute_error
from twin_core.verification import independent_runs, verify

Risk = Literal["low", "high"]
Naive = Literal["persistence", "linear", "arx"]
NAIVE: tuple[Naive, ...] = ("persistence", "linear", "arx")
_RISK_TEXT = "`high` where the steps from its time up to this lead time leave the low-risk region."
_START_KNOWN = "initial state of "


class NaiveScore(Document):
    """Errors of a simple forecast that was issued at the same moments."""

    mae_k: Number = Field(description="Mean absolute error, K; null where there was none.")
    crps_k: Number = Field(description="CRPS, K; of a forecast without a spread it is the same.")


class SetAside(Document):
    """Why readings were not scored."""

    plan: int = Field(description="The machine did not follow the plan.")
    data: int = Field(description="Six hours later there was no good measurement.")
    model: int = Field(description="The model version is not in the store any more.")


class SharesBelow(Document):
    """Shares of the measurements at or below each quantile, 0 to 1."""

    q025: Number
    q25: Number
    q50: Number
    q75: Number
    q975: Number


class ForecastScore(Document):
    """How good the forecasts of one channel, lead time, risk, label and model version were."""

    channel: str = Field(examples=["t_inner_ring_c"])
    lead_time_s: int = Field(description="Seconds from the forecast to the measurement.")
    risk: Risk = Field(description=_RISK_TEXT)
    label: str | None = Field(
        description="Labels of the forecasts, joined by `; `; null without any.",
        examples=["load law from prior only"],
    )
    model_version: int
    n: int = Field(description="Readings that are scored.")
    set_aside: int = Field(description="Readings whose time has come and that are not scored.")
    set_aside_by: SetAside
    waiting: int = Field(description="Readings whose time has not come, or whose data have not.")
    left: int = Field(
        description="Of `set_aside`: readings whose plan was left, or whose sensor was lost above "
        "the 95 % band, and that are scored at the last minute that was followed. `n` is without "
        "them."
    )
    left_inside_95: int = Field(
        description="How many of these were inside the 95 % band then. The share that cannot be "
        "flattered: (`coverage_95` times `n` plus this) over (`n` plus `left`)."
    )
    whole_runs: int = Field(
        description="Runs from the forecast to this lead time, or to where the plan was left, of "
        "which it is known whether they stayed inside their band."
    )
    whole_runs_inside: int = Field(
        description="How many of these lay inside the band of the whole run with all their "
        "minutes; it states 90 % for the forecast's whole horizon."
    )
    independent_runs: int = Field(
        description="Among the `n` and `left` readings: forecasts of which no two overlap in time. "
        "Readings of forecasts that overlap are right or wrong together."
    )
    coverage_50: Number = Field(description="Share inside the 50 % band, 0 to 1; null: none yet.")
    coverage_95: Number = Field(description="Share inside the 95 % band, 0 to 1.")
    bias_k: Number = Field(description="Mean of median minus measured, K.")
    mae_k: Number = Field(description="Mean absolute error of the median, K.")
    crps_k: Number = Field(description="Continuous ranked probability score, K.")
    interval_score_k: Number = Field(description="Interval score of the 95 % band, K.")
    below: SharesBelow = Field(description="For a reliability diagram; null without any reading.")
    naive: dict[Naive, NaiveScore]


class ForecastPerformance(Document):
    """How good the kept forecasts of an asset were."""

    start: Time | None = Field(description="When the first of them was made; null without any.")
    forecasts: int = Field(description="How many there are.")
    items: list[ForecastScore] = Field(
        description="Only combinations that there are; by channel, lead time, risk, label, version."
    )


class InterruptedDocument(Document):
    """A reading at the last minute that was followed."""

    after_s: float = Field(description="Seconds since the forecast was made, middle of the minute.")
    measured_c: float = Field(description="Mean of that minute.")
    q025: float
    q975: float
    inside: bool = Field(description="Whether it was inside the 95 % band.")


class KeptReading(Document):
    """One channel of a forecast at one lead time, and what was measured then."""

    channel: str
    state: PointState = Field(
        description="`waiting` for its time or its data; `scored`; set aside: `plan`, `data` or "
        "`model`, as in `set_aside_by`."
    )
    q025: Number
    q25: Number
    q50: Number
    q75: Number
    q975: Number
    measured_c: Number = Field(
        description="Then, linear between the means of the good samples of the minutes around it."
    )
    naive: dict[Naive, Number] = Field(description="Simple forecasts of the same moment, °C.")
    left: InterruptedDocument | None = Field(
        description="Of one whose plan was left (`plan`), or whose sensor was lost above the band "
        "(`data`); null for all others, and for forecasts that an earlier release has kept."
    )
    run_inside: bool | None = Field(
        description="Whether all minutes up to this lead time, or up to `left`, lay inside the "
        "band of the whole run; null where that is not known."
    )


class KeptPoint(Document):
    """A forecast at one lead time."""

    lead_time_s: int
    time: Time
    risk: Risk = Field(description=_RISK_TEXT)
    readings: list[KeptReading]


class KeptForecast(Document):
    """A forecast that was kept, and what came of it."""

    id: int
    made_at: Time = Field(description="Process time of the state that it begins from.")
    reason: Reason = Field(
        description="Why it was kept: a `step` of the plan began, a `period` of ten minutes was "
        "over, another `model` version became active, somebody `asked` for it."
    )
    model_version: int
    planned: bool = Field(description="Whether it follows the controller's plan.")
    labels: list[str]
    profile: list[ForecastStep] = Field(description="What it assumed.")
    points: list[KeptPoint]


class KeptForecastList(Page):
    """Kept forecasts, the last that was kept first."""

    items: list[KeptForecast]


def kept_forecasts(page: ForecastPage, following: str | None) -> KeptForecastList:
    """Show a page of the ledger."""
    return KeptForecastList(items=[_kept(one) for one in page.items], next=following)


def _kept(stored: StoredForecast) -> KeptForecast:
    issued, content = stored.issued, stored.issued.content
    return KeptForecast(
        id=stored.id,
        made_at=rfc3339(issued.time_us),
        reason=issued.reason,
        model_version=issued.model_version,
        planned=content.planned,
        labels=content.labels,
        profile=[
            ForecastStep(duration_s=duration_s, speed_rpm=rpm, load_n=load_n, ambient_c=ambient_c)
            for duration_s, rpm, load_n, ambient_c in content.steps
        ],
        points=[
            KeptPoint(
                lead_time_s=lead_s,
                time=rfc3339(issued.time_us + lead_s * MICROSECONDS),
                risk=_risk(content.high_risk[number]),
                readings=[
                    _reading(stored, number, place) for place in range(len(content.channels))
                ],
            )
            for number, lead_s in enumerate(content.lead_times_s)
        ],
    )


def _reading(stored: StoredForecast, number: int, place: int) -> KeptReading:
    content = stored.issued.content
    q025, q25, q50, q75, q975 = (degrees(one) for one in content.quantiles[number][place])
    return KeptReading(
        channel=content.channels[place],
        state=stored.outcome.states[number][place],
        q025=q025,
        q25=q25,
        q50=q50,
        q75=q75,
        q975=q975,
        measured_c=stored.outcome.measured_c[number][place],
        naive={
            kind: degrees(content.naive[kind][number][place]) if kind in content.naive else None
            for kind in NAIVE
        },
        left=_interrupted(stored.outcome.interrupted_at(number, place)),
        run_inside=stored.outcome.run_at(number, place),
    )


def _interrupted(left: Interrupted | None) -> InterruptedDocument | None:
    if left is None:
        return None
    return InterruptedDocument(
        after_s=left.after_s,
        measured_c=left.measured_c,
        q025=left.low_c,
        q975=left.high_c,
        inside=left.is_inside,
    )


def _risk(high: bool) -> Risk:
    return "high" if high else "low"


def label_of(labels: Iterable[str]) -> str | None:
    """Bring the labels of a forecast into one text without figures, None without any."""
    words = (
        "initial state not well known" if one.startswith(_START_KNOWN) else one for one in labels
    )
    return "; ".join(dict.fromkeys(words)) or None


_Key = tuple[str, int, Risk, str, int]
_Alike = tuple[str, int, tuple[str, ...], tuple[int, ...], tuple[bool, ...]]
FloatArray = NDArray[np.float64]


@dataclass(slots=True)
class _Group:
    """Readings that are scored together, in arrays that follow each other."""

    quantiles_c: list[FloatArray] = field(default_factory=list)
    measured_c: list[FloatArray] = field(default_factory=list)
    naive_c: dict[Naive, list[FloatArray]] = field(
        default_factory=lambda: {kind: [] for kind in NAIVE}
    )
    states: Counter[PointState] = field(default_factory=Counter)
    #: Interrupted readings and whole runs by whether they were inside.
    left: Counter[bool] = field(default_factory=Counter)
    runs: Counter[bool] = field(default_factory=Counter)
    made_s: list[float] = field(default_factory=list)  # when forecasts of scored and left ones were


def forecast_performance(
    stored: Sequence[StoredForecast], lead_time_s: int | None = None, risk: Risk | None = None
) -> ForecastPerformance:
    """Score kept forecasts of one asset."""
    alike: defaultdict[_Alike, list[StoredForecast]] = defaultdict(list)
    for one in stored:
        content = one.issued.content
        alike[
            label_of(content.labels) or "",
            one.issued.model_version,
            tuple(content.channels),
            tuple(content.lead_times_s),
            tuple(content.high_risk),
        ].append(one)
    groups: defaultdict[_Key, _Group] = defaultdict(_Group)
    for (label, version, channels, leads, high_risk), forecasts in alike.items():
        readings = _Readings.of(forecasts)
        for number, (lead_s, high) in enumerate(zip(leads, high_risk, strict=True)):
            if lead_time_s in (None, lead_s) and risk in (None, _risk(high)):
                for place, channel in enumerate(channels):
                    key = channel, lead_s, _risk(high), label, version
                    readings.add_to(groups[key], number, place)
    return ForecastPerformance(
        start=time_or_none(min((one.issued.time_us for one in stored), default=None)),
        forecasts=len(stored),
        items=[_score(key, group) for key, group in sorted(groups.items())],
    )


@dataclass(frozen=True, slots=True)
class _Readings:
    """Readings of forecasts of the same form: forecast, lead time, channel, and what there is."""

    quantiles_c: FloatArray
    measured_c: FloatArray
    naive_c: Mapping[Naive, FloatArray]
    states: NDArray[np.str_]
    #: Interrupted readings and runs: 1 inside, 0 outside, -1 where there is none.
    left: NDArray[np.int8]
    runs: NDArray[np.int8]
    made_s: FloatArray  # (forecasts,)

    @classmethod
    def of(cls, forecasts: Sequence[StoredForecast]) -> "_Readings":
        contents = [one.issued.content for one in forecasts]
        outcomes = [one.outcome for one in forecasts]
        measured_c = np.array([one.measured_c for one in outcomes], np.float64)
        none = [[None] * measured_c.shape[2]] * measured_c.shape[1]
        return cls(
            all_degrees([one.quantiles for one in contents]),
            measured_c,
            {kind: all_degrees([one.naive.get(kind, none) for one in contents]) for kind in NAIVE},
            np.array([one.states for one in outcomes]),
            np.array([_each(one, _left_inside) for one in outcomes], np.int8),
            np.array([_each(one, Outcome.run_at) for one in outcomes], np.int8),
            np.array([one.issued.time_us for one in forecasts]) / MICROSECONDS,
        )

    def add_to(self, group: _Group, number: int, place: int) -> None:
        """Add the readings of a lead time and channel to a group."""
        states = self.states[:, number, place]
        group.states.update(states.tolist())
        scored = states == "scored"
        group.quantiles_c.append(self.quantiles_c[scored, number, place])
        group.measured_c.append(self.measured_c[scored, number, place])
        for kind, values_c in self.naive_c.items():
            group.naive_c[kind].append(values_c[scored, number, place])
        left, runs = self.left[:, number, place], self.runs[:, number, place]
        group.left.update((left[left >= 0] > 0).tolist())
        group.runs.update((runs[runs >= 0] > 0).tolist())
        group.made_s += self.made_s[scored | (left >= 0)].tolist()


def _each(outcome: Outcome, verdict: Callable[[Outcome, int, int], bool | None]) -> list[list[int]]:
    """1, 0 or -1 for each lead time and channel."""
    said = [
        [verdict(outcome, number, place) for place in range(len(row))]
        for number, row in enumerate(outcome.states)
    ]
    return [[-1 if one is None else int(one) for one in row] for row in said]


def _left_inside(outcome: Outcome, number: int, place: int) -> bool | None:
    left = outcome.interrupted_at(number, place)
    return None if left is None else left.is_inside


def _score(key: _Key, group: _Group) -> ForecastScore:
    channel, lead_s, risk, label, version = key
    quantiles_c, measured_c = (np.concatenate(of) for of in (group.quantiles_c, group.measured_c))
    known = ~np.isnan(quantiles_c).any(axis=1)
    scores = asdict(verify(quantiles_c[known], measured_c[known]))
    below = zip(SharesBelow.model_fields, scores.pop("below"), strict=True)
    by = group.states
    aside = SetAside(plan=by["plan"], data=by["data"], model=by["model"])
    return ForecastScore(
        channel=channel,
        lead_time_s=lead_s,
        risk=risk,
        label=label or None,
        model_version=version,
        n=scores.pop("n"),
        set_aside=aside.plan + aside.data + aside.model,
        set_aside_by=aside,
        waiting=by["waiting"],
        left=group.left.total(),
        left_inside_95=group.left[True],
        whole_runs=group.runs.total(),
        whole_runs_inside=group.runs[True],
        independent_runs=independent_runs(group.made_s, lead_s),
        **{name: _rounded(value) for name, value in scores.items()},
        below=SharesBelow(**{name: _rounded(share) for name, share in below}),
        naive={
            kind: _naive_score(np.concatenate(values_c), measured_c)
            for kind, values_c in group.naive_c.items()
        },
    )


def _naive_score(values_c: FloatArray, measured_c: FloatArray) -> NaiveScore:
    known = ~np.isnan(values_c)
    error_k = _rounded(mean_absolute_error(values_c[known], measured_c[known]))
    return NaiveScore(mae_k=error_k, crps_k=error_k)


def _rounded(value: float) -> float | None:
    return round(value, 5) if np.isfinite(value) else None
