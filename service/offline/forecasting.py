"""A forecast from a model file: follow the history, then run the ensemble over the profile."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.domain.errors import BearingTwinError
from service.offline.model_file import IdentifiedModel
from service.offline.rows import (
    longest_step_s,
    mean_input,
    rows_of_recording,
    step_ahead,
    step_of,
)
from service.offline.tables import FloatArray, PlannedRows, Recording
from service.site.machines.machine import Machine
from twin_core.filtering import begin, run_filter
from twin_core.forecasting import forecast
from twin_core.forecasting.margins import heaviest_margin
from twin_core.forecasting.runaway import RunawayDistance
from twin_core.machine_state import MachineState
from twin_core.minute_rows import MOST_ROWS, row_step_s
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.operating_points import usual_levels
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile, SimulationError, hold_operating_point
from twin_core.windows import MinuteData, is_at_rest

MEMBERS = 200
# A longer time without rows starts the estimate again: the machine may have done anything.
_LONGEST_GAP_S = 1800.0
# Every row of the ensemble takes 30 kB and more; with more rows than this, quantiles are
# interpolated between the minutes.
_MOST_ROWS = 1500
# Rows of a history that are followed one by one; each takes the observer a tenth of a millisecond.
_MOST_FOLLOWED = 5000
_COLD_OFFSET_K, _COLD_SCATTER_K = 0.3, 0.1


class UnusableHistoryError(BearingTwinError, ValueError):
    """A history that no state can be estimated from; one line for the user."""


class FollowError(BearingTwinError):
    """The model cannot follow the history; one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileForecast:
    """Quantiles (5, n, names) at the profile's rows, and what must be said with them.

    By sensor, `whole_run` has the edges (2, n) of the band that 90 % of runs stay inside wholly.
    The margin is that of the row with the most speed times load; None if the machine stands still.
    ``not_known``: see `twin_core.forecasting.Forecast`.
    """

    time_s: FloatArray
    names: tuple[str, ...]
    sensors: tuple[str, ...]
    quantiles: FloatArray
    whole_run: dict[str, FloatArray]
    labels: tuple[str, ...]
    runaway_probability: float
    runaway_margin: RunawayDistance | None
    initial_state: dict[str, dict[str, float]]
    not_known: dict[str, float]

    def highest(self) -> dict[str, dict[str, float]]:
        """Return the highest median and upper edges of every sensor over the rows."""
        return {
            name: {
                "max_q50_c": float(np.max(self.quantiles[2, :, self.names.index(name)])),
                "max_q975_c": float(np.max(self.quantiles[4, :, self.names.index(name)])),
                "max_whole_run_c": float(np.max(self.whole_run[name][1])),
            }
            for name in self.sensors
        }


def cold(identified: IdentifiedModel, initial_temperature_c: float) -> MachineState:
    """A machine that stands at one temperature, its grease as at the start of the data."""
    nodes = len(identified.model.node_names)
    inputs = tuple(
        initial_temperature_c if name in identified.model.network.boundaries else 0.0
        for name in identified.model.input_names
    )
    return MachineState(
        temperatures_c=np.full(nodes, initial_temperature_c),
        covariance=_COLD_OFFSET_K**2 * np.ones((nodes, nodes)) + _COLD_SCATTER_K**2 * np.eye(nodes),
        revolutions=float(identified.run_in.revolutions[0]),
        ambient_c=initial_temperature_c,
        inputs=inputs,
        operating_point=Point(0.0, 0.0, initial_temperature_c, inputs),
    )


def follow(identified: IdentifiedModel, history: Recording) -> MachineState:
    """Follow a history to its last row with the observer.

    ``history``: recorded rows. Where they leave a gap of more than half an hour the estimate starts
    again. Raises `UnusableHistoryError` if there is no row with an operating point and a
    temperature; `FollowError` if the model runs away on the way.
    """
    model = identified.model
    minutes = rows_of_recording(history, _step_followed(history, identified.machine, model))
    good = minutes.take(minutes.good)
    run_in = identified.run_in
    try:
        observer = None
        if good.size:
            cold_start = run_in.at_rest and run_in.begins_with(history, minutes)
            turned = run_in.at_start_of(history, minutes)
            past = usual_levels(identified.posterior.trained.points)
            observer, since_s = _follow(model, identified.values, good, turned, cold_start, past)
        if observer is None:
            raise UnusableHistoryError(
                f"{history.name}: no row with speed_rpm, load_n, ambient_c and a temperature in "
                "the last contiguous span; expected at least one"
            )
        last = (float(good.speed_rpm[-1]), float(good.load_n[-1]), float(good.ambient_c[-1]))
        # Rows at the end without an operating point: the last known one holds.
        point = Point(*last, good.inputs_at(-1))
        observer.predict(float(minutes.time_s[-1] - good.time_s[-1]), *last, point.inputs)
        if minutes.time_s[-1] > good.time_s[-1]:
            observer.update(minutes.readings(minutes.size - 1))
    except SimulationError as error:
        raise FollowError(f"{history.name}: {error}") from error
    state = observer.state(
        point.ambient_c, point.inputs, followed_s=float(minutes.time_s[-1]) - since_s
    )
    return replace(state, operating_point=point)


def _step_followed(history: Recording, machine: Machine, model: ThermalModel) -> float:
    """Step in s at which a history is followed: of a network of one's own as fine as its rows.

    A reading that is a mean over a step in which the duty changed is off by tenths of a kelvin, and
    the observer puts that down to a body without a sensor, where it becomes tens of kelvins.
    """
    step_s = step_of(history, machine, model)
    if machine.network is None or history.time_s.size < 3:
        return step_s
    spacing_s = float(np.median(np.diff(history.time_s)))
    duration_s = float(history.time_s[-1] - history.time_s[0])
    return min(step_s, row_step_s(0.0, spacing_s, duration_s * MOST_ROWS / _MOST_FOLLOWED))


def _follow(
    model: ThermalModel,
    values: FloatArray,
    good: MinuteData,
    revolutions: float,
    cold_start: bool,
    past: Sequence[tuple[float, float]],
) -> tuple[Observer | None, float]:
    """Observer at the last row, and since when; None where no temperature came since a long gap.

    A machine that began at standstill counts as followed without limit: its state was known then.
    """
    profile = hold_operating_point(
        OperatingProfile(
            good.time_s, good.speed_rpm, good.load_n, good.ambient_c, good.input_table()
        )
    )
    counted_s = longest_step_s(good)
    steps_s = np.diff(good.time_s, prepend=good.time_s[0])
    turned = np.abs(np.roll(profile.speed_rpm, 1)) * np.minimum(steps_s, counted_s) / 60.0
    gaps = np.flatnonzero(steps_s > max(_LONGEST_GAP_S, counted_s)).tolist()
    observer: Observer | None = None
    since_s = float(good.time_s[0])
    for start, end in pairwise([0, *gaps, good.size]):
        readings = [good.readings(row) for row in range(start, end)]
        first = start + next((k for k, known in enumerate(readings) if known), end - start)
        for row in range(start, min(first + 1, end)):
            revolutions += float(turned[row])
        observer = None
        if first == end:
            continue
        at_rest = (cold_start and first == 0) or is_at_rest(good.take(slice(first, first + 1)))
        since_s = -np.inf if at_rest else float(good.time_s[first])
        observer = begin(
            model, values, readings[first - start], profile.point(first), at_rest, past, revolutions
        )
        run_filter(observer, profile.rows(slice(first, end)), readings[first - start :])
        revolutions = observer.revolutions
    return observer, since_s


def forecast_profile(
    identified: IdentifiedModel, state: MachineState, rows: PlannedRows
) -> ProfileForecast:
    """Forecast all sensors and nodes at the rows of a profile."""
    profile = _profile(identified, state, rows)
    result = forecast(identified.model, identified.posterior, state, profile, members=MEMBERS)
    quantiles = np.empty((len(result.quantiles), rows.time_s.size, len(result.names)))
    for level, table in enumerate(result.quantiles):
        for name, values in enumerate(table.T):
            quantiles[level, :, name] = np.interp(rows.time_s, profile.time_s, values)
    whole_run = {
        name: np.array(
            [np.interp(rows.time_s, profile.time_s, edge) for edge in result.whole_run(name)]
        )
        for name in result.sensors
    }
    return ProfileForecast(
        rows.time_s,
        result.names,
        result.sensors,
        quantiles,
        whole_run,
        result.labels,
        result.runaway_probability,
        heaviest_margin(identified.model, identified.posterior, state, profile),
        _initial_state(result.names, result.quantiles[:, 0]),
        dict(result.not_known),
    )


def _initial_state(names: Sequence[str], quantiles_c: FloatArray) -> dict[str, dict[str, float]]:
    """Median and half the width of the 95 % band at the beginning, by name."""
    return {
        name: {
            "q50_c": float(quantiles_c[2, column]),
            "half_width_k": float(quantiles_c[4, column] - quantiles_c[0, column]) / 2.0,
        }
        for column, name in enumerate(names)
    }


def _profile(
    identified: IdentifiedModel, state: MachineState, rows: PlannedRows
) -> OperatingProfile:
    """Rows from now on at most a step apart, so that no peak between two planned ones is missed.

    Means over the steps stand for the rows where there are too many for the ensemble.
    """
    time_s = rows.time_s
    columns = [rows.speed_rpm, rows.load_n, rows.ambient_c, *rows.inputs.T]
    point = state.operating_point
    if time_s[0] > 0.0 and point is not None:
        before = (point.speed_rpm, point.load_n, point.ambient_c, *point.inputs)
        time_s = np.append(0.0, time_s)
        columns = [np.append(now, values) for now, values in zip(before, columns, strict=True)]
    longest_s = step_ahead(identified.machine, identified.model)
    grid_s = np.arange(0.0, time_s[-1], max(longest_s, float(time_s[-1]) / _MOST_ROWS))
    if time_s.size <= _MOST_ROWS:
        grid_s = np.union1d(grid_s, time_s)
        index = np.searchsorted(time_s, grid_s, side="right") - 1
        columns = [values[index] for values in columns]
    else:
        grid_s = np.append(grid_s, time_s[-1])
        squared = (
            *(3 * (False,)),
            *(name in identified.machine.mean_square for name in identified.model.input_names),
        )
        columns = [
            mean_input(time_s, values, grid_s, is_squared, np.inf)
            for values, is_squared in zip(columns, squared, strict=True)
        ]
    speed_rpm, load_n, ambient_c, *inputs = columns
    table = np.array(inputs).reshape(-1, grid_s.size).T
    return OperatingProfile(grid_s, speed_rpm, load_n, ambient_c, table)
