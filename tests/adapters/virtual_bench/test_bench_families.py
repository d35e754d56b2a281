import math
from dataclasses import replace

import pytest

from adapters.virtual_bench import BenchParameters
from adapters.virtual_bench.bearings import BEARINGS
from adapters.virtual_bench.families import FAMILIES, random_bench
from adapters.virtual_bench.friction import friction_constants, frictional_moment, oil_viscosity


@pytest.mark.parametrize(
    ("speed_rpm", "oil_c", "power_w"),
    [(1500, 35, 32.0), (2400, 45, 49.2), (4200, 55, 90.0), (4900, 60, 101.8), (6200, 70, 119.1)],
)
def test_palmgrens_law_gives_the_powers_worked_by_hand(
    speed_rpm: float, oil_c: float, power_w: float
) -> None:
    # 6311, 2650 N, oil 100/10.5 mm2/s, viscous factor 0.7
    parameters = replace(
        BenchParameters.for_bearing("6311"),
        friction_law="palmgren", friction_scale=1.0, rolling_scale=0.7 / 0.55, oil_40_mm2_s=100.0,
    )  # fmt: skip
    constants = friction_constants(BEARINGS["6311"], parameters)
    viscosity = oil_viscosity(oil_c, constants.walther_a, constants.walther_b)
    moment = sum(frictional_moment(float(speed_rpm), 2650.0, viscosity, constants))
    assert moment * speed_rpm * math.pi / 30.0 == pytest.approx(power_w, rel=0.015)


def test_families_differ_in_what_load_does_and_agree_under_the_light_one() -> None:
    def growth(family: str) -> float:
        constants = friction_constants(BEARINGS["6016"], random_bench(3, "6016", family))
        light, heavy = (
            sum(frictional_moment(5800.0, load_n, 30.0, constants)) for load_n in (2650.0, 5500.0)
        )
        return heavy / light

    assert random_bench(3, "6016") == BenchParameters.random(3, "6016")
    assert growth("palmgren") < 0.9 * growth("catalogue") < growth("catalogue")
    assert growth("steep") > 1.05 * growth("catalogue")
    rolling = [
        frictional_moment(
            5800.0, 2650.0, 30.0,
            friction_constants(BEARINGS["6016"], random_bench(3, "6016", family)),
        )[0]
        for family in ("catalogue", "steep")
    ]  # fmt: skip
    assert rolling[0] == pytest.approx(rolling[1])
    assert len(FAMILIES) >= 3
    with pytest.raises(ValueError, match="family 'none': expected one of catalogue"):
        random_bench(3, "6016", "none")
