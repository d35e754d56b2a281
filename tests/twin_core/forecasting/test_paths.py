"""One pass over the paths of an ensemble against the same in plain numpy."""

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.forecasting.paths import add_deviations, gather_members, net_heat_range
from twin_core.models import build_model
from twin_core.simulation import heat_balance_w, kernels


def test_deviations_are_first_order_widened_and_antithetic() -> None:
    rng = np.random.default_rng(1)
    members, rows, count = 6, 30, 3
    start = rng.normal(size=(members, rows, count))
    normal = rng.normal(size=(3, rows - 1, count))
    keep, shock = rng.uniform(0.8, 1.0, rows - 1), rng.uniform(0.1, 0.2, rows - 1)
    widening, growth = rng.uniform(1.0, 2.0, (rows, count)), rng.uniform(size=rows)
    lasting = rng.normal(size=(members, count))
    expected = np.zeros_like(start)
    both = np.concatenate((normal, -normal))
    for row in range(rows - 1):
        expected[:, row + 1] = keep[row] * expected[:, row] + shock[row] * both[:, row]
    expected = start + expected * widening + lasting[:, None] * growth[:, None]
    paths = start.copy()
    add_deviations(paths, normal, keep, shock, widening, lasting, growth)
    assert paths == pytest.approx(expected, abs=1e-12)


def test_stationary_deviations_have_the_spread_that_was_asked_for() -> None:
    rng = np.random.default_rng(2)
    paths = np.zeros((4000, 40, 1))
    keep = np.full(39, 0.8)
    shock = 0.5 * np.sqrt(1.0 - keep**2)
    even, none = np.ones((40, 1)), np.zeros((4000, 1))
    add_deviations(paths, rng.normal(size=(2000, 39, 1)), keep, shock, even, none, np.zeros(40))
    assert not paths[:, 0].any()
    assert paths[:, -1].std() == pytest.approx(0.5, rel=0.03)
    assert paths.mean() == pytest.approx(0.0, abs=1e-12)
    neighbours = np.corrcoef(paths[:, -1, 0], paths[:, -2, 0])[0, 1]
    assert neighbours == pytest.approx(0.8, abs=0.03)


def test_members_come_last_when_gathered() -> None:
    paths = np.random.default_rng(3).normal(size=(5, 4, 7))
    out = np.zeros((4, 6, 5))
    gather_members(paths, np.array([6, 0, 3]), out[:, 2:5])
    np.testing.assert_array_equal(out[:, 2:5], paths[:, :, [6, 0, 3]].transpose(1, 2, 0))
    assert not out[:, :2].any()
    assert not out[:, 5:].any()


def test_net_heat_of_every_member() -> None:
    model = build_model(bearing=bearing("6311"))
    rng = np.random.default_rng(4)
    values = model.parameters.values_from_z(rng.normal(size=(3, model.parameters.size)))
    state = rng.uniform(20.0, 60.0, (3, 13))
    flow, capacity = np.empty((2, 3, 13))
    net_heat_range(model.compiled, values, state, 4000.0, 2650.0, 22.0, 1e5, flow, capacity)
    for member in range(3):
        point = (4000.0, 2650.0, 22.0, 1e5)
        expected, _ = heat_balance_w(model, values[member], state[member], *point)
        assert flow[member] == pytest.approx(expected)
        own = kernels.bind_network(model.compiled, values[member])[0]
        np.testing.assert_array_equal(capacity[member], own)
