"""Groups of parameters and physical quantities of the models."""

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.models import ThermalModel, build_model
from twin_core.networks.simple_5 import simple_5_model
from twin_core.quantities import (
    ReferencePoint,
    evaluate,
    log_gradient,
    parameter_groups,
    quantities,
    reference_point,
)
from twin_core.simulation import heat_balance_w, steady_state

POINT = ReferencePoint(3600.0, 2650.0, 50.0)


def _value(model: ThermalModel, z: np.ndarray, name: str) -> float:
    names = [quantity.name for quantity in quantities(model, POINT)]
    return float(evaluate(model, z, POINT)[names.index(name)])


def _moved(model: ThermalModel, parameter: str, by: float) -> np.ndarray:
    z = np.zeros(model.parameters.size)
    z[model.parameters.index(parameter)] = by
    return z


def test_every_parameter_belongs_to_the_part_of_the_network_that_uses_it(
    model: ThermalModel,
) -> None:
    groups = parameter_groups(model)
    assert set(groups) == set(model.parameters.names)
    for name, group in (
        ("M0", "friction"),
        ("A", "friction"),
        ("inn", "heat split"),
        ("Rc", "contact"),
        ("Nub", "convection inside"),
        ("hext", "convection outside"),
        ("gs", "shaft sink"),
        ("hsh", "shaft sink"),
        ("Rj", "joints"),
        ("Cs", "capacity"),
    ):
        assert groups[name] == group


def test_other_networks_have_groups_and_only_the_quantities_they_can_move() -> None:
    paper = build_model("paper", bearing=bearing("6016"))
    assert set(parameter_groups(paper).values()) == {"friction", "contact", "convection inside"}
    names = [quantity.name for quantity in quantities(paper, POINT)]
    assert names == ["friction", "contact", "convection inside", *paper.sensor_names]
    simple = simple_5_model()
    assert set(parameter_groups(simple)) == set(simple.parameters.names)
    z = np.zeros(simple.parameters.size)
    assert np.all(evaluate(simple, z, ReferencePoint(3000.0, 1000.0, 40.0)) > 0.0)


def test_friction_is_the_law_s_heat_of_a_run_in_bearing(model: ThermalModel) -> None:
    z = np.zeros(model.parameters.size)
    warm = np.full(len(model.node_names), POINT.temperature_c)
    values = model.parameters.values_from_z(z)
    _, heat_w = heat_balance_w(model, values, warm, 3600.0, 2650.0, 20.0, 1e12)
    assert _value(model, z, "friction") == pytest.approx(heat_w, rel=1e-12)
    more = _moved(model, "M0", 0.25)  # spread 0.4 of the logarithm
    assert _value(model, more, "friction") == pytest.approx(np.exp(0.1) * heat_w, rel=1e-9)


@pytest.mark.parametrize(
    ("parameter", "quantity", "factor"),
    [
        ("Rc", "contact", None),
        ("hext", "convection outside", np.exp(0.25)),
        ("Cs", "capacity", np.exp(0.08)),
        ("Rj", "joints", None),
        ("gs", "shaft sink", None),
        ("Nub", "convection inside", None),
    ],
)
def test_a_parameter_moves_its_quantity_and_no_other_of_a_group(
    model: ThermalModel, parameter: str, quantity: str, factor: float | None
) -> None:
    before = evaluate(model, np.zeros(model.parameters.size), POINT)
    after = evaluate(model, _moved(model, parameter, 1.0), POINT)
    for one, low, high in zip(quantities(model, POINT), before, after, strict=True):
        if one.name == quantity:
            assert abs(np.log(high / low)) > 0.02
            if factor is not None:
                assert high / low == pytest.approx(factor, rel=1e-6)
        elif one.group is not None:
            assert high == pytest.approx(low, rel=1e-12)


def test_steady_rises_are_those_of_the_simulation(model: ThermalModel) -> None:
    z = np.zeros(model.parameters.size)
    values = model.parameters.values_from_z(z)
    steady = steady_state(model, values, 3600.0, 2650.0, 22.0, 1e9)
    for name in model.sensor_names:
        rise = float(model.sensor_row(name) @ steady) - 22.0
        assert _value(model, z, name) == pytest.approx(rise, rel=1e-9)


def test_gradient_is_that_of_the_logarithms(model: ThermalModel) -> None:
    z = np.random.default_rng(1).normal(0.0, 0.3, model.parameters.size)
    step = np.random.default_rng(2).normal(0.0, 1e-3, z.size)
    gradient = log_gradient(model, z, POINT)
    found = np.log(evaluate(model, z + step, POINT) / evaluate(model, z - step, POINT)) / 2.0
    assert gradient.shape == (found.size, z.size)
    assert gradient @ step == pytest.approx(found, rel=1e-3, abs=1e-8)


def test_gradient_at_a_bound_is_one_sided(model: ThermalModel) -> None:
    z = np.zeros(model.parameters.size)
    position = model.parameters.index("hext")
    z[position] = model.parameters.z_upper[position]
    names = [quantity.name for quantity in quantities(model, POINT)]
    slope = log_gradient(model, z, POINT)[names.index("convection outside"), position]
    assert slope == pytest.approx(0.25, rel=1e-3)


def test_reference_point_has_the_lubricant_as_warm_as_it_gets(model: ThermalModel) -> None:
    z = np.zeros(model.parameters.size)
    slow = reference_point(model, z, 1500.0, 2650.0)
    fast = reference_point(model, z, 6000.0, 2650.0)
    assert slow.temperature_c < fast.temperature_c
    assert slow.temperature_c % 10.0 == fast.temperature_c % 10.0 == 0.0
