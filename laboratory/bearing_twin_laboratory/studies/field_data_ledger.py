"""Forecasts of recorded machines, scored as the service scores its live ones.

At every hour of the rows the observer has followed the machine so far; the forecast from there is
compared with what came at the ledger's lead times (`twin_core.verification`), beside the simple
forecasts of the same moment. Speed, load and ambient ahead are those measured, for all of them: the
plan is followed by what it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting import forecast
from twin_core.identification.posterior import Posterior
from twin_core.initial_state import initial_state
from twin_core.models import ThermalModel
from twin_core.naive import NAIVE_KINDS, NaiveForecasts
from twin_core.observer import Observer
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import OperatingProfile
from twin_core.verification import LEAD_TIMES_S, ForecastScores, verify
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

_EVERY_S = 3600.0
_MEMBERS = 200


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What was forecast of a sensor at one lead time, and what came.

    - ``quantiles_c``: (n, 5) of the twin.
    - ``naive_c``: (n,) by simple forecast.
    - ``measured_c``: (n,); NaN where nothing was measured.
    """

    quantiles_c: FloatArray
    naive_c: Mapping[str, FloatArray]
    measured_c: FloatArray


def issue(
    model: ThermalModel,
    posterior: Posterior,
    naive: NaiveForecasts,
    rows: MinuteData,
    sensor: str,
) -> dict[int, Readings]:
    """Follow a machine through rows and forecast it every hour, by lead time in s.

    Lead times between two rows are left out.
    """
    steps = {
        lead: int(np.searchsorted(rows.time_s - rows.time_s[0], lead)) for lead in LEAD_TIMES_S
    }
    steps = {
        lead: step
        for lead, step in steps.items()
        if step < rows.size and rows.time_s[step] - rows.time_s[0] == lead
    }
    found: dict[int, list[tuple[FloatArray, list[float], float]]] = {lead: [] for lead in steps}
    values = model.parameters.values_from_z(posterior.z)
    measured = rows.temperatures_c[sensor]
    first = (float(rows.ambient_c[0]), float(rows.speed_rpm[0]), float(rows.load_n[0]))
    mean, covariance = initial_state(
        model, values, {sensor: float(measured[0])}, *first, at_rest=False
    )
    observer = Observer(model, values, mean, covariance, LONG_RUN_IN)
    longest = max(steps.values(), default=0)
    issued_s = -np.inf
    for row in range(rows.size - 1):
        if row > 0:
            observer.predict(
                float(rows.time_s[row] - rows.time_s[row - 1]),
                float(rows.speed_rpm[row - 1]),
                float(rows.load_n[row - 1]),
                float(rows.ambient_c[row - 1]),
            )
            if np.isfinite(measured[row]):
                observer.update({sensor: float(measured[row])})
        if rows.time_s[row] - issued_s < _EVERY_S or not np.isfinite(measured[row]):
            continue
        issued_s = float(rows.time_s[row])
        ahead = rows.take(slice(row, row + longest + 1))
        profile = OperatingProfile(ahead.time_s, ahead.speed_rpm, ahead.load_n, ahead.ambient_c)
        state = observer.state(float(ahead.ambient_c[0]))
        made = forecast(model, posterior, state, profile, members=_MEMBERS, seed=row)
        simple = naive.forecast(profile, {sensor: float(measured[row])})
        for lead, step in steps.items():
            if step < ahead.size:
                found[lead].append(
                    (
                        made.quantile(sensor)[:, step],
                        [float(simple[kind][sensor][step]) for kind in NAIVE_KINDS],
                        float(measured[row + step]),
                    )
                )
    return {
        lead: Readings(
            np.array([one[0] for one in kept]),
            dict(zip(NAIVE_KINDS, np.array([one[1] for one in kept]).T, strict=True)),
            np.array([one[2] for one in kept]),
        )
        for lead, kept in found.items()
        if kept
    }


@dataclass(frozen=True, slots=True)
class LeadScores:
    """Scores of one lead time.

    - ``twin``: see `twin_core.verification.ForecastScores`.
    - ``naive_mae_k``: mean absolute error by simple forecast, of the same readings.
    """

    twin: ForecastScores
    naive_mae_k: Mapping[str, float]


def scored(issued: Sequence[Mapping[int, Readings]]) -> dict[int, LeadScores]:
    """Score what was issued over several spans, by lead time in s."""
    found = {}
    for lead in sorted({lead for one in issued for lead in one}):
        parts = [one[lead] for one in issued if lead in one]
        measured = np.concatenate([part.measured_c for part in parts])
        naive = {
            kind: np.concatenate([part.naive_c[kind] for part in parts]) for kind in NAIVE_KINDS
        }
        found[lead] = LeadScores(
            verify(np.concatenate([part.quantiles_c for part in parts]), measured),
            {kind: float(np.nanmean(np.abs(values - measured))) for kind, values in naive.items()},
        )
    return found
