"""What no forecast does, whatever the network; docs/trust/model.md publishes this list."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DataObject
from numpy.typing import NDArray
from random_networks import AMBIENT_C, Drawn, held, networks, profiles

from twin_core.forecasting import forecast
from twin_core.identification import prior_posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.simulation import (
    OperatingProfile,
    heat_balance_slopes_w_k,
    heat_balance_w,
    simulate,
    steady_state,
)

# Rounding, and the corrector of films whose conductance changes over a step.
TOLERANCE_K = 1e-6
SPEEDS_RPM = st.floats(100.0, 6000.0)
LOADS_N = st.floats(0.0, 6000.0)
POWERS_W = st.floats(0.0, 50.0)

some = settings(max_examples=60)
few = settings(max_examples=25)


def starts(model: ThermalModel) -> st.SearchStrategy[NDArray[np.float64]]:
    size = len(model.node_names)
    return st.lists(st.floats(-10.0, 120.0), min_size=size, max_size=size).map(np.array)


def steady(model: ThermalModel, speed_rpm: float, load_n: float, power_w: float) -> NDArray:
    at = model.holding([power_w] * len(model.input_names))
    return steady_state(at, model.parameters.centre, speed_rpm, load_n, AMBIENT_C)


@some
@given(networks(), st.data())
def test_nothing_rises_without_heat(drawn: Drawn, data: DataObject) -> None:
    """Without heat every body stays between the hottest and the coldest thing there was."""
    model = drawn.build()
    start = data.draw(starts(model))
    at_rest = held(model, 0.0, 0.0, 0.0, np.arange(0.0, 36000.0, 300.0))
    path = simulate(model, model.parameters.centre, at_rest, start).temperatures_c
    ends = np.append(start, AMBIENT_C)
    assert path.max() <= ends.max() + TOLERANCE_K
    assert path.min() >= ends.min() - TOLERANCE_K
    # Also step by step: what is the hottest does not become hotter.
    hottest = np.maximum(path.max(axis=1), AMBIENT_C)
    assert (np.diff(hottest) <= TOLERANCE_K).all()


@some
@given(networks(), SPEEDS_RPM, LOADS_N, POWERS_W)
def test_no_body_is_beyond_its_neighbours_without_a_source(
    drawn: Drawn, speed_rpm: float, load_n: float, power_w: float
) -> None:
    model = drawn.build()
    temperatures = np.append(steady(model, speed_rpm, load_n, power_w), AMBIENT_C)
    for node, neighbours in enumerate(drawn.neighbours):
        around = temperatures[list(neighbours)]
        assert temperatures[node] >= around.min() - TOLERANCE_K
        if node not in drawn.heated:
            assert temperatures[node] <= around.max() + TOLERANCE_K


@some
@given(networks(contacts=False), SPEEDS_RPM, LOADS_N, st.floats(0.0, 6000.0), st.data())
def test_more_load_makes_nothing_colder(
    drawn: Drawn, speed_rpm: float, load_n: float, more_n: float, data: DataObject
) -> None:
    """Where the load drives the heat alone; a contact that it closes may cool a body."""
    model = drawn.build()
    start = data.draw(starts(model))
    time_s = np.arange(0.0, 14400.0, 120.0)
    light, heavy = (
        simulate(
            model, model.parameters.centre, held(model, speed_rpm, load, 10.0, time_s), start
        ).temperatures_c
        for load in (load_n, load_n + more_n)
    )
    assert (heavy >= light - TOLERANCE_K).all()
    ends = [steady(model, speed_rpm, load, 10.0) for load in (load_n, load_n + more_n)]
    assert (ends[1] >= ends[0] - TOLERANCE_K).all()


@some
@given(networks(), SPEEDS_RPM, LOADS_N, POWERS_W)
def test_the_steady_state_is_reached_from_both_sides(
    drawn: Drawn, speed_rpm: float, load_n: float, power_w: float
) -> None:
    model = drawn.build()
    end = steady(model, speed_rpm, load_n, power_w)
    at = model.holding([power_w] * len(model.input_names))
    slopes = heat_balance_slopes_w_k(at, model.parameters.centre, end, speed_rpm, load_n, AMBIENT_C)
    slowest = np.max(np.linalg.eigvals(slopes / model.compiled.capacity[:, None]).real)
    assume(slowest < -5e-6)
    time_s = np.linspace(0.0, -15.0 / slowest, 100)
    point = held(model, speed_rpm, load_n, power_w, time_s)
    cold, hot = (
        simulate(model, model.parameters.centre, point, start).temperatures_c
        for start in (np.full_like(end, AMBIENT_C), np.full_like(end, end.max() + 80.0))
    )
    assert (cold <= end + TOLERANCE_K).all()
    assert (hot >= end - TOLERANCE_K).all()
    np.testing.assert_allclose(cold[-1], end, atol=0.01)
    np.testing.assert_allclose(hot[-1], end, atol=0.01)


@few
@given(networks(), st.floats(0.01, 9.0), st.integers(0, 2**31), st.data())
def test_quantiles_are_in_order_and_the_whole_run_holds_them(
    drawn: Drawn, variance_k2: float, seed: int, data: DataObject
) -> None:
    model = drawn.build()
    profile = data.draw(profiles(model))
    state = MachineState(
        data.draw(starts(model)),
        variance_k2 * np.eye(len(model.node_names)),
        0.0,
        AMBIENT_C,
        tuple(profile.inputs[0]),
        operating_point=data.draw(st.sampled_from([None, profile.point(0)])),
    )
    made = forecast(model, prior_posterior(model), state, profile, members=20, seed=seed)
    for name in made.names:
        quantiles = made.quantile(name)
        assert np.isfinite(quantiles).all()
        assert (np.diff(quantiles, axis=0) >= 0.0).all()
    for name in made.sensors:
        whole = made.whole_run(name)
        assert (np.diff(whole, axis=0) >= 0.0).all()


def test_a_bearing_forecasts_no_rise_without_heat(model: ThermalModel) -> None:
    """The same of the 14 nodes: a machine that stands still at ambient stays there."""
    nodes = len(model.node_names)
    prior = prior_posterior(model)
    state = MachineState(np.full(nodes, AMBIENT_C), 1e-8 * np.eye(nodes), 1e7, AMBIENT_C)
    rows = 240
    still = OperatingProfile(
        60.0 * np.arange(rows), np.zeros(rows), np.zeros(rows), np.full(rows, AMBIENT_C)
    )
    made = forecast(model, prior, state, still, members=400)
    for name in model.node_names:
        np.testing.assert_allclose(made.quantile(name)[2], AMBIENT_C, atol=0.1)


@few
@given(
    st.floats(0.0, 6000.0),
    st.floats(0.0, 5000.0),
    st.floats(0.0, 3000.0),
    st.floats(20.0, 120.0),
    st.integers(0, 2**31),
)
def test_a_bearing_under_more_load_makes_no_less_heat(
    model: ThermalModel,
    speed_rpm: float,
    load_n: float,
    more_n: float,
    temperature_c: float,
    seed: int,
) -> None:
    """At like temperatures; its rings may still cool, as the load closes their contacts.

    The prior also holds a film that drags less under load for possible (b below zero).
    """
    z = np.clip(np.random.default_rng(seed).normal(size=model.parameters.size), -3.0, 3.0)
    values = model.parameters.values_from_z(z)
    values[model.parameters.index("b")] = abs(values[model.parameters.index("b")])
    bodies = np.full(len(model.node_names), temperature_c)
    light_w, heavy_w = (
        heat_balance_w(model, values, bodies, speed_rpm, load, AMBIENT_C, 1e7)[1]
        for load in (load_n, load_n + more_n)
    )
    assert heavy_w >= light_w >= 0.0
