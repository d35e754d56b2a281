"""Each sister played as the target, to learn what its band would have needed.

Its easy part is all that the target's own data cover; the other sisters make its prior; the rest of
its rows is the truth. Bearings are the units: the minutes of one run are not independent.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twin_core.filtering import begin, run_filter
from twin_core.forecasting.calibrated import untrained_rows
from twin_core.forecasting.ensemble import forecast
from twin_core.forecasting.result import Forecast
from twin_core.forecasting.whole_run import shares_of_band
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.family import SisterRun
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import Posterior, TrainedRange
from twin_core.identification.problem import first_measurements, profile_of
from twin_core.models import ThermalModel
from twin_core.simulation import SimulationError
from twin_core.sisters.population import FEWEST_SISTERS, Sister, knowledge_of, population_prior
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

_FEWEST_ROWS = 20
# Share of a run's readings that its band has to hold.
_HELD = 0.95
# A need beyond this, such as that of a run whose forecast failed, is no number any more.
_MOST = 1000.0


def calibration_runs(
    model: ThermalModel,
    sisters: Sequence[Sister],
    trained: TrainedRange,
    *,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> tuple[SisterRun, ...]:
    """Play every sister whose rows are known as the target.

    `sisters`: those that the target's prior is made of; `trained`: where the target has been, which
    is each sister's easy part; `progress`: called after each sister with how far the work has come,
    0 to 1. Returns one per sister that has rows both within and beyond that range, and whose own
    fit may forecast.
    """
    runs = []
    for number, sister in enumerate(sisters):
        if progress is not None:
            progress(number / len(sisters))
        others = [one for one in sisters if one is not sister]
        if sister.data is None or len(others) < FEWEST_SISTERS:
            continue
        parted = _parted(sister.data, trained)
        if parted is not None:
            run = _played(model, sister.name, others, *parted, seed, cancelled)
            runs += [] if run is None else [run]
    return tuple(runs)


def _parted(
    data: IdentificationData, trained: TrainedRange
) -> tuple[IdentificationData, IdentificationWindow, int] | None:
    """What came before the first row beyond the range; the window of that row, and the row.

    None where there is too little of either.
    """
    before: list[IdentificationWindow] = []
    for window in data.windows:
        rows = window.minutes.take(window.minutes.good)
        beyond = np.flatnonzero(untrained_rows(profile_of(rows), trained))
        first = int(beyond[0]) if beyond.size else rows.size
        if first >= _FEWEST_ROWS:
            easy = rows.take(slice(0, first))
            before.append(IdentificationWindow(easy, window.at_rest, window.revolutions))
        if beyond.size:
            enough = before and rows.size - first >= _FEWEST_ROWS
            whole = IdentificationWindow(rows, window.at_rest, window.revolutions)
            return (IdentificationData(tuple(before)), whole, first) if enough else None
    return None


def _played(
    model: ThermalModel,
    name: str,
    others: Sequence[Sister],
    easy: IdentificationData,
    window: IdentificationWindow,
    first: int,
    seed: int,
    cancelled: Callable[[], bool] | None,
) -> SisterRun | None:
    """Forecast the rest of a window from ``first`` on; None where the easy part has no fit."""
    prior = population_prior(others)
    try:
        result = identify(
            model,
            easy,
            FitSettings(method="refine", seed=seed),
            guess_z=prior.mean,
            warm=True,
            prior=prior,
            cancelled=cancelled,
        )
    except ValueError:
        return None
    if result.status != "converged":
        return None
    posterior = replace(result.posterior, sisters=knowledge_of(others))
    ahead = window.minutes.take(slice(first, window.minutes.size))
    try:
        made = _forecast(model, posterior, window, max(first - 1, 0), seed)
        sensors = [sensor for sensor in made.sensors if sensor in ahead.sensors]
        needs = {sensor: _needed(made, sensor, ahead) for sensor in sensors}
    except SimulationError:
        needs = dict.fromkeys(window.minutes.sensors, (_MOST, _MOST))
    known = {sensor: need for sensor, need in needs.items() if need is not None}
    return SisterRun(
        name,
        float(np.max(ahead.load_n)),
        float(np.max(np.abs(ahead.speed_rpm))),
        {sensor: moments for sensor, (moments, _) in known.items()},
        {sensor: whole for sensor, (_, whole) in known.items()},
    )


def _forecast(
    model: ThermalModel, posterior: Posterior, window: IdentificationWindow, now: int, seed: int
) -> Forecast:
    """Forecast a window from its row ``now`` on, as it was run."""
    profile = profile_of(window.minutes)
    observer = begin(
        model,
        model.parameters.values_from_z(posterior.z),
        first_measurements(window.minutes),
        profile.point(0),
        window.at_rest,
        revolutions=window.revolutions,
    )
    readings = [window.minutes.readings(row) for row in range(now + 1)]
    run_filter(observer, profile.rows(slice(now + 1)), readings)
    ahead = profile.rows(slice(now, profile.size))
    point = profile.point(now)
    followed_s = np.inf if window.at_rest else float(profile.time_s[now] - profile.time_s[0])
    state = observer.state(point.ambient_c, point.inputs, followed_s=followed_s)
    return forecast(model, posterior, replace(state, operating_point=point), ahead, seed=seed)


def _needed(made: Forecast, sensor: str, ahead: MinuteData) -> tuple[float, float] | None:
    """Factors with which the bands would have held 95 % and all of the readings.

    The first is on the band of each moment, the second on that of the whole run. None without
    readings.
    """
    quantiles = made.quantile(sensor)[:, -ahead.size :]
    share = shares_of_band(quantiles, ahead.temperatures_c[sensor])
    known = np.isfinite(share)
    if not np.any(known):
        return None
    whole = share / made.whole_run_factor[-ahead.size :, made.sensors.index(sensor)]
    moments = float(np.quantile(share[known], _HELD, method="higher"))
    return min(moments, _MOST), min(float(np.max(whole[known])), _MOST)
