"""Parts of the default model that can be left out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.model_options import MODEL_OPTIONS, SHOULDERS
from twin_core.models import build_model
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import OperatingProfile, simulate, steady_state

TIME_S = np.arange(0.0, 3601.0, 60.0)
PROFILE = OperatingProfile(
    TIME_S, np.full(TIME_S.size, 4500.0), np.full(TIME_S.size, 4000.0), np.full(TIME_S.size, 22.0)
)


HELD = tuple(name for name, values in MODEL_OPTIONS.items() if values)


@pytest.mark.parametrize("without", [*((name,) for name in HELD), HELD])
def test_leaving_out_is_holding_the_parameters(without: tuple[str, ...]) -> None:
    full = build_model(bearing=bearing("6016"))
    reduced = build_model(bearing=bearing("6016"), without=without)
    held = {key: value for name in without for key, value in MODEL_OPTIONS[name].items()}
    assert set(full.parameters.names) - set(reduced.parameters.names) == set(held)
    values = full.parameters.centre.copy()
    for name, value in held.items():
        values[full.parameters.index(name)] = value
    cold = np.full(13, 22.0)
    expected = simulate(full, values, PROFILE, cold).temperatures_c
    found = simulate(reduced, reduced.parameters.centre, PROFILE, cold).temperatures_c
    assert_allclose(found, expected, rtol=1e-12)
    changed = simulate(full, full.parameters.centre, PROFILE, cold).temperatures_c
    assert np.abs(found - changed).max() > 0.05


def test_without_shoulders_more_heat_reaches_the_shaft() -> None:
    """Two ways to the shaft's mean temperature conduct more than the one bar that they share."""
    shared = build_model(bearing=bearing("6311"))
    apart = build_model(bearing=bearing("6311"), without=(SHOULDERS,))
    assert apart.parameters == shared.parameters
    ring, shaft = (shared.node_names.index(f"t_node_{number}_c") for number in (4, 12))
    of_ring = []
    for model in (shared, apart):
        rise = steady_state(model, model.parameters.centre, 6000.0, 2650.0, 0.0, LONG_RUN_IN)
        of_ring.append(rise[shaft] / rise[ring])
    assert of_ring[1] > 1.15 * of_ring[0]


def test_a_reduced_model_has_a_name_of_its_own() -> None:
    """So that no posterior of the full model is taken for one of it."""
    reduced = build_model(bearing=bearing("6311"), without=("run_in", "curvature"))
    assert reduced.name == "default without run_in without curvature"
    assert build_model(bearing=bearing("6311"), without=()).name == "default"


@pytest.mark.parametrize(
    ("name", "without"),
    [("default", ("wheel",)), ("default", ("run_in", "run_in")), ("paper", ("run_in",))],
)
def test_senseless_orders_are_refused(name: str, without: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="without"):
        build_model(name, bearing=bearing("6311"), without=without)
