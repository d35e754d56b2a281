"""Many machines in one call are as many machines one at a time."""

from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.observers import Observers
from twin_core.simulation import SimulationError

SENSORS = ("t_inner_ring_c", "t_outer_ring_c", "t_node_7_c")
MACHINES = 5


@pytest.fixture(scope="module")
def values(model: ThermalModel) -> np.ndarray:
    """Every machine has parameters of its own."""
    z = np.random.default_rng(3).normal(0.0, 0.5, (MACHINES, model.parameters.size))
    return np.array([model.parameters.values_from_z(row) for row in z])


def together(model: ThermalModel, values: np.ndarray) -> Observers:
    mean = 22.0 + np.arange(MACHINES)[:, None] + np.zeros((MACHINES, 13))
    covariance = np.tile(np.ones((13, 13)) + 0.09 * np.eye(13), (MACHINES, 1, 1))
    return Observers(model, values, mean, covariance, 1e5 * np.arange(MACHINES))


def one_by_one(model: ThermalModel, values: np.ndarray) -> list[Observer]:
    many = together(model, values)
    return [
        Observer(model, *parts)
        for parts in zip(
            values, many.temperatures_c, many.covariance, many.revolutions.tolist(), strict=True
        )
    ]


def each(low: float, high: float) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(low, high), min_size=MACHINES, max_size=MACHINES)


STEPS = st.lists(
    st.tuples(
        st.lists(st.sampled_from([0.0, 1.0, 5.0, 60.0, 700.0]), min_size=5, max_size=5),
        each(0.0, 6000.0),
        each(0.0, 5000.0),
        each(15.0, 30.0),
        st.lists(
            st.lists(st.one_of(st.none(), st.floats(10.0, 90.0)), min_size=3, max_size=3),
            min_size=MACHINES,
            max_size=MACHINES,
        ),
    ),
    min_size=1,
    max_size=6,
)


@settings(max_examples=25, deadline=None)
@given(steps=STEPS)
def test_many_are_as_many_one_at_a_time(
    model: ThermalModel, values: np.ndarray, steps: list[tuple[list, list, list, list, list]]
) -> None:
    many, alone = together(model, values), one_by_one(model, values)
    for *given_columns, table in steps:
        failed = many.predict(*given_columns)
        readings = np.array(table, dtype=np.float64)
        difference_k, std_k = many.update(SENSORS, readings)
        for k, observer in enumerate(alone):
            with pytest.raises(SimulationError) if failed[k] else nullcontext():
                observer.predict(*(column[k] for column in given_columns))
            found = observer.update(
                {name: value for name, value in zip(SENSORS, table[k], strict=True) if value}
            )
            for column, name in enumerate(SENSORS):
                expected = found.get(name, (np.nan, np.nan))
                assert_allclose((difference_k[k, column], std_k[k, column]), expected, rtol=1e-9)
    for k, observer in enumerate(alone):
        assert_allclose(many.temperatures_c[k], observer.temperatures_c, rtol=1e-10)
        assert_allclose(many.covariance[k], observer.covariance, rtol=1e-9, atol=1e-12)
        assert_allclose(many.heat_disturbance_w(k), observer.heat_disturbance_w, atol=1e-9)
        assert many.revolutions[k] == observer.revolutions
        assert many.operating_point(k) == observer.operating_point
        if many.operating_point(k) is not None:
            assert (
                many.state(k).to_dict()["operating_point"]
                == (observer.state().to_dict()["operating_point"])
            )


def test_a_machine_that_runs_away_is_left_as_it_was_and_the_others_go_on(
    model: ThermalModel, values: np.ndarray
) -> None:
    many, alone = together(model, values), one_by_one(model, values)
    before = many.to_dict(2)
    ambient_c = [22.0, 22.0, 1e7, 22.0, 22.0]
    failed = many.predict(600.0, 3000.0, 2650.0, ambient_c)
    assert failed.tolist() == [False, False, True, False, False]
    assert many.to_dict(2) == before
    for k in (0, 1, 3, 4):
        alone[k].predict(600.0, 3000.0, 2650.0, 22.0)
        assert_allclose(many.temperatures_c[k], alone[k].temperatures_c, rtol=1e-12)


def test_a_machine_without_readings_is_not_corrected(
    model: ThermalModel, values: np.ndarray
) -> None:
    many = together(model, values)
    many.predict(60.0, 3000.0, 2650.0, 22.0)
    before = [many.to_dict(k) for k in range(MACHINES)]
    readings = np.full((MACHINES, 1), np.nan)
    readings[1] = 40.0
    difference_k, _ = many.update(["t_inner_ring_c"], readings)
    assert np.isfinite(difference_k[:, 0]).tolist() == [k == 1 for k in range(MACHINES)]
    assert [many.to_dict(k) == before[k] for k in range(MACHINES)] == [
        k != 1 for k in range(MACHINES)
    ]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"dt_s": [1.0, 1.0, -1.0, 1.0, 1.0]}, "dt_s of machine 2 is -1.0"),
        ({"load_n": np.nan}, "load_n of machine 0 is nan"),
        ({"inputs": [1.0]}, "inputs are"),
    ],
)
def test_wrong_steps_are_named(
    model: ThermalModel, values: np.ndarray, changes: dict, text: str
) -> None:
    many = together(model, values)
    usual = {"dt_s": 1.0, "speed_rpm": 1500.0, "load_n": 2650.0, "ambient_c": 22.0}
    with pytest.raises(ValueError, match=text):
        many.predict(**usual | changes)
    with pytest.raises(ValueError, match="readings have shape"):
        many.update(SENSORS, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="values has shape"):
        Observers(model, values[:, 1:], many.temperatures_c, many.covariance, many.revolutions)
