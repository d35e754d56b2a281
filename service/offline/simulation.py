"""A simulation from a model file: the most probable parameters over a profile, nothing else."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.domain.errors import BearingTwinError
from service.offline.model_file import IdentifiedModel
from service.offline.tables import FloatArray, PlannedRows
from twin_core.simulation import OperatingProfile, SimulationError, simulate

# The twin steps by 15 to 60 s and is off by hundredths of a kelvin, far less than it knows. Other
# programs compare themselves with a simulation, so it takes steps that are divided by 2 again and
# again, in each span of the profile, until the result stays.
_SPAN_S = 600.0
_LONGEST_STEP_S = 15.0
_MOST_DOUBLINGS = 10
_TOLERANCE_K = 1e-8


class RunAwayError(BearingTwinError):
    """The model runs away over the profile; one line for the user."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRows:
    """True temperatures at the rows of a profile.

    - ``time_s``: (n,) as in the profile.
    - ``names``: every sensor, then the nodes that no sensor has the name of.
    - ``sensors``: the first of the names.
    - ``temperatures_c``: (n, names).
    """

    time_s: FloatArray
    names: tuple[str, ...]
    sensors: tuple[str, ...]
    temperatures_c: FloatArray


def output_names(identified: IdentifiedModel) -> tuple[str, ...]:
    """Names of all that a simulation gives: sensors first, then the other nodes."""
    return tuple(dict.fromkeys((*identified.model.sensor_names, *identified.model.node_names)))


def initial_revolutions(identified: IdentifiedModel) -> float:
    """Revolutions since the grease was fresh at the start of the identification data."""
    return max(float(identified.run_in.revolutions[0]), 0.0)


def simulate_profile(
    identified: IdentifiedModel, rows: PlannedRows, initial_temperature_c: float
) -> SimulatedRows:
    """Simulate a profile from one temperature everywhere at its first row.

    Its most probable parameters are used, and the run-in state that the grease had at the start of
    the identification data; each row holds until the next one. There is no sensor model: neither
    noise, nor offset, nor lag. Raises `RunAwayError` if the temperatures do not stay below 2000
    degC.
    """
    model = identified.model
    start_c = np.full(len(model.node_names), initial_temperature_c)
    pieces, wanted = _without_long_rows(rows)
    try:
        nodes = _nodes_at_rows(identified, pieces, start_c)[wanted]
    except SimulationError as error:
        raise RunAwayError(str(error)) from error
    names = output_names(identified)
    return SimulatedRows(
        rows.time_s, names, model.sensor_names, nodes @ model.sensor_matrix(names).T
    )


def _without_long_rows(rows: PlannedRows) -> tuple[PlannedRows, NDArray[np.int64]]:
    """Rows divided where they last longer than a span, and where the given ones are in them."""
    spans_s = np.diff(rows.time_s)
    counts = np.append(np.ceil(spans_s / _SPAN_S), 1.0).astype(np.int64)
    wanted = np.append(0, np.cumsum(counts)[:-1])
    which = np.repeat(np.arange(counts.size), counts)
    share = (np.arange(which.size) - wanted[which]) / counts[which]
    time_s = rows.time_s[which] + share * np.append(spans_s, 0.0)[which]
    return _rows_at(rows, time_s, which), wanted


def _rows_at(rows: PlannedRows, time_s: FloatArray, which: NDArray[np.int64]) -> PlannedRows:
    """Some of the rows, at other times."""
    return PlannedRows(
        time_s,
        rows.speed_rpm[which],
        rows.load_n[which],
        rows.ambient_c[which],
        rows.inputs[which] if rows.inputs.size else rows.inputs,
    )


def _nodes_at_rows(
    identified: IdentifiedModel, rows: PlannedRows, start_c: FloatArray
) -> FloatArray:
    """Temperatures (n, nodes), span by span."""
    found = np.empty((rows.time_s.size, start_c.size))
    found[0] = start_c
    revolutions, row = initial_revolutions(identified), 0
    while row < rows.time_s.size - 1:
        end = int(np.searchsorted(rows.time_s, rows.time_s[row] + _SPAN_S, side="right")) - 1
        end = max(end, row + 1)
        which = np.arange(row, end + 1)
        span = _rows_at(rows, rows.time_s[which], which)
        found[which], revolutions = _settled(identified, span, found[row], revolutions)
        row = end
    return found


def _settled(
    identified: IdentifiedModel, rows: PlannedRows, start_c: FloatArray, revolutions: float
) -> tuple[FloatArray, float]:
    """Temperatures (n, nodes) that finer steps do not change, and the revolutions at the end."""
    coarse, turned = _with_steps(identified, rows, start_c, revolutions, 1)
    settled = coarse
    for doublings in range(1, _MOST_DOUBLINGS + 1):
        fine, turned = _with_steps(identified, rows, start_c, revolutions, 2**doublings)
        # The error grows with the square of the step.
        better = fine + (fine - coarse) / 3.0
        change_k = float(np.abs(better - settled).max())
        coarse, settled = fine, better
        if change_k < _TOLERANCE_K:
            break
    return settled, turned


def _with_steps(
    identified: IdentifiedModel,
    rows: PlannedRows,
    start_c: FloatArray,
    revolutions: float,
    parts: int,
) -> tuple[FloatArray, float]:
    """Temperatures (n, nodes) with every step divided into parts, and the revolutions."""
    spans_s = np.diff(rows.time_s)
    counts = np.ceil(spans_s / _LONGEST_STEP_S).astype(np.int64) * parts
    ends = np.cumsum(counts)
    which = np.repeat(np.arange(counts.size), counts)
    share = (np.arange(which.size) - (ends - counts)[which]) / counts[which]
    time_s = np.append(rows.time_s[which] + share * spans_s[which], rows.time_s[-1])
    fine = _rows_at(rows, time_s, np.append(which, counts.size - 1))
    profile = OperatingProfile(
        fine.time_s, fine.speed_rpm, fine.load_n, fine.ambient_c, fine.inputs
    )
    path = simulate(identified.model, identified.values, profile, start_c, revolutions)
    return path.temperatures_c[np.append(0, ends)], float(path.revolutions[-1])
