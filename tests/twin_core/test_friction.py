import math

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.friction import (
    palmgren_moment_nmm,
    reference_moment_nmm,
    two_part_coefficients,
)
from twin_core.materials import BaseOil
from twin_core.network import FrictionKind
from twin_core.simulation import kernels

NO_OIL = BaseOil(1e-9, 0.0, 0.0)
TWO_PART = int(FrictionKind.TWO_PART)
CENTRE = {
    "M0": 1.0, "p": 0.45, "p2": -0.09, "q": 0.38, "pq": -0.10, "s": 0.16, "b": 0.30, "c": 1.60,
}  # fmt: skip


def _two_part_nmm(
    speed: float, load: float, temperature: float, revolutions: float = 1e12, **changes: float
) -> float:
    values = {**CENTRE, "A": 0.12, "Nr": 1e6, **changes}
    coefficients = np.array(
        [c.factor * values[c.parameter] for c in two_part_coefficients(bearing("6311"))]
    )
    point = kernels.friction_at_point(TWO_PART, coefficients, speed, load)
    heat = kernels.friction_heat_w(TWO_PART, coefficients, point, temperature, revolutions)
    return float(heat / (1e-3 * 2.0 * math.pi * speed / 60.0))


@pytest.mark.parametrize(("load", "moment"), [(2650.0, 44.0), (5500.0, 136.3)])
def test_load_moment_by_hand(load: float, moment: float) -> None:
    """6311: f1 = 0.0009 (F / 45000)^0.55 = 1.90e-4 at 2650 N, M_f = f1 F 87.5 mm."""
    total = palmgren_moment_nmm(
        bearing("6311"), NO_OIL, 1e-12, speed_rpm=1000.0, load_n=load, temperature_c=20.0
    )
    assert total == pytest.approx(moment, rel=2e-3)


@pytest.mark.parametrize(
    ("speed", "viscosity", "power"),
    [
        (1500.0, 132.8, 32.0),
        (2400.0, 76.8, 49.2),
        (4200.0, 47.8, 90.0),
        (4900.0, 38.6, 101.8),
        (5600.0, 31.6, 112.4),
        (6200.0, 26.2, 119.1),
    ],
)
def test_palmgren_power_of_the_6311(speed: float, viscosity: float, power: float) -> None:
    """f2 = 0.7 at 2650 N; at 1500 rpm M_v = 1e-7 0.7 199200^(2/3) 87.5^3 = 160.0 N.mm."""
    moment = palmgren_moment_nmm(
        bearing("6311"),
        BaseOil(viscosity, 50.0, 0.05),
        0.7,
        speed_rpm=speed,
        load_n=2650.0,
        temperature_c=50.0,
    )
    assert 1e-3 * moment * 2.0 * math.pi * speed / 60.0 == pytest.approx(power, rel=6e-3)


def test_viscosity_falls_with_temperature_and_takes_the_moment_along() -> None:
    """Two thirds of ln nu: 10 K at beta = 0.06 take exp(-0.4) off M_v."""

    def viscous(temperature: float) -> float:
        return palmgren_moment_nmm(
            bearing("6311"),
            BaseOil(200.0, 30.0, 0.06),
            0.7,
            speed_rpm=3000.0,
            load_n=0.0,
            temperature_c=temperature,
        )

    assert viscous(40.0) / viscous(30.0) == pytest.approx(math.exp(-0.4), rel=1e-9)


@pytest.mark.parametrize("speed", [0.0, 10.0, 19.9])
def test_below_nu_n_2000_the_viscous_moment_is_constant(speed: float) -> None:
    moment = palmgren_moment_nmm(
        bearing("6311"),
        BaseOil(100.0, 40.0, 0.05),
        0.7,
        speed_rpm=speed,
        load_n=0.0,
        temperature_c=40.0,
    )
    assert moment == pytest.approx(160e-7 * 0.7 * 87.5**3, rel=1e-9)  # 7.503 N.mm


def test_both_branches_of_the_viscous_moment_nearly_meet() -> None:
    oil = BaseOil(100.0, 40.0, 0.05)
    below, above = (
        palmgren_moment_nmm(bearing("6016"), oil, 0.7, speed_rpm=n, load_n=0.0, temperature_c=40.0)
        for n in (19.999, 20.001)
    )
    assert below / above == pytest.approx(160.0 / 2000.0 ** (2.0 / 3.0), rel=1e-4)


@pytest.mark.parametrize(("designation", "moment"), [("6311", 196.0), ("6016", 281.0)])
def test_reference_moment(designation: str, moment: float) -> None:
    assert reference_moment_nmm(bearing(designation)) == pytest.approx(moment, rel=1e-3)


def test_two_part_law_is_the_reference_moment_at_its_reference_point() -> None:
    assert _two_part_nmm(3000.0, 2650.0, 60.0) == pytest.approx(196.0, rel=1e-9)


def test_two_part_law_by_hand() -> None:
    """6000 rpm, 5300 N, 40 degC: L = Y = ln 2, V = 989/135 - 989/155 = 0.9453."""
    speed = load = math.log(2.0)
    viscosity = 989.0 / 135.0 - 989.0 / 155.0
    viscous = math.exp(
        0.45 * speed - 0.09 * speed**2 + (0.38 - 0.10 * speed) * viscosity + 0.30 * load
    )
    expected = 196.0 * (0.84 * viscous + 0.16 * math.exp(1.60 * load))
    assert _two_part_nmm(6000.0, 5300.0, 40.0) == pytest.approx(expected, rel=1e-9)


def test_running_in_ends_with_the_revolutions() -> None:
    settled = _two_part_nmm(3000.0, 2650.0, 60.0, revolutions=1e12)
    fresh = _two_part_nmm(3000.0, 2650.0, 60.0, revolutions=0.0)
    later = _two_part_nmm(3000.0, 2650.0, 60.0, revolutions=1e6)
    assert fresh / settled == pytest.approx(1.12)
    assert later / settled == pytest.approx(1.0 + 0.12 * math.exp(-1.0))


def test_the_load_factor_is_separate() -> None:
    """Other load exponents change nothing at 2650 N, whatever speed and temperature."""
    for speed, temperature in ((1500.0, 30.0), (6000.0, 70.0)):
        usual = _two_part_nmm(speed, 2650.0, temperature)
        assert _two_part_nmm(speed, 2650.0, temperature, b=1.2, c=0.3) == usual


def test_heavy_load_makes_friction_less_sensitive_to_temperature() -> None:
    """The load-dependent part does not thin out with the oil."""
    light, heavy = (
        _two_part_nmm(3000.0, load, 80.0) / _two_part_nmm(3000.0, load, 40.0)
        for load in (2650.0, 5500.0)
    )
    assert light < heavy < 1.0


def test_heat_is_capped() -> None:
    assert _two_part_nmm(6000.0, 2650.0, 20.0, M0=1e6) == pytest.approx(
        3000.0 / (1e-3 * 2.0 * math.pi * 100.0)
    )


@pytest.mark.parametrize(("speed", "load"), [(0.0, 0.0), (0.0, 5000.0), (1e-3, 0.0), (5.0, 1.0)])
def test_heat_vanishes_towards_standstill(speed: float, load: float) -> None:
    values = {**CENTRE, "p2": 0.3, "c": 0.5, "A": 0.12, "Nr": 1e6}
    coefficients = np.array(
        [c.factor * values[c.parameter] for c in two_part_coefficients(bearing("6311"))]
    )
    point = kernels.friction_at_point(TWO_PART, coefficients, speed, load)
    heat = kernels.friction_heat_w(TWO_PART, coefficients, point, 20.0, 0.0)
    assert 0.0 <= heat < 5.0
    assert (heat == 0.0) == (speed == 0.0)
