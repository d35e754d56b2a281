import json

import numpy as np
import pytest

from twin_core.forecasting import forecast
from twin_core.identification.posterior import prior_posterior
from twin_core.initial_state import initial_state
from twin_core.machine_state import FOLLOWED_S, MachineState, course_known
from twin_core.models import ThermalModel
from twin_core.observer import Observer
from twin_core.profiles import Point
from twin_core.simulation import OperatingProfile


@pytest.fixture(scope="module")
def observer(model: ThermalModel) -> Observer:
    """One that has been warmed up by its model and corrected by one sensor."""
    values, readings = model.parameters.centre, {"t_inner_ring_c": 22.0}
    observer = Observer(
        model, values, *initial_state(model, values, readings, 22.0, 0.0, 0.0, True), 1000.0
    )
    for minute in range(20):
        observer.predict(60.0, 3000.0, 2650.0, 22.5)
        observer.update({"t_inner_ring_c": 22.0 + minute})
    return observer


def test_an_observer_gives_all_it_knows(observer: Observer) -> None:
    state = observer.state(followed_s=FOLLOWED_S / 4.0)
    np.testing.assert_array_equal(state.temperatures_c, observer.temperatures_c)
    np.testing.assert_array_equal(state.covariance, observer.covariance)
    np.testing.assert_array_equal(state.heat_disturbance_w, observer.heat_disturbance_w)
    assert state.revolutions == 1000.0 + 20 * 3000.0
    assert state.operating_point == Point(3000.0, 2650.0, 22.5)
    assert (state.ambient_c, state.inputs, state.course_known) == (22.5, (), 0.25)
    assert observer.state(19.0).ambient_c == 19.0, "what it is now"
    assert observer.state(19.0).operating_point == state.operating_point, "what it was up to now"


def test_before_the_first_step_the_ambient_must_be_given(model: ThermalModel) -> None:
    observer = Observer(model, model.parameters.centre, np.full(13, 22.0), np.eye(13))
    with pytest.raises(ValueError, match="give ambient_c"):
        observer.state()
    state = observer.state(21.0)
    assert (state.ambient_c, state.operating_point) == (21.0, None)
    assert state.heat_disturbance_w == pytest.approx(np.zeros(13))


def test_a_kept_state_gives_the_same_forecast(model: ThermalModel, observer: Observer) -> None:
    state = observer.state(followed_s=600.0)
    again = MachineState.from_dict(json.loads(json.dumps(state.to_dict(), allow_nan=False)))
    time_s = 60.0 * np.arange(11.0)
    ahead = OperatingProfile(time_s, *(np.full(11, value) for value in (3000.0, 2650.0, 22.5)))
    first, second = (
        forecast(model, prior_posterior(model), one, ahead, members=10) for one in (state, again)
    )
    np.testing.assert_array_equal(first.quantiles, second.quantiles)
    assert first.labels == second.labels
    assert again.to_dict() == state.to_dict()


def test_a_state_with_inputs_and_without_a_course_is_kept_too() -> None:
    state = MachineState(np.array([20.0, 30.0]), np.eye(2), 5.0, 20.0, (12.0, 230.0))
    assert MachineState.from_dict(state.to_dict()).to_dict() == state.to_dict()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"covariance": [[1.0]]}, r"covariance has shape \(1, 1\)"),
        ({"temperatures_c": [20.0, float("nan")]}, "temperatures_c"),
        ({"heat_disturbance_w": [1.0]}, "heat_disturbance_w"),
        ({"revolutions": float("inf")}, "revolutions is inf"),
        ({"course_known": 1.5}, "course_known is 1.5, expected 0 to 1"),
        ({"operating_point": {"speed_rpm": 1.0}}, "machine state: KeyError"),
        ({"more": 1.0}, "more"),
    ],
)
def test_what_is_no_state_is_refused(changes: dict, text: str) -> None:
    document = MachineState(np.array([20.0, 30.0]), np.eye(2), 5.0, 20.0).to_dict() | changes
    with pytest.raises(ValueError, match=text):
        MachineState.from_dict(document)


def test_revolutions_are_never_negative() -> None:
    assert MachineState(np.array([20.0]), np.eye(1), -3.0, 20.0).revolutions == 0.0


def test_a_course_is_known_in_parts_within_the_first_hour() -> None:
    assert [course_known(seconds) for seconds in (-1.0, 0.0, 900.0, 3600.0, np.inf)] == [
        0.0, 0.0, 0.25, 1.0, 1.0,
    ]  # fmt: skip
