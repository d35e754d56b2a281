"""The safe operating envelope of a running machine, computed when asked for and kept a while."""

import asyncio
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.clock import rfc3339
from service.domain.channels import label
from service.live.estimate import EstimatedState
from service.site.settings import AssetSection
from twin_core.forecasting.envelope import Envelope, LimitMap, envelope
from twin_core.forecasting.labels import NOT_IDENTIFIED

SPEEDS, LOADS = 20, 15
# The grid reaches well beyond the low-risk region, where the high-risk points are.
_BEYOND_SPEED, _BEYOND_LOAD = 1.6, 2.2
_MARGIN = 1.1
_SPEED_STEP_RPM, _LOAD_STEP_N = 50.0, 50.0
# What changes the maps no more than their intervals are wide.
_SAME_STATE_K = 1.0
_SAME_AMBIENT_K = 0.5
_SAME_REVOLUTIONS = 0.1
_SAME_COURSE = 0.1
LEAST_WALL_S = 10.0
LONGEST_S = 1800.0
QUANTILE_NAMES = ("q025", "q50", "q975")
LEVELS = ("warning", "alarm")


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    state: EstimatedState
    axes: tuple[NDArray[np.float64], NDArray[np.float64]]
    made_wall_s: float
    document: Mapping[str, Any]


class EnvelopeKeeper:
    """Computes an asset's envelope in a thread and keeps it until the machine has changed.

    Two callers at a time get one computation.

    Parameters
    ----------
    settings : AssetSection
        Low-risk region and limits.
    """

    def __init__(self, settings: AssetSection) -> None:
        self._settings = settings
        self._kept: _Kept | None = None
        self._computing = asyncio.Lock()

    async def document(
        self, state: EstimatedState, planned: Sequence[tuple[float, float]]
    ) -> Mapping[str, Any]:
        """Give the envelope as the REST interface shows it.

        Parameters
        ----------
        state : EstimatedState
            The machine at this moment.
        planned : sequence of (float, float)
            Speeds in rpm and loads in N that the grid must hold: of the plan ahead.
        """
        async with self._computing:
            point = state.point
            axes = grid(self._settings, [*planned, (point.speed_rpm, point.load_n)])
            kept = self._kept
            if kept is None or not self._holds(kept, state, axes):
                begun_s = time.monotonic()
                document = await asyncio.to_thread(self._compute, state, axes)
                kept = self._kept = _Kept(state, axes, begun_s, document)
        return dict(kept.document) | {
            "present": {"speed_rpm": round(point.speed_rpm, 1), "load_n": round(point.load_n, 1)}
        }

    @staticmethod
    def _holds(
        kept: _Kept,
        state: EstimatedState,
        axes: tuple[NDArray[np.float64], NDArray[np.float64]],
    ) -> bool:
        if kept.state.active is not state.active:
            return False
        if any(
            not np.array_equal(before, after) for before, after in zip(kept.axes, axes, strict=True)
        ):
            return False
        if time.monotonic() - kept.made_wall_s < LEAST_WALL_S:
            return True
        before, after = kept.state.machine, state.machine
        return (
            abs(state.time_us - kept.state.time_us) < LONGEST_S * 1e6
            and float(np.max(np.abs(after.temperatures_c - before.temperatures_c))) <= _SAME_STATE_K
            and abs(after.ambient_c - before.ambient_c) <= _SAME_AMBIENT_K
            and abs(after.course_known - before.course_known) <= _SAME_COURSE
            and abs(after.revolutions - before.revolutions)
            <= _SAME_REVOLUTIONS * max(before.revolutions, 1e5)
        )

    def _compute(
        self, state: EstimatedState, axes: tuple[NDArray[np.float64], NDArray[np.float64]]
    ) -> Mapping[str, Any]:
        active = state.active
        sensors = active.model.sensor_names
        limits = {
            name: (pair.warning, pair.alarm)
            for name, pair in self._settings.limits.items()
            if name in sensors
        }
        found = envelope(active.model, active.posterior, state.machine, *axes, limits)
        labels = [] if active.posterior.identified else [NOT_IDENTIFIED]
        return envelope_json(found) | {
            "made_at": rfc3339(state.time_us),
            "model_version": active.version,
            "low_risk": self._settings.low_risk.model_dump(),
            "labels": labels,
        }


def with_measured(
    document: Mapping[str, Any], measured_c: Mapping[str, float | None]
) -> dict[str, Any]:
    """Put next to the map what is measured at the present point, and say where the map is too low.

    Parameters
    ----------
    document : mapping
        The envelope as the REST interface shows it.
    measured_c : mapping of str to float or None
        Good and fresh readings by sensor.
    """
    present = document["present"]
    row = _nearest(document["load_n"], present["load_n"])
    column = _nearest(document["speed_rpm"], present["speed_rpm"])
    labels = list(document["labels"])
    for name, value_c in measured_c.items():
        maps = document["sensors"][name]
        expected_c = maps["steady_c"]["q50"][row][column]
        for level in ("alarm", "warning"):
            limit_c = maps["limits"].get(level, {}).get("limit_c")
            if value_c is None or limit_c is None or expected_c is None:
                continue
            if value_c >= limit_c > expected_c:
                labels.append(
                    f"{label(name)} measured {value_c:.1f} °C at the present point, over {level} "
                    f"{limit_c:g} °C: the map shows {expected_c:.1f} °C there"
                )
                break
    return dict(document) | {"labels": labels, "present": present | {"measured_c": measured_c}}


def _nearest(axis: Sequence[float], value: float) -> int:
    return min(range(len(axis)), key=lambda index: abs(axis[index] - value))


def grid(
    settings: AssetSection, points: Sequence[tuple[float, float]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Axes of the map: 20 speeds in rpm and 15 loads in N, in steps of whole fifties.

    Parameters
    ----------
    settings : AssetSection
        Its low-risk region.
    points : sequence of (float, float)
        Speeds and loads that must lie inside.
    """
    region = settings.low_risk
    speed_rpm = max(
        _BEYOND_SPEED * region.speed_rpm_max, _MARGIN * max((s for s, _ in points), default=0.0)
    )
    load_n = max(
        _BEYOND_LOAD * region.load_n_max, _MARGIN * max((f for _, f in points), default=0.0)
    )
    return (
        _axis(speed_rpm, SPEEDS, _SPEED_STEP_RPM),
        _axis(load_n, LOADS, _LOAD_STEP_N),
    )


def _axis(highest: float, count: int, unit: float) -> NDArray[np.float64]:
    step = max(math.ceil(highest / count / unit - 1e-9), 1) * unit
    return np.asarray(step * np.arange(1, count + 1))


def envelope_json(found: Envelope) -> dict[str, Any]:
    """An envelope as plain JSON types: matrices have one row per load, one column per speed."""
    return {
        "speed_rpm": found.speed_rpm.tolist(),
        "load_n": found.load_n.tolist(),
        "ambient_c": round(found.ambient_c, 2),
        "horizon_s": found.horizon_s,
        "members": found.members,
        "sensors": {
            name: {
                "steady_c": {
                    quantile: _matrix(found.steady_c[name][row], 2)
                    for row, quantile in enumerate(QUANTILE_NAMES)
                },
                "limits": {
                    level: _limit_json(limit)
                    for level, limit in zip(LEVELS, found.limits[name], strict=False)
                },
            }
            for name in found.sensors
        },
        "runaway": {
            "probability": _matrix(found.runaway_probability, 4),
            "not_excluded": found.runaway_not_excluded.tolist(),
        },
    }


def _limit_json(limit: LimitMap) -> dict[str, Any]:
    return {
        "limit_c": limit.limit_c,
        "probability": _matrix(limit.probability, 4),
        "steady_probability": _matrix(limit.steady_probability, 4),
        "median_s": _matrix(limit.median_s, 0),
        "earliest_s": _matrix(limit.earliest_s, 0),
    }


def _matrix(values: NDArray[np.float64], digits: int) -> list[list[float | None]]:
    """Rows of rounded numbers; what is not finite (never crossed) is null."""
    return [
        [value if math.isfinite(value) else None for value in row]
        for row in np.round(values, digits).tolist()
    ]
