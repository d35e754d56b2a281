"""The observer over measured rows: begun from the first readings, advanced row by row."""

from collections.abc import Mapping, Sequence

from numpy.typing import ArrayLike

from twin_core.initial_state import initial_state
from twin_core.models import ThermalModel
from twin_core.observer import Observation, Observer, advance
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile, SimulationError


def begin(
    model: ThermalModel,
    values: ArrayLike,
    readings: Mapping[str, float],
    point: Point,
    at_rest: bool,
    past: Sequence[tuple[float, float]] = (),
    revolutions: float = 0.0,
) -> Observer:
    """Begin to observe a machine.

    `values` (p,); `readings`: temperatures in degC by sensor or node; `at_rest`, `past`: see
    `twin_core.initial_state.initial_state`; `revolutions` since the grease was fresh. Raises
    `ValueError` if a name is unknown or a value not finite, `SimulationError` if the model runs
    away.
    """
    mean_c, covariance = initial_state(
        model,
        values,
        readings,
        point.ambient_c,
        point.speed_rpm,
        point.load_n,
        at_rest,
        past,
        point.inputs,
    )
    return Observer(model, values, mean_c, covariance, revolutions)


def run_filter(
    observer: Observer, rows: OperatingProfile, readings: Sequence[Mapping[str, float]]
) -> Observer:
    """Advance an observer, which has begun at the first row, to the last row; returns it.

    `readings` (n,) are the good ones of each row in degC by sensor or node; those of the first row
    are not used. Raises `ValueError` if there are fewer readings than rows, or a sensor is unknown,
    `SimulationError` if the model runs away.
    """
    for row, (before, step_s) in enumerate(rows.steps(), start=1):
        observer.predict(step_s, before.speed_rpm, before.load_n, before.ambient_c, before.inputs)
        observer.update(readings[row])
    return observer


def run_filters(
    observers: Sequence[Observer], rows: OperatingProfile, readings: Sequence[Mapping[str, float]]
) -> list[bool]:
    """Advance several observers of the same measurements, each as by `run_filter`.

    They differ in their parameters. Returns which of them run away; their estimates mean nothing.
    """
    ran_away = [False] * len(observers)
    for row, (before, step_s) in enumerate(rows.steps(), start=1):
        left = [number for number, gone in enumerate(ran_away) if not gone]
        point = (before.speed_rpm, before.load_n, before.ambient_c, before.inputs)
        step = Observation(step_s, *point, readings[row])
        for number, result in zip(
            left, advance([observers[k] for k in left], [step] * len(left)), strict=True
        ):
            if isinstance(result, SimulationError):
                ran_away[number] = True
            elif isinstance(result, ValueError):
                raise result
    return ran_away
