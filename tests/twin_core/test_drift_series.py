"""A machine followed over versions: sudden and creeping changes of linear benches."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_core.bearings import bearing
from twin_core.drift_series import LIMIT, follow, values_of
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.quantities import ReferencePoint, quantities

POINT = ReferencePoint(3600.0, 2650.0, 50.0)
DAY_S = 86_400.0
SAME_RUN = 0.1  # the part of the variance that is left between repetitions


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6311"))


def series(
    model: ThermalModel, path: NDArray[np.float64], seed: int, speeds: tuple[float, ...] = (3600.0,)
) -> list[Posterior]:
    """Posteriors of one machine day by day: nine informed directions, coordinates along a path."""
    rng = np.random.default_rng(seed)
    p = model.parameters.size
    size = np.concatenate((np.geomspace(20.0, 3.0, 20), np.full(p - 20, 0.1)))
    axes, _ = np.linalg.qr(rng.normal(size=(p, p)))
    sensitivity = size[:, None] * axes.T
    covariance = np.linalg.inv(np.eye(p) + sensitivity.T @ sensitivity)
    start = 0.2 * rng.normal(size=p)
    found = []
    for day, moved in enumerate(path):
        noise = np.sqrt(SAME_RUN) * rng.normal(size=p)
        seen = sensitivity.T @ (sensitivity @ (start + moved) + noise)
        speed = speeds[day % len(speeds)]
        points = (OperatingSpan(speed, 2650.0, DAY_S / 2, day * DAY_S),)
        found.append(
            replace(
                prior_posterior(model),
                z=covariance @ seen,
                covariance=covariance,
                trained=TrainedRange(points, 720, False, 1e8),
            )
        )
    return found


def _path(model: ThermalModel, parameter: str, by_day: NDArray[np.float64]) -> NDArray[np.float64]:
    path = np.zeros((by_day.size, model.parameters.size))
    path[:, model.parameters.index(parameter)] = by_day
    return path


def test_an_unchanged_machine_is_left_in_peace(model: ThermalModel) -> None:
    reported = 0
    for seed in range(2):
        readings = follow(model, series(model, np.zeros((7, model.parameters.size)), seed), POINT)
        assert readings[0].drift is None
        assert [reading.against for reading in readings] == [None, *range(6)]
        assert not readings[0].changed
        reported += sum(reading.changed for reading in readings)
    assert reported == 0


def test_a_sudden_change_is_reported_until_it_is_accepted(model: ThermalModel) -> None:
    steps = np.where(np.arange(6) >= 3, 1.0, 0.0)
    readings = follow(model, series(model, _path(model, "M0", steps), 3), POINT)
    assert [reading.changed for reading in readings] == [False] * 3 + [True] * 3
    assert [reading.against for reading in readings] == [None, 0, 1, 2, 2, 2]
    last = readings[-1].drift
    assert last is not None
    assert next(iter(last.groups)) == "friction"
    assert readings[-1].sums["friction"] > LIMIT


def test_a_creeping_change_adds_up(model: ThermalModel) -> None:
    """Each version differs from the one before it by less than one comparison can tell."""
    creep = np.linspace(0.0, -0.35, 12)
    path = _path(model, "hext", creep)
    versions = series(model, path, 9)
    pairs = [follow(model, versions[k : k + 2], POINT)[1] for k in range(11)]
    alone = [pair.drift for pair in pairs if pair.drift is not None and pair.drift.changed]
    readings = follow(model, versions, POINT)
    creeping = [k for k, reading in enumerate(readings) if reading.creeping]
    assert not alone
    assert creeping
    assert "convection outside" in readings[creeping[-1]].creeping
    assert readings[creeping[-1]].sums["convection outside"] <= -LIMIT
    assert all(not readings[k].changed for k in range(4))


def test_every_version_is_held_against_its_own_kind(model: ThermalModel) -> None:
    """Two runs taking turns: the errors of the model in each must not look like a change."""
    versions = series(model, np.zeros((6, model.parameters.size)), 7, speeds=(2400.0, 4200.0))
    readings = follow(model, versions, POINT)
    drifts = [reading.drift for reading in readings]
    assert drifts[1] is not None
    assert not drifts[1].similarity.same_run
    for drift in drifts[2:]:
        assert drift is not None
        assert drift.similarity.same_run


def test_values_come_with_intervals_that_hold_them(model: ThermalModel) -> None:
    version = series(model, np.zeros((1, model.parameters.size)), 1)[0]
    values = values_of(model, version, POINT)
    assert [value.quantity for value in values] == list(quantities(model, POINT))
    assert all(value.low < value.value < value.high for value in values)
    prior = values_of(model, prior_posterior(model), POINT)
    assert prior[0].high / prior[0].low > values[0].high / values[0].low
