import math

import pytest

from twin_core import resistances


def test_radial_shell_of_half_the_6311_outer_ring() -> None:
    """ln(120 / 112) / (2 pi 60.5 0.029) = 0.06899 / 11.02."""
    shell = resistances.radial_shell(0.112, 0.120, 0.029, 60.5)
    assert shell == pytest.approx(6.258e-3, rel=1e-3)


def test_all_balls_of_the_6311() -> None:
    """1 / (pi 28.5 0.010319) / 8 = 0.135 K/W."""
    assert resistances.ball(0.010319, 28.5) / 8.0 == pytest.approx(0.1353, rel=1e-3)


def test_clearance_joint_of_the_6311_in_its_house() -> None:
    """(5e-4 60.5 + 0.9995 0.03) / 15 um = 4016 W/m2K over pi 0.12 0.029 m2."""
    joint = resistances.clearance_joint(15e-6, 0.010933, 5e-4, 60.5, 0.03)
    assert joint == pytest.approx(1.0 / (4015.7 * 0.010933), rel=1e-4)


def test_simple_shapes() -> None:
    assert resistances.bar(0.2, 0.0023758, 60.5) == pytest.approx(1.3914, rel=1e-4)
    assert resistances.joint(8.0, 0.5) == 0.25
    assert resistances.heated_cylinder(0.029, 60.5) == pytest.approx(0.02268, rel=1e-3)
    assert resistances.spreading(0.0874, 60.5) == pytest.approx(0.04728, rel=1e-3)
    assert resistances.annulus(0.055, 0.0753) == pytest.approx(2.0774e-3, rel=1e-4)
    assert resistances.cylinder_side(0.2, 0.08) == pytest.approx(math.pi * 0.016)
