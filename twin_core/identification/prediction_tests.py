"""What a candidate model must predict: parts of the data that are delayed from its nested fit.

The most demanding operating point shows how it extrapolates, the latest one whether it still holds.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.filtering import begin, run_filters
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.problem import first_measurements, profile_of
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.operating_points import OperatingSpan, demand
from twin_core.scores import rms
from twin_core.simulation import OperatingProfile, SimulationError, simulate
from twin_core.windows import MinuteData, window_of

FloatArray = NDArray[np.float64]

SHORTEST_TEST_S = 1200.0
"""A shorter stay at an operating point is no test."""
_FEWEST_ROWS = 20


@dataclass(frozen=True, slots=True, eq=False)
class PredictionTest:
    """A part of the data to predict, and what may be learned from for it."""

    name: str  # ``"extrapolation"`` or ``"latest"``
    #: The data without that part and without anything as demanding as it.
    training: IdentificationData
    window: IdentificationWindow  # the window that holds it
    #: First and last of its rows among the window's good rows.
    first: int
    last: int
    point: OperatingSpan

    @property
    def rows(self) -> MinuteData:
        """The rows to predict; the first is where the prediction starts."""
        good = self.window.minutes.take(self.window.minutes.good)
        return good.take(slice(self.first, self.last + 1))


def prediction_tests(data: IdentificationData) -> list[PredictionTest]:
    """Choose what to predict: the most demanding operating point and the latest one.

    With a single lasting operating point the last third of its rows is the only test; where the
    duty varies, the last third of the last window. Otherwise there is none.
    """
    lasting = [
        (number, point)
        for number, window in enumerate(data.windows)
        for point in window_of(window.minutes).operating_points
        if point.duration_s >= SHORTEST_TEST_S
    ]
    if not lasting:
        return _of_varying_duty(data)
    hard_number, hardest = max(lasting, key=lambda found: demand(found[1]))
    tests = [
        _test(
            "extrapolation", data, hard_number, hardest, lambda point: not _as_hard(point, hardest)
        )
    ]
    number, latest = lasting[-1]
    if tests[0] is None or (number, latest.start_s) != (hard_number, hardest.start_s):
        tests.append(_test("latest", data, number, latest, lambda _: True))
    found = [test for test in tests if test is not None]
    if found:
        return found
    start_s = latest.start_s + 2.0 / 3.0 * latest.duration_s
    third = OperatingSpan(latest.speed_rpm, latest.load_n, latest.end_s - start_s, start_s)
    test = _test("latest", data, number, third, lambda _: True)
    return [test] if test is not None else []


def _of_varying_duty(data: IdentificationData) -> list[PredictionTest]:
    for number, window in reversed(list(enumerate(data.windows))):
        found = window_of(window.minutes)
        if not found.duty:
            continue
        start_s = found.start_s + 2.0 / 3.0 * found.duration_s
        rows = window.minutes.take(window.minutes.good & (window.minutes.time_s >= start_s))
        third = OperatingSpan(
            float(np.mean(np.abs(rows.speed_rpm))),
            float(np.mean(rows.load_n)),
            found.end_s - start_s,
            start_s,
        )
        test = _test("latest", data, number, third, lambda _: True)
        return [] if test is None else [test]
    return []


def _as_hard(point: OperatingSpan, hardest: OperatingSpan) -> bool:
    return demand(point) > 0.95 * demand(hardest)


def _test(
    name: str,
    data: IdentificationData,
    number: int,
    point: OperatingSpan,
    usable: Callable[[OperatingSpan], bool],
) -> PredictionTest | None:
    """Set up one test; None when too little is left to learn from."""
    windows: list[IdentificationWindow] = []
    for index, window in enumerate(data.windows):
        end_s = np.inf
        if index == number:
            end_s = point.start_s
        elif index > number and name == "latest":
            continue
        for other in window_of(window.minutes).operating_points:
            if not usable(other):
                end_s = min(end_s, other.start_s)
        rows = window.minutes.take(window.minutes.time_s < end_s)
        if int(rows.good.sum()) >= _FEWEST_ROWS:
            windows.append(IdentificationWindow(rows, window.at_rest, window.revolutions))
    if not windows:
        return None
    window = data.windows[number]
    time_s = window.minutes.time_s[window.minutes.good]
    # The prediction starts with the row at which the machine is still at the point before.
    first = max(int(np.searchsorted(time_s, point.start_s)) - 1, 0)
    last = int(np.searchsorted(time_s, point.end_s, side="left")) - 1
    if last - first < 3:
        return None
    return PredictionTest(name, IdentificationData(tuple(windows)), window, first, last, point)


def predict_rows(
    model: ThermalModel, candidates: Sequence[FloatArray], test: PredictionTest
) -> list[dict[str, float]]:
    """Rms error in K per sensor of predictions over a test's rows, started like a live forecast.

    The observer follows the window's measurements up to the first row; from there on the model
    runs alone. Infinite where it runs away.

    `candidates`: standard coordinates (p,) of the parameters that each prediction is made with.
    """
    window = test.window
    rows = window.minutes.take(window.minutes.good)
    profile = profile_of(window.minutes)
    begun: dict[int, Observer] = {}
    for number, z in enumerate(candidates):
        with contextlib.suppress(SimulationError):
            begun[number] = begin(
                model,
                model.parameters.values_from_z(z),
                first_measurements(window.minutes),
                profile.point(0),
                window.at_rest,
                revolutions=window.revolutions,
            )
    readings = [rows.readings(row) for row in range(test.first + 1)]
    ran_away = run_filters(list(begun.values()), profile.rows(slice(test.first + 1)), readings)
    failed = dict.fromkeys(rows.sensors, float("inf"))
    errors = [failed for _ in candidates]
    for (number, observer), gone in zip(begun.items(), ran_away, strict=True):
        if not gone:
            with contextlib.suppress(SimulationError):
                errors[number] = _errors_ahead(observer, test, rows, profile)
    return errors


def _errors_ahead(
    observer: Observer, test: PredictionTest, rows: MinuteData, profile: OperatingProfile
) -> dict[str, float]:
    """Rms error in K per sensor of the model alone, from an observer at the test's first row."""
    chosen = slice(test.first, test.last + 1)
    model = observer.model
    ahead = simulate(
        model, observer.values, profile.rows(chosen), observer.temperatures_c, observer.revolutions
    )
    errors = {
        name: rms(ahead.temperatures_c @ model.sensor_row(name), values_c[chosen])
        for name, values_c in rows.temperatures_c.items()
    }
    return {name: error for name, error in errors.items() if not np.isnan(error)}
