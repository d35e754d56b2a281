"""The safe operating envelope of a running machine, computed when asked for and kept a while."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.clock import rfc3339
from service.documents.envelope import (
    EnvelopeDocument,
    EnvelopeMaps,
    PresentPoint,
    envelope_maps,
)
from service.documents.limits import Level, LowRisk
from service.domain.channels import label
from service.live.estimate import EstimatedState
from service.site.asset_section import AssetSection
from twin_core.forecasting.envelope import envelope
from twin_core.forecasting.labels import NOT_IDENTIFIED
from twin_core.profiles import Point

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
_LEVELS: tuple[Level, ...] = ("alarm", "warning")
LEAST_WALL_S = 10.0
LONGEST_S = 1800.0


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    state: EstimatedState
    axes: tuple[NDArray[np.float64], NDArray[np.float64]]
    made_wall_s: float
    maps: EnvelopeMaps


class EnvelopeKeeper:
    """Computes an asset's envelope and keeps it until the machine has changed.

    Parameters
    ----------
    settings : AssetSection
        Low-risk region and limits.
    """

    def __init__(self, settings: AssetSection) -> None:
        self._settings = settings
        self._kept: _Kept | None = None

    def document(
        self,
        state: EstimatedState,
        planned: Sequence[tuple[float, float]],
        measured_c: Mapping[str, float | None],
    ) -> EnvelopeDocument:
        """Give the envelope, with maps that are kept or computed now.

        Parameters
        ----------
        state : EstimatedState
            The machine at this moment.
        planned : sequence of (float, float)
            Speeds in rpm and loads in N that the grid must hold: of the plan ahead.
        measured_c : mapping of str to float or None
            Good and fresh readings by sensor.
        """
        point = state.point
        axes = grid(self._settings, [*planned, (point.speed_rpm, point.load_n)])
        kept = self._kept
        if kept is None or not self._holds(kept, state, axes):
            begun_s = time.monotonic()
            kept = self._kept = _Kept(state, axes, begun_s, self._compute(state, axes))
        return with_present(kept.maps, point, measured_c)

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
    ) -> EnvelopeMaps:
        active = state.active
        sensors = active.model.sensor_names
        limits = {
            name: (pair.warning, pair.alarm)
            for name, pair in self._settings.limits.items()
            if name in sensors
        }
        found = envelope(active.model, active.posterior, state.machine, *axes, limits)
        labels = [] if active.posterior.identified else [NOT_IDENTIFIED]
        return envelope_maps(
            found,
            made_at=rfc3339(state.time_us),
            model_version=active.version,
            low_risk=LowRisk(**self._settings.low_risk.model_dump()),
            labels=labels,
        )


def with_present(
    maps: EnvelopeMaps,
    point: Point,
    measured_c: Mapping[str, float | None],
) -> EnvelopeDocument:
    """Add the present point with what is measured there, and say where the map is too low.

    A reading over a limit outweighs the map at this point: it is rated over the limit.

    Parameters
    ----------
    maps : EnvelopeMaps
        What was computed.
    point : Point
        Where the machine is now.
    measured_c : mapping of str to float or None
        Good and fresh readings by sensor.
    """
    row = _nearest(maps.load_n, point.load_n)
    column = _nearest(maps.speed_rpm, point.speed_rpm)
    present = PresentPoint(
        speed_rpm=round(point.speed_rpm, 1),
        load_n=round(point.load_n, 1),
        measured_c=dict(measured_c),
        over_limit={
            name: {
                level: 1.0
                if _is_over(measured_c.get(name), limit.limit_c)
                else limit.steady_probability[row][column]
                for level, limit in of_sensor.limits.items()
            }
            for name, of_sensor in maps.sensors.items()
        },
    )
    labels = list(maps.labels)
    for name, value_c in measured_c.items():
        of_sensor = maps.sensors[name]
        expected_c = of_sensor.steady_c.q50[row][column]
        for level in _LEVELS:
            limit = of_sensor.limits.get(level)
            if value_c is None or limit is None or expected_c is None:
                continue
            if value_c >= limit.limit_c > expected_c:
                labels.append(
                    f"{label(name)} measured {value_c:.1f} °C at the present point, over {level} "
                    f"{limit.limit_c:g} °C: the map shows {expected_c:.1f} °C there"
                )
                break
    return EnvelopeDocument(**dict(maps) | {"labels": labels}, present=present)


def _is_over(reading_c: float | None, limit_c: float) -> bool:
    return reading_c is not None and reading_c >= limit_c


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
