"""The forecast ledger: kept forecasts with what came of them, and how good they were."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
from pydantic import Field

from service.clock import MICROSECONDS, rfc3339
from service.documents.base import Document, Number, Page, Time, time_or_none
from service.documents.profiles import ForecastStep
from service.store.forecast_records import (
    ForecastPage,
    PointState,
    Reason,
    StoredForecast,
    degrees,
)
from twin_core.scores import mean_absolute_error
from twin_core.verification import verify

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
    measured_c: Number = Field(description="Mean of the good samples in the minute around then.")
    naive: dict[Naive, Number] = Field(description="Simple forecasts of the same moment, °C.")


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
    )


def _risk(high: bool) -> Risk:
    return "high" if high else "low"


def label_of(labels: Iterable[str]) -> str | None:
    """Bring the labels of a forecast into one text without figures, None without any."""
    words = (
        "initial state not well known" if one.startswith(_START_KNOWN) else one for one in labels
    )
    return "; ".join(dict.fromkeys(words)) or None


@dataclass(slots=True)
class _Group:
    """Readings that are scored together."""

    quantiles_c: list[Sequence[float | None]] = field(default_factory=list)
    measured_c: list[float | None] = field(default_factory=list)
    naive_c: dict[Naive, list[float | None]] = field(
        default_factory=lambda: {kind: [] for kind in NAIVE}
    )
    states: defaultdict[PointState, int] = field(default_factory=lambda: defaultdict(int))


_Key = tuple[str, int, Risk, str, int]


def forecast_performance(
    stored: Sequence[StoredForecast], lead_time_s: int | None = None, risk: Risk | None = None
) -> ForecastPerformance:
    """Score kept forecasts of one asset.

    Parameters
    ----------
    stored
        The forecasts.
    lead_time_s, risk
        Only these; None for all.
    """
    groups: defaultdict[_Key, _Group] = defaultdict(_Group)
    for one in stored:
        content = one.issued.content
        label = label_of(content.labels) or ""
        for number, lead_s in enumerate(content.lead_times_s):
            of_risk = _risk(content.high_risk[number])
            if lead_time_s not in (None, lead_s) or risk not in (None, of_risk):
                continue
            for place, channel in enumerate(content.channels):
                key = channel, lead_s, of_risk, label, one.issued.model_version
                _add(groups[key], one, number, place)
    return ForecastPerformance(
        start=time_or_none(min((one.issued.time_us for one in stored), default=None)),
        forecasts=len(stored),
        items=[_score(key, group) for key, group in sorted(groups.items())],
    )


def _add(group: _Group, stored: StoredForecast, number: int, place: int) -> None:
    state = stored.outcome.states[number][place]
    group.states[state] += 1
    if state != "scored":
        return
    content = stored.issued.content
    group.quantiles_c.append([degrees(one) for one in content.quantiles[number][place]])
    group.measured_c.append(stored.outcome.measured_c[number][place])
    for kind, values_c in group.naive_c.items():
        of_kind = content.naive.get(kind)
        values_c.append(None if of_kind is None else degrees(of_kind[number][place]))


def _score(key: _Key, group: _Group) -> ForecastScore:
    channel, lead_s, risk, label, version = key
    quantiles_c = np.array(group.quantiles_c, np.float64).reshape(-1, 5)
    measured_c = np.array(group.measured_c, np.float64)
    known = ~np.isnan(quantiles_c).any(axis=1)
    scores = asdict(verify(quantiles_c[known], measured_c[known]))
    below = zip(SharesBelow.model_fields, scores.pop("below"), strict=True)
    by: Mapping[PointState, int] = group.states
    aside = SetAside(plan=by.get("plan", 0), data=by.get("data", 0), model=by.get("model", 0))
    return ForecastScore(
        channel=channel,
        lead_time_s=lead_s,
        risk=risk,
        label=label or None,
        model_version=version,
        n=scores.pop("n"),
        set_aside=aside.plan + aside.data + aside.model,
        set_aside_by=aside,
        waiting=by.get("waiting", 0),
        **{name: _rounded(value) for name, value in scores.items()},
        below=SharesBelow(**{name: _rounded(share) for name, share in below}),
        naive={
            kind: _naive_score(np.array(values_c, np.float64), measured_c)
            for kind, values_c in group.naive_c.items()
        },
    )


def _naive_score(
    values_c: np.ndarray[tuple[int], np.dtype[np.float64]],
    measured_c: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> NaiveScore:
    known = ~np.isnan(values_c)
    error_k = _rounded(mean_absolute_error(values_c[known], measured_c[known]))
    return NaiveScore(mae_k=error_k, crps_k=error_k)


def _rounded(value: float) -> float | None:
    return round(value, 5) if np.isfinite(value) else None
