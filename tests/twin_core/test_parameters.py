import math

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.models import build_model
from twin_core.parameters import Parameter, ParameterSet

SET = ParameterSet(
    (
        Parameter("a", "W", "a scale", "log", 10.0, 0.5),
        Parameter("b", "-", "an exponent", "linear", 0.5, 0.1),
        Parameter("c", "-", "a fraction", "linear", 0.15, 0.1, 0.0, 0.3),
    )
)


def test_centre_is_the_prior_median() -> None:
    assert SET.values_from_z([0.0, 0.0, 0.0]).tolist() == [10.0, 0.5, 0.15]
    assert SET.names == ("a", "b", "c")
    assert SET.size == 3


def test_transforms_by_hand() -> None:
    values = SET.values_from_z([2.0, -1.0, 1.0])
    assert values == pytest.approx([10.0 * math.e, 0.4, 0.25])


def test_clip_and_bounds() -> None:
    high = SET.values_from_z([9.0, 9.0, 9.0])
    low = SET.values_from_z([-9.0, -9.0, -9.0])
    assert high == pytest.approx([10.0 * math.exp(2.0), 0.9, 0.3])
    assert low == pytest.approx([10.0 * math.exp(-2.0), 0.1, 0.0])
    assert high == pytest.approx(SET.upper, rel=1e-12)
    assert low == pytest.approx(SET.lower, rel=1e-12)


def test_there_and_back_over_any_leading_axes() -> None:
    z = np.random.default_rng(1).uniform(-1.4, 1.4, (4, 5, 3))
    assert SET.z_from_values(SET.values_from_z(z)) == pytest.approx(z, abs=1e-12)


def test_values_outside_the_bounds_come_back_on_them() -> None:
    z = SET.z_from_values([1e9, 0.0, -1.0])
    assert z == pytest.approx([4.0, -4.0, -1.5])
    assert z == pytest.approx([SET.z_upper[0], SET.z_lower[1], SET.z_lower[2]])


def test_wrong_shapes_and_names() -> None:
    with pytest.raises(ValueError, match=r"z has shape \(2,\), expected \(..., 3\)"):
        SET.values_from_z([0.0, 0.0])
    with pytest.raises(KeyError, match="unknown parameter 'd', expected one of a, b, c"):
        SET.index("d")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("log", -1.0, 0.5), "centre is -1.0, expected > 0"),
        (("linear", 1.0, 0.0), "spread is 0.0, expected > 0"),
        (("linear", 1.0, 0.1, 2.0, 3.0), r"centre 1.0 lies outside its bounds \[2.0, 3.0\]"),
        (("cube", 1.0, 0.1), "transform is 'cube'"),
    ],
)
def test_impossible_parameters_are_refused(arguments: tuple[str, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Parameter("k", "-", "", *arguments)  # type: ignore[arg-type]


def test_names_are_unique() -> None:
    with pytest.raises(ValueError, match="'a' is defined more than once"):
        ParameterSet((SET.parameters[0], SET.parameters[0]))


def test_paper_model_has_the_papers_fifteen() -> None:
    names = build_model("paper", bearing=bearing("6311")).parameters.names
    assert names == (
        "f2", "Kc1", "Kc2", "K11", "K12", "K13", "K21", "K22", "K23",
        "K31", "K32", "K33", "K41", "K42", "K43",
    )  # fmt: skip


def test_default_priors() -> None:
    parameters = build_model(bearing=bearing("6311")).parameters
    prior = {p.name: (p.transform, p.centre, p.spread) for p in parameters.parameters}
    assert prior == {
        "M0": ("log", 1.0, 0.4),
        "p": ("linear", 0.24, 0.15),
        "p2": ("linear", -0.18, 0.08),
        "q": ("linear", 0.38, 0.18),
        "pq": ("linear", -0.18, 0.10),
        "s": ("log", 0.14, 0.4),
        "b": ("linear", 0.36, 0.28),
        "c": ("linear", 1.60, 0.08),
        "A": ("linear", 0.10, 0.12),
        "Nr": ("log", 1e6, 0.7),
        "Rc": ("log", 0.60, 0.8),
        "Nub": ("log", 100.0, 0.8),
        "Nur": ("log", 50.0, 0.9),
        "m": ("linear", 0.5, 0.1),
        "inn": ("linear", 0.5, 0.08),
        "ball": ("linear", 0.5, 0.08),
        "fm": ("linear", 0.15, 0.1),
        "hext": ("log", 1.0, 0.25),
        "eext": ("linear", 0.15, 0.08),
        "hsh": ("log", 0.5, 0.6),
        "gs": ("log", 1.0, 0.8),
        "Rj": ("log", 1.0, 0.5),
        "Rs": ("log", 1.0, 0.5),
        "Cs": ("log", 1.0, 0.08),
    }
    fraction = parameters.index("fm")
    assert (parameters.lower[fraction], parameters.upper[fraction]) == pytest.approx((0.0, 0.55))
