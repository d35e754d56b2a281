"""Forecasts that are kept to be compared with what comes: what is kept, and how it is read.

A feature keeps them (see `ForecastRecords`); others read them, such as the report of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from service.store.part import StorePart

Reason = Literal["step", "period", "model", "asked"]
"""Why a forecast was kept: a step of the plan began, ten minutes went by, another model version
became active, a user asked for it."""
PointState = Literal["waiting", "scored", "plan", "data", "model"]
"""What became of a forecast reading: its time has not come; it is compared with a measurement; or
it is set aside, since the plan was not followed, the data are missing, or the model version is
gone.
"""
SET_ASIDE: Final[tuple[PointState, ...]] = ("plan", "data", "model")
_HUNDREDTHS: Final = 100.0


class IssuedContent(msgspec.Struct, frozen=True, array_like=True):
    """What a forecast said; temperatures in 0.01 degC, None where there is none.

    - ``steps``: (k,) duration_s, speed_rpm, load_n and ambient_c of each step that it assumed.
    - ``planned``: whether it followed the controller's plan.
    - ``labels``: what was said along with it.
    - ``channels``: (c,) sensors.
    - ``lead_times_s``: (l,) seconds from its time.
    - ``high_risk``: (l,) whether the steps up to then leave the low-risk region.
    - ``quantiles``: (l, c, 5).
    - ``naive``: (l, c) by kind of simple forecast.
    - ``band_times_s``, ``bands``: (m,) times, and (m, c, 4) edges of the 95 % band and of the band
      of the whole run at them; linear between them. Forecasts of earlier releases have none.
    """

    steps: list[tuple[float, float, float, float]]
    planned: bool
    labels: list[str]
    channels: list[str]
    lead_times_s: list[int]
    high_risk: list[bool]
    quantiles: list[list[list[int | None]]]
    naive: dict[str, list[list[int | None]]]
    band_times_s: list[float] = []
    bands: list[list[list[int | None]]] = []


class IssuedForecast(msgspec.Struct, frozen=True, array_like=True):
    """A forecast to be kept; ``time_us`` is the process time of the state that it begins from."""

    asset: str
    time_us: int
    model_version: int
    reason: Reason
    content: IssuedContent


class Interrupted(msgspec.Struct, frozen=True, array_like=True):
    """A reading when its plan was followed last: seconds since the forecast, degC."""

    after_s: float
    measured_c: float
    low_c: float
    high_c: float

    @property
    def is_inside(self) -> bool:
        """Whether it was measured inside the 95 % band."""
        return self.low_c <= self.measured_c <= self.high_c


class Outcome(msgspec.Struct, frozen=True, array_like=True):
    """What came of a forecast, (l, c).

    - ``states``, ``measured_c``: what became of each reading, and the temperature in degC.
    - ``interrupted``: of readings whose plan was left, or whose sensor was lost above the band.
    - ``runs``: whether all minutes up to then lay in the band of the whole run; None: not known.

    The last two are empty where an earlier release has settled all readings.
    """

    states: list[list[PointState]]
    measured_c: list[list[float | None]]
    interrupted: list[list[Interrupted | None]] = []
    runs: list[list[bool | None]] = []

    @classmethod
    def waiting(cls, content: IssuedContent) -> "Outcome":
        """Of a forecast none of whose times has come."""
        count = len(content.channels)
        return cls(
            [["waiting"] * count for _ in content.lead_times_s],
            [[None] * count for _ in content.lead_times_s],
        )

    def interrupted_at(self, number: int, place: int) -> Interrupted | None:
        """Give an interrupted reading by lead time and channel; None where it is none."""
        return self.interrupted[number][place] if self.interrupted else None

    def run_at(self, number: int, place: int) -> bool | None:
        """Say whether a run up to a lead time lay inside its band; None: not known."""
        return self.runs[number][place] if self.runs else None


@dataclass(frozen=True, slots=True)
class StoredForecast:
    """A kept forecast as it is in the store.

    - ``id``: numbers the forecasts in the order in which they were kept.
    - ``issued``, ``outcome``: what it said, and what came of it so far.
    - ``due_us``: when the next of its readings is due; None when there is no other.
    - ``has_model``: whether the store has its model version.
    """

    id: int
    issued: IssuedForecast
    outcome: Outcome
    due_us: int | None
    has_model: bool = True


@dataclass(frozen=True, slots=True)
class ForecastPage:
    """Kept forecasts, newest first."""

    items: Sequence[StoredForecast]
    next_cursor: int | None


class ForecastRecords(StorePart):
    """The kept forecasts, for all who read them; none where no feature keeps any.

    The feature that keeps them has a part of the store that derives from this one.
    """

    def page(self, asset: str, limit: int, cursor: int | None = None) -> ForecastPage:
        """Part of the forecasts of an asset, the last that was kept first."""
        return ForecastPage((), None)

    def since(
        self, asset: str, start_us: int, version: int | None = None, end_us: int | None = None
    ) -> list[StoredForecast]:
        """All forecasts of an asset made from a time on, of one model version or of all.

        With an end, those made before it.
        """
        return []


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
