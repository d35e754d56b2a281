"""Many estimates in one step are as many estimates one at a time."""

import json
from collections.abc import Mapping

import numpy as np
import pytest
from numpy.testing import assert_allclose

from service.live.estimate import LiveEstimate, RunningModel, step_together
from twin_core.bearings import bearing
from twin_core.identification.posterior import prior_posterior
from twin_core.models import build_model
from twin_core.simulation import SimulationError

START_US = 1_763_700_000_000_000
MACHINES = 50
STEPS = 40
# Steps of zero, a clock that is set back, and a gap that starts the estimates again.
DURATIONS_S = (1.0, 5.0, 0.0, 60.0, -2.0, 1.0, 1.0, 400.0, 1.0, 1900.0)
WARM = {
    "speed_rpm": 2400.0,
    "load_n": 2650.0,
    "ambient_c": 23.0,
    "t_inner_ring_c": 55.0,
    "t_outer_ring_c": 42.0,
    "t_node_7_c": 47.0,
}


def active(machine: int, version: int = 1) -> RunningModel:
    """A version with parameters of its own, of a bearing of two."""
    model = build_model("default", bearing=bearing("6311" if machine % 2 else "6016"))
    prior = prior_posterior(model)
    z = prior.z + np.random.default_rng(100 * version + machine).normal(0.0, 0.2, prior.z.size)
    document = prior.to_dict() | {"z": z.tolist()}
    return RunningModel(version, model, type(prior).from_dict(document), None)


def begun(machines: int) -> list[LiveEstimate]:
    bounds = {"speed_rpm": (-1e4, 1e4), "ambient_c": (-50.0, 1e10)}
    return [LiveEstimate(active(k), bounds) for k in range(machines)]


def one_at_a_time(
    estimates: list[LiveEstimate], now_us: int, means: list[dict[str, float]]
) -> list[Exception | None]:
    errors: list[Exception | None] = []
    for estimate, given in zip(estimates, means, strict=True):
        try:
            estimate.step(now_us, given)
            errors.append(None)
        except ValueError as error:
            errors.append(error)
    return errors


def random_means(rng: np.random.Generator, machine: int) -> dict[str, float]:
    means = {name: value * (1.0 + 0.01 * rng.normal()) for name, value in WARM.items()}
    for name in list(means):
        lost = name == "t_node_7_c" and machine % 3
        if lost or rng.random() < (0.5 if machine % 5 == 0 else 0.05):
            del means[name]
    wrong: list[Mapping[str, float]] = [
        {"speed_rpm": 2e4},
        {"ambient_c": 1e9},
        {"t_nothing_c": 20.0},
        {"t_inner_ring_c": np.nan},
    ]
    return means | (wrong[rng.integers(4)] if rng.random() < 0.03 else {})


def shown(estimate: LiveEstimate) -> tuple[object, ...]:
    return (
        estimate.started,
        estimate.time_us,
        estimate.point,
        estimate.followed_s,
        estimate.revolutions,
        estimate.innovations.keys(),
    )


def test_they_are_as_one_at_a_time() -> None:
    rng = np.random.default_rng(5)
    together, alone = begun(MACHINES), begun(MACHINES)
    now_us, failures = START_US, 0
    for number in range(STEPS):
        now_us += round(1e6 * DURATIONS_S[number % len(DURATIONS_S)])
        means = [random_means(rng, k) for k in range(MACHINES)]
        found = step_together(together, now_us, means)
        expected = one_at_a_time(alone, now_us, means)
        assert [repr(error) for error in found] == [repr(error) for error in expected]
        failures += sum(error is not None for error in found)
        for one, other in zip(together, alone, strict=True):
            assert shown(one) == shown(other)
            for name, innovation in one.innovations.items():
                assert_allclose(innovation, other.innovations[name], rtol=0.0, atol=1e-9)
            if one.started:
                assert_allclose(one.temperatures_c, other.temperatures_c, rtol=0.0, atol=1e-9)
        for many in (together, alone):
            if number == 15:
                for k in range(0, MACHINES, 7):
                    many[k].swap(active(k, 2))
            if number == 25:
                for k in range(0, MACHINES, 6):
                    kept = many[k].to_dict()
                    if kept is not None:
                        many[k] = LiveEstimate(many[k].active)
                        many[k].restore(json.loads(json.dumps(kept)))
            many[number].stop()
            many[-number].renew_grease()
    assert failures > STEPS / 2
    assert sum(one.started for one in together) > MACHINES / 2


def test_who_runs_away_or_starts_badly_harms_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    estimates = begun(4)
    step_together(estimates[:3], START_US, [WARM] * 3)

    def broken(*_: object) -> None:
        raise RuntimeError("broken")

    monkeypatch.setattr(estimates[3], "_start", broken)
    hot = WARM | {"ambient_c": 1e9}
    before = estimates[1].time_us
    errors = step_together(estimates, START_US + 60_000_000, [WARM, hot, WARM, WARM])
    assert [type(error) for error in errors] == [
        type(None),
        SimulationError,
        type(None),
        RuntimeError,
    ]
    assert estimates[1].time_us == before
    assert not estimates[1].innovations
    assert [estimates[k].time_us for k in (0, 2)] == [START_US + 60_000_000] * 2
    assert not estimates[3].started


def test_no_estimates_are_nothing_to_do() -> None:
    assert step_together([], START_US, []) == []


def test_where_the_step_itself_fails_each_begins_again(monkeypatch: pytest.MonkeyPatch) -> None:
    estimates = begun(3)
    assert step_together(estimates, START_US, [WARM] * 3) == [None] * 3
    with monkeypatch.context() as failing:

        def full(*_: object) -> object:
            raise OSError("no space left on device")

        failing.setattr("service.live.estimate.advance", full)
        errors = step_together(estimates, START_US + 5_000_000, [WARM, {}, WARM])
    assert all(isinstance(error, OSError) for error in errors)
    assert not any(estimate.started for estimate in estimates)
    assert step_together(estimates, START_US + 10_000_000, [WARM] * 3) == [None] * 3
    assert all(estimate.started for estimate in estimates)
