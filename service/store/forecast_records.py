"""Forecasts that are kept to be compared with what comes: as the store takes and gives them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

Reason = Literal["step", "period", "model", "asked"]
"""Why a forecast was kept: a step of the plan began, ten minutes went by, another model version
became active, somebody asked for it."""
PointState = Literal["waiting", "scored", "plan", "data", "model"]
"""What became of a forecast reading: its time has not come; it is compared with a measurement; or
it is set aside, since the plan was not followed, the data are missing, or the model version is
gone.
"""
SET_ASIDE: Final[tuple[PointState, ...]] = ("plan", "data", "model")
_HUNDREDTHS: Final = 100.0


class IssuedContent(msgspec.Struct, frozen=True, array_like=True):
    """What a forecast said; temperatures in 0.01 degC, None where there is none.

    Attributes
    ----------
    steps
        (k,) duration_s, speed_rpm, load_n and ambient_c of each step that it assumed.
    planned
        Whether it followed the controller's plan.
    labels
        What was said along with it.
    channels
        (c,) sensors.
    lead_times_s
        (l,) seconds from its time.
    high_risk
        (l,) whether the steps up to then leave the low-risk region.
    quantiles
        (l, c, 5).
    naive
        (l, c) by kind of simple forecast.
    """

    steps: list[tuple[float, float, float, float]]
    planned: bool
    labels: list[str]
    channels: list[str]
    lead_times_s: list[int]
    high_risk: list[bool]
    quantiles: list[list[list[int | None]]]
    naive: dict[str, list[list[int | None]]]


class IssuedForecast(msgspec.Struct, frozen=True, array_like=True):
    """A forecast to be kept; ``time_us`` is the process time of the state that it begins from."""

    asset: str
    time_us: int
    model_version: int
    reason: Reason
    content: IssuedContent


class Outcome(msgspec.Struct, frozen=True, array_like=True):
    """What came of a forecast: (l, c) states and measured temperatures in degC."""

    states: list[list[PointState]]
    measured_c: list[list[float | None]]

    @classmethod
    def waiting(cls, content: IssuedContent) -> "Outcome":
        """Of a forecast none of whose times has come."""
        count = len(content.channels)
        return cls(
            [["waiting"] * count for _ in content.lead_times_s],
            [[None] * count for _ in content.lead_times_s],
        )


@dataclass(frozen=True, slots=True)
class StoredForecast:
    """A kept forecast as it is in the store.

    Attributes
    ----------
    id
        Numbers the forecasts in the order in which they were kept.
    issued, outcome
        What it said, and what came of it so far.
    due_us
        When the next of its readings is due; None when there is no other.
    has_model
        Whether the store has its model version.
    """

    id: int
    issued: IssuedForecast
    outcome: Outcome
    due_us: int | None
    has_model: bool = True


@dataclass(frozen=True, slots=True)
class Settled:
    """What a look at a due forecast found: written only where it is due as it was then."""

    id: int
    was_due_us: int
    due_us: int | None
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class ForecastPage:
    """Kept forecasts, newest first."""

    items: Sequence[StoredForecast]
    next_cursor: int | None


def hundredths(value: float | None) -> int | None:
    """Write a temperature as it is kept; None for what is not finite."""
    if value is None or not abs(value) < 1e6:
        return None
    return round(_HUNDREDTHS * value)


def degrees(value: int | None) -> float | None:
    """Read a temperature that `hundredths` wrote."""
    return None if value is None else value / _HUNDREDTHS


def all_degrees(values: object) -> NDArray[np.float64]:
    """Read nested lists of what `hundredths` wrote; NaN where there is none."""
    return np.array(values, np.float64) / _HUNDREDTHS
