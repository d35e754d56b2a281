"""The paper's model in identifiable combinations: the same physics, its 15 numbers as a view."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.friction import palmgren_moment_nmm
from twin_core.materials import MINERAL_OIL_100
from twin_core.models import ThermalModel, build_model
from twin_core.parameters import ParameterSet
from twin_core.reduced_paper import palmgren_parts_nmm, paper_numbers, reduced_parameters
from twin_core.simulation import steady_state


@pytest.fixture(params=["6311", "6016"])
def designation(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def _rings(model: ThermalModel, values: np.ndarray, speed_rpm: float) -> np.ndarray:
    temperatures = steady_state(model, values, speed_rpm, 2650.0, 22.6, 0.0)
    return model.sensor_matrix(model.sensor_names) @ temperatures


def _paper_values(parameters: ParameterSet, numbers: dict[str, np.ndarray]) -> np.ndarray:
    return np.array([float(numbers[name]) for name in parameters.names])


def test_palmgrens_parts_by_hand() -> None:
    # 6311: dm 87.5 mm, C0 45 kN; f1 = 0.0009 (2650 / 45000)^0.55 = 1.8954e-4, M_f = f1 F dm
    viscous, load = palmgren_parts_nmm(bearing("6311"))
    assert load == pytest.approx(0.0009 * (2650 / 45_000) ** 0.55 * 2650 * 87.5, rel=1e-6)
    viscosity = 297.0 * np.exp(-0.0482 * (60.0 - 22.6))
    expected = 1e-7 * 0.45 * (viscosity * 3000.0) ** (2 / 3) * 87.5**3
    assert viscous == pytest.approx(expected, rel=1e-6)


def test_its_centre_heats_as_palmgrens_law_does(designation: str) -> None:
    """Friction at the reference point, and near it wherever the two oils agree."""
    one = bearing(designation)
    parts = palmgren_parts_nmm(one)
    whole = palmgren_moment_nmm(
        one, MINERAL_OIL_100, 0.45, speed_rpm=3000.0, load_n=2650.0, temperature_c=60.0
    )
    assert sum(parts) == pytest.approx(whole)
    share = reduced_parameters(one).centre[reduced_parameters(one).index("s")]
    assert share == pytest.approx(parts[1] / whole)


@pytest.mark.parametrize("speed_rpm", [1500.0, 3000.0, 5600.0])
def test_the_papers_model_with_the_15_numbers_gives_the_same_temperatures(
    designation: str, speed_rpm: float
) -> None:
    """What differs is the viscosity's law off 60 degC, which is worth less than 1.5 K here."""
    one = bearing(designation)
    reduced, paper = build_model("paper-reduced", bearing=one), build_model("paper", bearing=one)
    z = np.zeros(reduced.parameters.size)
    z[: reduced.parameters.index("s")] = 0.5  # what the paper takes as known stays as it is
    values = reduced.parameters.values_from_z(z)
    numbers = paper_numbers(reduced.parameters, values)
    assert tuple(numbers) == paper.parameters.names
    assert_allclose(
        _rings(reduced, values, speed_rpm),
        _rings(paper, _paper_values(paper.parameters, numbers), speed_rpm),
        atol=1.5,
    )


def test_the_15_numbers_by_hand() -> None:
    parameters = reduced_parameters(bearing("6311"))
    values = parameters.centre.copy()
    names = parameters.names
    values[names.index("M0")] = 2.0
    values[names.index("Rc")] = 0.3
    values[names.index("Nub")] = 102.0
    values[names.index("m")] = 0.5
    numbers = paper_numbers(parameters, values)
    assert len(numbers) == 15
    assert numbers["f2"] == pytest.approx(0.9)
    assert (numbers["Kc1"], numbers["K11"], numbers["K41"]) == (0.0, 2.0, 2.0)
    assert numbers["Kc2"] == pytest.approx(0.3 * np.sqrt(2650.0 * 3000.0))
    assert numbers["K12"] == pytest.approx(100.0 / np.sqrt(3000.0))
    assert (numbers["K13"], numbers["K23"], numbers["K33"]) == (0.5, 0.5, 0.5)
    # all of the friction load-dependent: nothing is left for f2
    values[names.index("s")] = 1.0
    assert paper_numbers(parameters, values)["f2"] == pytest.approx(0.0)


def test_many_vectors_at_once() -> None:
    parameters = reduced_parameters(bearing("6016"))
    values = parameters.values_from_z(np.random.default_rng(0).normal(size=(4, parameters.size)))
    many = paper_numbers(parameters, values)
    one = paper_numbers(parameters, values[2])
    assert all(many[name].shape == (4,) for name in many)
    for name, numbers in many.items():
        assert numbers[2] == pytest.approx(float(one[name]))
