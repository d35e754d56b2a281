"""The safe operating envelope: steady temperatures and times to the limits over speed and load."""

import math
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from service.documents.base import Document, Number, Time
from service.documents.limits import Level, LowRisk
from service.documents.profiles import OperatingPoint

if TYPE_CHECKING:  # web and plant side show envelopes, and never compute one
    from twin_core.forecasting import envelope

Matrix = Annotated[
    list[list[Number]],
    Field(description="One row per load, one column per speed.", examples=[[[41.2, 44.9]]]),
]
_LEVELS: tuple[Level, ...] = ("warning", "alarm")


class SteadyMap(Document):
    """Quantiles of what the sensor will read in the steady state, °C; 500 where it runs away."""

    q025: Matrix
    q50: Matrix
    q975: Matrix


class LimitMap(Document):
    """When and how probably a limit is reached, each point held from the present state."""

    limit_c: float = Field(description="°C", examples=[90])
    probability: Matrix = Field(
        description="Share of the members that reach it within the horizon."
    )
    steady_probability: Matrix = Field(
        description="Probability that the steady state is at or over it, smooth over the map."
    )
    median_s: Matrix = Field(
        description="Seconds until half of the members have reached it; null where fewer do."
    )
    earliest_s: Matrix = Field(
        description="Seconds until 2.5 % of the members have reached it; null where fewer do."
    )


class SensorMaps(Document):
    """Maps of one sensor; `limits` holds `warning` and `alarm`, or nothing if it has none."""

    steady_c: SteadyMap
    limits: dict[Level, LimitMap]


class RunawayMap(Document):
    """Thermal runaway: beyond the limit (130 °C of a bearing), or without a steady state."""

    probability: Matrix = Field(
        description="That the machine runs away, held at the point: of the default model from how "
        "much hotter the inner ring gets than the outer one, which takes up clearance; else, and "
        "before any identification, the share of the members that run away."
    )
    not_excluded: list[list[bool]] = Field(
        description="True where the probability is above 5 %, the upper edge passes 110 °C, or the "
        "load is beyond 2.1 times what the data hold; of other models 100 °C, 1.5 times, or one "
        "member that runs away."
    )
    loop_gain: Matrix = Field(
        description="Heat that a rise gives back over heat that it carries away, median of the "
        "members; a machine runs away above 1. Null where half of the members run away."
    )
    loop_gain_upper: Matrix = Field(
        description="The same, 97.5 % of the members; null where so many run away."
    )
    margin_k: Matrix = Field(
        description="How much hotter the hottest sensor may become until the loop gain is 1 or the "
        "limit (130 °C of a bearing) is passed: 95 % of the members have more, K. Null where there "
        "is no limit."
    )
    margin_n: Matrix = Field(
        description="How much more load until the probability is 5 %, N; negative where it is more "
        "already. Null where no load of the map is as bad."
    )


class PresentPoint(OperatingPoint):
    """Where the machine is now, and what is measured there."""

    measured_c: dict[str, Number] = Field(
        description="Good and fresh readings by sensor, °C; `labels` say where the map is low.",
    )
    over_limit: dict[str, dict[Level, Number]] = Field(
        description="Probability that the sensor is at or over each limit here: 1 where it is "
        "measured so now, whatever the map shows; else `steady_probability` of the nearest point.",
        examples=[{"t_inner_ring_c": {"warning": 1.0, "alarm": 0.02}}],
    )


class EnvelopeMaps(Document):
    """What is computed over speed and load, and kept until the machine has changed."""

    made_at: Time
    model_version: int
    ambient_c: float = Field(description="Assumed to stay, °C.", examples=[23.1])
    horizon_s: float = Field(
        description="How long each point is held for the times, s.", examples=[28800]
    )
    members: int = Field(description="Of the ensemble.", examples=[80])
    speed_rpm: list[float] = Field(description="Columns of all maps.", examples=[[350, 700]])
    load_n: list[float] = Field(description="Rows of all maps.", examples=[[450, 900]])
    sensors: dict[str, SensorMaps]
    runaway: RunawayMap
    low_risk: LowRisk
    labels: list[str] = Field(
        description="What the result rests on.",
        examples=[["not identified yet: prior parameters only"]],
    )


class EnvelopeDocument(EnvelopeMaps):
    """Steady temperatures and times to the limits over speed and load."""

    present: PresentPoint


def envelope_maps(
    found: "envelope.Envelope",
    *,
    made_at: str,
    model_version: int,
    low_risk: LowRisk,
    labels: list[str],
) -> EnvelopeMaps:
    """Show an envelope; matrices have one row per load, one column per speed."""
    return EnvelopeMaps(
        made_at=made_at,
        model_version=model_version,
        ambient_c=round(found.ambient_c, 2),
        horizon_s=found.horizon_s,
        members=found.members,
        speed_rpm=found.speed_rpm.tolist(),
        load_n=found.load_n.tolist(),
        sensors={
            name: SensorMaps(
                steady_c=SteadyMap(
                    **{
                        quantile: _matrix(found.steady_c[name][row], 2)
                        for row, quantile in enumerate(SteadyMap.model_fields)
                    }
                ),
                limits={
                    level: _limit_map(limit)
                    for level, limit in zip(_LEVELS, found.limits[name], strict=False)
                },
            )
            for name in found.sensors
        },
        runaway=RunawayMap(
            probability=_matrix(found.runaway_probability, 4),
            not_excluded=found.runaway_not_excluded.tolist(),
            loop_gain=_matrix(found.loop_gain[0], 3),
            loop_gain_upper=_matrix(found.loop_gain[1], 3),
            margin_k=_matrix(found.margin_k, 1),
            margin_n=_matrix(found.margin_n, 0),
        ),
        low_risk=low_risk,
        labels=labels,
    )


def _limit_map(limit: "envelope.LimitGrid") -> LimitMap:
    return LimitMap(
        limit_c=limit.limit_c,
        probability=_matrix(limit.probability, 4),
        steady_probability=_matrix(limit.steady_probability, 4),
        median_s=_matrix(limit.median_s, 0),
        earliest_s=_matrix(limit.earliest_s, 0),
    )


def _matrix(values: NDArray[np.float64], digits: int) -> list[list[float | None]]:
    """Rows of rounded numbers; what is not finite (never crossed) is null."""
    return [
        [value if math.isfinite(value) else None for value in row]
        for row in np.round(values, digits).tolist()
    ]
