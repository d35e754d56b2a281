"""Forecasts: the live one, and what-ifs."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SkipValidation

from service.documents.base import Document, Number, Time
from service.documents.limits import Crossings, Limits
from service.documents.profiles import ForecastStep, OperatingPoint
from twin_core.scores import WHOLE_RUN_LEVEL

if TYPE_CHECKING:  # web and plant side show forecasts, and never compute one
    from twin_core.forecasting import Forecast, runaway

#: Quantiles are shown to 0.01 K.
QUANTILE_DECIMALS = 2

# Two days in all nodes are a hundred thousand figures: they are not checked one by one.
Percentiles = Annotated[
    SkipValidation[list[Number]], Field(description="One temperature per time, °C.")
]


class Quantiles(Document):
    """Quantiles of a temperature over time: of the measured value for sensors, else of the true."""

    q025: Percentiles
    q25: Percentiles
    q50: Percentiles
    q75: Percentiles
    q975: Percentiles


class WholeRun(Document):
    """Bands that a whole run stays inside, beside those of each moment (`nodes`)."""

    level: float = Field(
        gt=0,
        lt=1,
        description="Probability that all readings at `time_s`, from the first to the last, lie "
        "inside the band of a sensor.",
    )
    factors: dict[str, Percentiles] = Field(
        description="By sensor that was asked for, at `time_s`: the band reaches from "
        "q50 - factor * (q50 - q025) to q50 + factor * (q975 - q50).",
    )


class RunawayMargin(OperatingPoint):
    """How far the machine is from a thermal runaway, held for hours at this point."""

    probability: float = Field(
        ge=0, le=1, description="That it runs away, held here for 8 h.", examples=[0.02]
    )
    loop_gain: Number = Field(
        description="Heat that a rise gives back over heat that it carries away, median of the "
        "members; a machine runs away above 1. Null where half of the members run away.",
        examples=[0.31],
    )
    loop_gain_upper: Number = Field(
        description="The same, 97.5 % of the members; null where so many run away.", examples=[0.52]
    )
    margin_k: Number = Field(
        description="How much hotter the hottest sensor may become until the loop gain is 1 or the "
        "limit (130 °C of a bearing) is passed, K; null where there is no limit.",
        examples=[24.1],
    )
    margin_n: Number = Field(
        description="How much more load until the probability is 5 %, N; negative where it is more "
        "already. Null where twice the load is not as bad.",
        examples=[1900],
    )


class ForecastDocument(Document):
    """Temperatures over a profile, and when limits are exceeded."""

    time_s: list[float] = Field(description="Seconds from the present moment.")
    nodes: dict[str, Quantiles] = Field(description="By sensor and node.")
    whole_run: WholeRun
    limits: dict[str, Limits]
    not_known: dict[str, str] = Field(
        description="Nodes without a sensor whose temperature the model does not know well enough, "
        "and why: by node. Their quantiles are no forecast to act on.",
        examples=[{"t_node_7_c": "±14 K: no sensor shows it"}],
    )
    time_to_limit: Crossings = Field(description="By sensor and level.")
    labels: list[str] = Field(
        description="What the result rests on.", examples=[["load law from prior only"]]
    )
    runaway_probability: float = Field(
        ge=0,
        le=1,
        description="That the machine runs away thermally; see `runaway` of the envelope.",
    )
    runaway_margin: RunawayMargin | None = Field(
        default=None,
        description="The margin at the heaviest point of the profile (speed times load). Null "
        "before the first identification, for a network without limits of a runaway, and where "
        "nothing but standing or no load lies ahead.",
    )


class WhatIf(ForecastDocument):
    """A forecast of the asked-for sensors and nodes."""

    model_version: int
    profile: list[ForecastStep] = Field(description="What the forecast follows.")
    missing: list[str] = Field(
        description="Speed, load and ambient without a usable value now; with any of them "
        "the forecast starts from an uncertain state.",
    )


class WhatIfAnswer(WhatIf):
    """A what-if, and whether it was kept."""

    kept_at: Time | None = Field(
        description="Process time of the state that it begins from, where it is kept; else null."
    )


class LiveForecast(WhatIf):
    """The latest live forecast: of the controller's plan, else of the present point held."""

    made_at: Time = Field(description="Process time of the state that it begins from.")
    intervals_made_at: Time = Field(
        description="Process time of the state that the widths of the intervals are of. Earlier "
        "than `made_at`, by 15 minutes at most, where the machine goes on at its operating point "
        "far from its limits; the medians are always of `made_at`."
    )
    planned: bool = Field(description="Whether it follows the controller's plan.")


def not_known_reason(half_k: float) -> str:
    """Why a node is not known: half its 95 % band in K."""
    return f"±{half_k:.0f} K: no sensor shows it"


def quantiles_document(
    forecast: "Forecast", names: Sequence[str] | None = None
) -> dict[str, Quantiles]:
    """Quantiles by sensor and node, rounded to 0.01 K."""
    wanted = forecast.names if names is None else names
    rows = [forecast.names.index(name) for name in wanted]
    # By name, quantile and time.
    values = _shown(forecast.quantiles[:, :, rows].transpose(2, 0, 1))
    return {
        name: Quantiles(**dict(zip(Quantiles.model_fields, of_name, strict=True)))
        for name, of_name in zip(wanted, values, strict=True)
    }


def whole_run_document(forecast: "Forecast", names: Sequence[str] | None = None) -> WholeRun:
    """Bands that a whole run stays inside, as factors to 0.001; parameters as above."""
    factors = np.round(forecast.whole_run_factor, 3).T.tolist()
    return WholeRun(
        level=WHOLE_RUN_LEVEL,
        factors={
            name: of_sensor
            for name, of_sensor in zip(forecast.sensors, factors, strict=True)
            if names is None or name in names
        },
    )


def _shown(values_c: NDArray[np.floating]) -> list[list[list[Number]]]:
    """Temperatures (names, k, n) to 0.01 K; null where one is not finite."""
    rounded = np.round(values_c.astype(np.float64), QUANTILE_DECIMALS)
    values: list[list[list[Number]]] = rounded.tolist()
    if np.isfinite(rounded).all():
        return values
    return [
        [[None if one is None or not math.isfinite(one) else one for one in row] for row in rows]
        for rows in values
    ]


def forecast_document(
    forecast: "Forecast",
    limits: Mapping[str, Limits],
    crossings: Crossings,
    margin: "runaway.RunawayDistance | None",
    names: Sequence[str] | None = None,
) -> ForecastDocument:
    """Show a forecast."""
    return ForecastDocument(
        time_s=np.round(forecast.time_s, 3).tolist(),
        nodes=quantiles_document(forecast, names),
        whole_run=whole_run_document(forecast, names),
        limits=dict(limits),
        not_known={
            name: not_known_reason(half_k)
            for name, half_k in forecast.not_known.items()
            if names is None or name in names
        },
        time_to_limit=crossings,
        labels=list(forecast.labels),
        runaway_probability=float(forecast.runaway_probability),
        runaway_margin=margin_document(margin),
    )


def margin_document(margin: "runaway.RunawayDistance | None") -> RunawayMargin | None:
    """Show a margin to a thermal runaway; null for none, and for figures that are not finite."""
    if margin is None:
        return None

    def shown(value: float, digits: int) -> float | None:
        return round(value, digits) if math.isfinite(value) else None

    return RunawayMargin(
        speed_rpm=round(margin.speed_rpm, 1),
        load_n=round(margin.load_n, 1),
        probability=round(margin.probability, 4),
        loop_gain=shown(margin.loop_gain, 3),
        loop_gain_upper=shown(margin.loop_gain_upper, 3),
        margin_k=shown(margin.margin_k, 1),
        margin_n=shown(margin.margin_n, 0),
    )
