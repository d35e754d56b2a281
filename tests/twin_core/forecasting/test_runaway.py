"""Loop gain against a network of one node solved by hand, and the margins that follow."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.forecasting.design import held_profile
from twin_core.forecasting.envelope import envelope
from twin_core.forecasting.labels import runaway_not_excluded
from twin_core.forecasting.margins import heaviest_margin, runaway_margin
from twin_core.forecasting.runaway import LIKELY, newtons_left, runaway_probability
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.network_model import RunawayLimits
from twin_core.operating_points import OperatingSpan
from twin_core.profiles import Step
from twin_core.simulation import heat_balance_slopes_w_k, steady_state

AMBIENT_C = 22.0
RUN_IN = 1.0e7
COLD = MachineState(np.full(13, AMBIENT_C), np.zeros((13, 13)), RUN_IN, AMBIENT_C)


@pytest.fixture(scope="module")
def model() -> ThermalModel:
    return build_model(bearing=bearing("6016"))


def machine(model: ThermalModel, q: float, spread: float = 0.0, moment: float = 0.0) -> Posterior:
    """Trained at 2650 N; friction falls with the temperature less, or grows, with lower ``q``."""
    prior = prior_posterior(model)
    z = prior.z.copy()
    z[model.parameters.index("q")] = q
    z[model.parameters.index("M0")] = moment
    point = OperatingSpan(5800.0, 2650.0, 21600.0, 0.0)
    return replace(
        prior,
        z=z,
        covariance=spread**2 * np.eye(z.size),
        trained=TrainedRange((point,), 360, True, 0.0),
    )


@pytest.mark.parametrize("q", [0.0, -3.0, -4.0])
def test_the_gain_is_that_which_the_jacobian_of_the_heat_balance_has(
    model: ThermalModel, q: float
) -> None:
    """Its determinant over that without friction is 1 - gain: Sylvester, for heat of rank one."""
    known = machine(model, q)
    values = model.parameters.values_from_z(known.z)
    found = envelope(model, known, COLD, [5800.0], [2650.0], {})
    after = RUN_IN + 5800.0 * 8 * 60
    steady = steady_state(model, values, 5800.0, 2650.0, AMBIENT_C, after)
    slopes = heat_balance_slopes_w_k(model, values, steady, 5800.0, 2650.0, AMBIENT_C, after)
    # Friction so weak that it gives nothing back; the films stay as warm as they are.
    weak = values.copy()
    weak[model.parameters.index("M0")] *= 1e-9
    cooling = heat_balance_slopes_w_k(model, weak, steady, 5800.0, 2650.0, AMBIENT_C, after)
    expected = 1.0 - np.linalg.det(slopes) / np.linalg.det(cooling)
    assert_allclose(found.loop_gain[:, 0, 0], expected, atol=1e-4)
    assert (expected > 0.0) == (q < -1.0)


def test_friction_that_feeds_itself_has_no_margin(model: ThermalModel) -> None:
    away = machine(model, -6.0, moment=3.0)
    found = envelope(model, away, COLD, [5800.0], [5500.0], {})
    assert found.runaway_share[0, 0] == 1.0
    margin = runaway_margin(model, away, COLD, 5800.0, 5500.0)
    assert margin.probability > 0.3
    assert margin.loop_gain_upper == np.inf
    assert margin.margin_k == 0.0
    assert margin.margin_n < 0.0


def test_more_load_leaves_less_margin_and_newtons_agree_with_the_probability(
    model: ThermalModel,
) -> None:
    known = machine(model, -2.5, spread=0.35, moment=1.0)
    loads = np.arange(1000.0, 9001.0, 500.0)
    found = envelope(model, known, COLD, [5800.0], loads, {})
    probability, margin_k = found.runaway_probability[:, 0], found.margin_k[:, 0]
    assert np.all(np.diff(probability) >= 0.0)
    assert np.all(np.diff(margin_k) <= 0.0)
    assert probability[0] < LIKELY < probability[-1]
    bar_n = loads + found.margin_n[:, 0]
    assert_allclose(bar_n, bar_n[0])
    over = int(np.argmax(probability > LIKELY))
    assert loads[over - 1] < bar_n[0] < loads[over]
    # the same point alone, among loads of its own
    alone = runaway_margin(model, known, COLD, 5800.0, float(loads[over]))
    assert alone.probability == pytest.approx(probability[over], rel=1e-6)
    assert alone.margin_k == pytest.approx(margin_k[over], rel=1e-6)
    assert alone.margin_n == pytest.approx(found.margin_n[over, 0], abs=150.0)


def test_a_search_for_the_load_finds_what_all_loads_tell(model: ThermalModel) -> None:
    known = machine(model, -2.5, spread=0.35, moment=1.0)
    factors = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0])
    margins = []
    for load_n in (400.0, 1500.0, 3000.0, 6000.0, 12_000.0):
        alone = runaway_margin(model, known, COLD, 5800.0, load_n)
        all_n = envelope(model, known, COLD, [5800.0], load_n * factors, {}).margin_n[5, 0]
        assert_allclose(alone.margin_n, all_n, rtol=1e-9)
        margins.append(alone.margin_n)
    assert np.isnan(margins[0])
    assert margins[-1] < 0.0


def test_the_margin_of_a_profile_is_that_of_its_heaviest_point(model: ThermalModel) -> None:
    known = machine(model, -2.5, spread=0.35, moment=1.0)
    levels = [
        Step(5800.0, 2650.0, 3600.0),
        Step(-5000.0, 7000.0, 600.0),
        Step(0.0, 9000.0, 600.0),
    ]
    ahead = held_profile(levels, AMBIENT_C)
    assert heaviest_margin(model, known, COLD, ahead) == runaway_margin(
        model, known, COLD, 5000.0, 7000.0
    )
    standing = held_profile(levels[2:], AMBIENT_C)
    assert heaviest_margin(model, known, COLD, standing) is None
    assert heaviest_margin(replace(model, runaway=None), known, COLD, ahead) is None


def test_newtons_of_loads_that_are_all_safe_or_all_not() -> None:
    loads = np.array([1000.0, 2000.0])
    safe, lost = np.array([[0.001], [0.002]]), np.array([[0.2], [0.9]])
    assert np.all(np.isnan(newtons_left(loads, safe)))
    assert_allclose(newtons_left(loads, lost)[:, 0], [0.0, -1000.0])


def test_what_was_not_tested_is_as_cautious_as_ever(model: ThermalModel) -> None:
    """Unidentified, or of another model: the members' share, and the limits decide."""
    tested = model.runaway
    assert tested is not None
    assert tested.tested
    prior, known = prior_posterior(model), machine(model, 0.0)
    for posterior, limits in ((prior, tested), (known, RunawayLimits())):
        assert runaway_probability(posterior, 30.0, 0.0125, limits) == 0.0125
        for hottest_c, share in ((110.1, 0.0), (80.0, 0.0125)):
            assert runaway_not_excluded(posterior, 2650.0, hottest_c, share, limits)
    assert runaway_not_excluded(known, 4000.0, 60.0, 0.0, RunawayLimits())
    assert not runaway_not_excluded(known, 4000.0, 109.0, 0.04, tested)
    assert runaway_not_excluded(known, 4000.0, 109.0, 0.06, tested)
    assert runaway_not_excluded(known, 4000.0, 111.0, 0.04, tested)
    # beyond what the benches reached nothing is known
    assert runaway_not_excluded(known, 5700.0, 60.0, 0.0, tested)
