"""What windows tell about parameters: by hand, by algebra, and for the paper's network."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from twin_core.bearings import bearing
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identifiability import (
    Identifiability,
    ParameterCombination,
    identifiability,
    of_covariance,
    of_sensitivities,
    verdict,
)
from twin_core.identification.posterior import posterior_at, prior_posterior
from twin_core.identification.problem import IdentificationProblem
from twin_core.models import ThermalModel, build_model
from twin_core.windows import MinuteData

NAMES = ("a", "b", "c")


def _combinations(strengths: list[float], angle: float = 0.0) -> Identifiability:
    turned = np.array(
        [
            [np.cos(angle), -np.sin(angle), 0.0],
            [np.sin(angle), np.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    return Identifiability(NAMES, np.array(strengths), turned)


def _random(seed: int, rows: int, columns: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(rows, columns)) * np.logspace(1, -2, columns)


def _paper_problem(minutes_per_speed: int, *speeds_rpm: float) -> IdentificationProblem:
    """The paper's staircase at 2650 N; what is measured does not matter to sensitivities."""
    speed = np.repeat(np.array(speeds_rpm), minutes_per_speed)
    full = np.ones(speed.size)
    minutes = MinuteData(
        60.0 * np.arange(speed.size),
        speed,
        2650.0 * full,
        22.6 * full,
        dict.fromkeys(("t_inner_ring_c", "t_outer_ring_c"), 40.0 * full),
        full.astype(np.bool_),
    )
    model = build_model("paper", bearing=bearing("6311"))
    return IdentificationProblem(
        model, IdentificationData((IdentificationWindow(minutes, at_rest=True),))
    )


def test_verdicts_by_hand() -> None:
    assert [verdict(std) for std in (0.0, 0.499, 0.5, 0.899, 0.9, 1.0)] == [
        "informed",
        "informed",
        "weak",
        "weak",
        "prior only",
        "prior only",
    ]


def test_a_combination_of_which_data_and_prior_know_the_same_by_hand() -> None:
    # s = 1: 1 / sqrt(2) of the prior's deviation; s = 2: 1 / sqrt(5); s = 0.1: 1 / sqrt(1.01)
    found = _combinations([2.0, 1.0, 0.1])
    assert [one.std for one in found.combinations] == pytest.approx(
        [5.0**-0.5, 2.0**-0.5, 1.01**-0.5]
    )
    assert [one.verdict for one in found.combinations] == ["informed", "weak", "prior only"]
    assert (found.count("informed"), found.count("weak"), found.count("prior only")) == (1, 1, 1)
    assert_allclose(found.informed_shares, [0.8, 0.5, 1 - 1 / 1.01])
    assert found.condition == pytest.approx(20.0)
    assert found.rank == 3


def test_rank_and_condition_where_a_combination_leaves_no_trace() -> None:
    assert _combinations([10.0, 1.1e-5, 0.0]).rank == 2
    assert _combinations([10.0, 0.9e-5, 0.0]).rank == 1
    assert _combinations([10.0, 1.0, 0.0]).condition == 1e16
    assert (_combinations([0.0, 0.0, 0.0]).rank, _combinations([0.0] * 3).condition) == (0, 1.0)


def test_weights_are_spelled_out_largest_first_and_positive() -> None:
    # first row: cos 150 degrees = -0.866 a, -sin 150 degrees = -0.5 b; its sign is turned
    first, second, third = _combinations([9.0, 1.0, 0.0], np.radians(150.0)).combinations
    assert first.weights == pytest.approx({"a": 0.8660254, "b": 0.5})
    assert first.text == "0.87 a + 0.50 b"
    assert second.weights == pytest.approx({"b": 0.8660254, "a": -0.5})
    assert second.text == "0.87 b - 0.50 a"
    assert third.text == "1.00 c"


def test_the_text_leaves_out_small_weights_but_never_the_largest() -> None:
    many = {"a": 0.6, "b": -0.5, "c": 0.4, "d": 0.3, "e": 0.25, "f": 0.22, "g": 0.1}
    text = ParameterCombination(1.0, 0.7, "weak", many).text
    assert text == "0.60 a - 0.50 b + 0.40 c + 0.30 d + 0.25 e"
    assert ParameterCombination(1.0, 0.7, "weak", {"a": 0.19, "b": 0.18}).text == "0.19 a"


@given(seed=st.integers(0, 10**6), rows=st.integers(1, 12), nuisances=st.integers(0, 3))
@settings(deadline=None)
def test_covariance_is_the_inverse_of_the_information(seed: int, rows: int, nuisances: int) -> None:
    """Nuisances and all: the block of the whole inverse."""
    whole = _random(seed, rows, 4 + nuisances)
    found = of_sensitivities(("a", "b", "c", "d"), whole[:, :4], whole[:, 4:])
    expected = np.linalg.inv(np.eye(4 + nuisances) + whole.T @ whole)[:4, :4]
    assert_allclose(found.covariance, expected, atol=1e-10)
    assert found.rank <= min(rows, 4)
    assert np.all((found.informed_shares >= 0.0) & (found.informed_shares <= 1.0))
    assert_allclose(found.directions @ found.directions.T, np.eye(4), atol=1e-10)


@given(seed=st.integers(0, 10**6), rows=st.integers(1, 8), more=st.integers(1, 5))
@settings(deadline=None)
def test_more_measurements_never_inform_less(seed: int, rows: int, more: int) -> None:
    sensitivities = _random(seed, rows + more, 3)
    few = of_sensitivities(NAMES, sensitivities[:rows])
    many = of_sensitivities(NAMES, sensitivities)
    assert np.all(many.informed_shares >= few.informed_shares - 1e-12)
    assert np.all(many.singular_values >= few.singular_values - 1e-12)


@given(seed=st.integers(0, 10**6))
@settings(deadline=None)
def test_the_covariance_tells_the_same_as_the_sensitivities(seed: int) -> None:
    direct = of_sensitivities(NAMES, _random(seed, 9, 3))
    back = of_covariance(NAMES, direct.covariance)
    assert_allclose(back.singular_values, direct.singular_values, rtol=1e-6, atol=1e-7)
    assert_allclose(back.covariance, direct.covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("speeds_rpm", "rank"),
    [((1500.0,), 6), ((1500.0, 2400.0), 11), ((1500.0, 2400.0, 3500.0), 15)],
)
def test_rank_of_the_papers_parameters_by_speeds(speeds_rpm: tuple[float, ...], rank: int) -> None:
    """One speed fixes f2, one contact resistance and four Nusselt numbers: 6 of 15."""
    problem = _paper_problem(90, *speeds_rpm)
    found = identifiability(problem, np.zeros(problem.unknown_count))
    assert found.rank == rank
    assert (found.condition > 1e8) == (rank < 15)


def test_the_total_heat_is_what_the_paper_learns_first_and_the_cage_never() -> None:
    problem = _paper_problem(30, 1500.0, 2400.0, 3500.0)
    found = identifiability(problem, np.zeros(problem.unknown_count))
    shares = dict(zip(found.names, found.informed_shares, strict=True))
    assert next(iter(found.combinations[0].weights)) == "f2"
    assert shares["f2"] > 0.75
    assert max(shares[f"K4{term}"] for term in (1, 2, 3)) < 0.05
    assert 1 <= found.count("informed") < 6


def test_documents_of_a_posterior_say_what_the_windows_told(
    model: ThermalModel, cold_start: IdentificationData
) -> None:
    problem = IdentificationProblem(model, cold_start)
    unknowns = np.zeros(problem.unknown_count)
    posterior = posterior_at(problem, unknowns)
    found = identifiability(problem, unknowns)
    document = json.loads(json.dumps(posterior.identifiability_document(model), allow_nan=False))
    assert document["rank"] == found.rank == posterior.rank
    assert document["informed"] == found.count("informed") == posterior.informed_combinations
    assert document["informed"] + document["weak"] + document["prior_only"] == model.parameters.size
    first = document["combinations"][0]
    assert first["strength"] == pytest.approx(found.singular_values[0], rel=1e-6)
    assert first["combination"] == found.combinations[0].text
    assert first["verdict"] == "informed"
    table = posterior.parameters(model)
    assert [row["informed_share"] for row in table.values()] == pytest.approx(
        found.informed_shares, abs=1e-9
    )
    assert {row["verdict"] for row in table.values() if row["informed_share"] > 0.76} == {
        "informed"
    }


def test_the_prior_informs_nothing(model: ThermalModel) -> None:
    document = prior_posterior(model).identifiability_document(model)
    assert (document["rank"], document["informed"], document["prior_only"]) == (
        0,
        0,
        model.parameters.size,
    )
    other = build_model("paper", bearing=bearing("6311"))
    with pytest.raises(ValueError, match="does not belong to model 'paper'"):
        prior_posterior(model).identifiability(other)
