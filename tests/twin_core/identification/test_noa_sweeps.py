"""Whole sweeps worked out by hand: which branch a member takes, in both variants.

The generator is replaced by a script that hands out the numbers written here, so that nothing is
left to chance: two members in two coordinates, X_1 = (0.2, 0.4), X_2 = (0.6, 0.8), best X_2,
box [0, 1] x [0, 2]. r1 < r2 conditions and coins are numbers below or above one half.
"""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.identification import noa_moves as moves
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.noa_moves import FloatArray, Variant

HEADS, TAILS = 0.1, 0.9
X = np.array([[0.2, 0.4], [0.6, 0.8]])
BEST = X[1]
A, B, C = 0, 1, 1
"""Member indices drawn for everybody: X_A - X_B = (-0.4, -0.4), X_C = X_2."""
LEVY = 0.05 * moves.mantegna_sigma(1.5)
"""A Lévy step whose two normal numbers are both one."""


class Script:
    """A generator that hands out what is written, in order, and knows what was asked."""

    def __init__(self, entries: Sequence[tuple[str, Any]]) -> None:
        self.left = list(entries)
        self.bit_generator = SimpleNamespace(state={})

    def _next(self, kind: str, shape: Any) -> Any:
        wanted, value = self.left.pop(0)
        assert wanted == kind, f"{kind} asked for, {wanted} scripted"
        if shape is None:
            return value
        return np.broadcast_to(np.asarray(value), shape).copy()

    def random(self, shape: Any = None) -> Any:
        return self._next("uniform", shape)

    def standard_normal(self, shape: Any) -> Any:
        return self._next("normal", shape)

    def integers(self, _: int, size: int) -> Any:
        return self._next("index", size)


def _sweep(
    variant: Variant, entries: Sequence[tuple[str, Any]], told: int, budget: int
) -> FloatArray:
    """Candidates of the sweep that follows ``told`` evaluations."""
    run = Nutcracker(
        [0.0, 0.0],
        [1.0, 2.0],
        budget=budget,
        settings=NutcrackerSettings(population=2, variant=variant),
    )
    run.ask()
    run.tell([1.0, 0.5])
    run.evaluations = told
    run._positions = X.copy()
    run._best = BEST.copy()
    script = Script(entries)
    run._rng = script  # type: ignore[assignment]
    candidates = run._next_sweep().candidates
    assert not script.left, "not all that was scripted was asked for"
    return candidates


def _begin(variant: Variant, strategy: float, uniform: float = 0.5) -> list[tuple[str, Any]]:
    """What every sweep draws first: Lévy numbers, l (released only), rising branch and strategy."""
    entries: list[tuple[str, Any]] = [("normal", 1.0), ("normal", 1.0)]
    if variant == "released":
        entries.append(("uniform", uniform))
    return [*entries, ("uniform", [TAILS, strategy])]


def _foraging(
    variant: Variant,
    phi: float,
    *,
    mu_choices: Sequence[float] = (0.1, 0.9, 0.1, 0.9),
    keep: float = TAILS,
    storage: Sequence[float] = (TAILS, TAILS),
) -> list[tuple[str, Any]]:
    """Strategy I with mu = 0.5 (uniform), normal 2, r = 0.5, storage mu 0.25, r1 = 0.5."""
    entries = _begin(variant, HEADS)
    entries += [("uniform", phi), ("uniform", 0.5), ("normal", 2.0), ("uniform", mu_choices)]
    entries += [("index", A), ("index", B), ("index", C)]
    entries += [("uniform", 0.5), ("uniform", keep)]  # early: r, kept coordinates
    entries += [("uniform", 0.5), ("uniform", [0.01, 0.5]), ("uniform", keep)]  # late, jump in x1
    if variant == "released":
        entries.append(("uniform", 0.25))
    entries += [("uniform", [HEADS, TAILS])]  # storage moves x1 only, if it is masked
    entries += [("uniform", storage[0]), ("uniform", 0.5), ("uniform", storage[1])]
    return [*entries, ("uniform", TAILS), ("uniform", 0.5)]  # repair clamps


@pytest.mark.parametrize("variant", ["released", "printed"])
def test_early_in_the_budget_the_two_variants_take_opposite_branches(variant: Variant) -> None:
    """t = 10 of 100: P_a1 = 0.9. phi = 0.5 explores in the program and stores in the print."""
    found = _sweep(variant, _foraging(variant, 0.5), told=10, budget=100)
    if variant == "released":
        # mean (0.4, 0.6) + levy (-0.4) + mu (r^2 U - L): 0.5 * (0.25, 0.5)
        explored = np.array([0.4, 0.6]) - 0.4 * LEVY + np.array([0.125, 0.25])
        assert_allclose(found, [explored, explored])
    else:
        # X* . l with l = 1 - 10 / 100
        assert_allclose(found, [0.9 * BEST, 0.9 * BEST])


@pytest.mark.parametrize("variant", ["released", "printed"])
def test_late_in_the_budget_it_is_the_other_way_round(variant: Variant) -> None:
    """t = 80 of 100: P_a1 = 0.2 and 0.19. phi = 0.5 stores in the program and explores in print."""
    found = _sweep(variant, _foraging(variant, 0.5), told=80, budget=100)
    if variant == "released":
        # l = 0.5 * (1 - 80 / 100)
        assert_allclose(found, [0.1 * BEST, 0.1 * BEST])
    else:
        # X_C + mu (X_A - X_B), and in x1 only mu (r^2 U - L) = 0.125
        explored = np.array([0.6 - 0.2 + 0.125, 0.8 - 0.2])
        assert_allclose(found, [explored, explored])


def test_the_probability_is_that_of_the_members_own_evaluation() -> None:
    """t = 50 and 51 of 100: P_a1 = 0.5 and 0.49. phi = 0.495 explores for the first member only."""
    found = _sweep("released", _foraging("released", 0.495), told=50, budget=100)
    # The first is at half of the budget: still the early form.
    assert_allclose(found[0], np.array([0.4, 0.6]) - 0.4 * LEVY + np.array([0.125, 0.25]))
    assert_allclose(found[1], 0.25 * BEST)  # l = 0.5 * (1 - 50 / 100)


def test_kept_coordinates_stay_where_they_are() -> None:
    found = _sweep("released", _foraging("released", 0.5, keep=HEADS), told=10, budget=100)
    assert_allclose(found, X)


@pytest.mark.parametrize(
    ("choices", "mu"), [((0.1, 0.9, 0.1, 0.9), 0.5), ((0.9, 0.1, 0.1, 0.9), 2.0)]
)
def test_mu_is_uniform_or_normal(choices: tuple[float, ...], mu: float) -> None:
    entries = _foraging("released", 0.5, mu_choices=choices)
    found = _sweep("released", entries, told=10, budget=100)
    expected = np.array([0.4, 0.6]) - 0.4 * LEVY + mu * np.array([0.25, 0.5])
    assert_allclose(found, np.minimum([expected, expected], [1.0, 2.0]))


def test_storage_towards_the_best() -> None:
    entries = _foraging("released", 0.5, storage=(HEADS, TAILS))
    found = _sweep("released", entries, told=80, budget=100)
    # X_i + mu |levy| (X* - X_i) + r1 (X_A - X_B), with the mu drawn anew: 0.25
    expected = X + 0.25 * LEVY * (BEST - X) - 0.2
    assert_allclose(found, np.maximum(expected, 0.0))


@pytest.mark.parametrize("variant", ["released", "printed"])
def test_storage_around_the_best_is_masked_in_the_program_only(variant: Variant) -> None:
    phi = 0.5 if variant == "released" else 0.1
    entries = _foraging(variant, phi, storage=(TAILS, HEADS))
    found = _sweep(variant, entries, told=80, budget=100)
    if variant == "released":
        # x1 only: X* + 0.25 (X_A - X_B) = 0.6 - 0.1; x2 stays
        assert_allclose(found, [[0.5, 0.4], [0.5, 0.8]])
    else:
        # both: X* + 0.5 (X_A - X_B)
        assert_allclose(found, [[0.4, 0.6], [0.4, 0.6]])


def _cache(variant: Variant, phi: Sequence[float]) -> list[tuple[str, Any]]:
    """Strategy II with theta = pi / 3, tau = 0.5, x2 masked, r1 = 0.5, r2 = 0.25, phi by member."""
    entries = _begin(variant, TAILS)
    entries += [("uniform", 1.0 / 3.0), ("index", A), ("index", B), ("index", C)]
    entries += [("uniform", TAILS), ("uniform", 0.5)]  # repair of the near points
    entries += [("uniform", 0.5), ("uniform", [0.9, 0.1])]
    entries += [("uniform", TAILS), ("uniform", 0.5)]  # of the far points
    entries += [("uniform", HEADS)]  # recovery by the near point
    entries += [("uniform", 0.5), ("uniform", 0.25), ("uniform", [HEADS, TAILS])]
    entries += [("uniform", TAILS), ("uniform", 0.5)]  # of the recovered ones
    return [*entries, ("uniform", phi)]


@pytest.mark.parametrize("variant", ["released", "printed"])
def test_recovery_and_search_of_the_caches(variant: Variant) -> None:
    """phi = 0.1 and 0.3 around P_a2 = 0.2: the variants recover and search in opposite members."""
    found = _sweep(variant, _cache(variant, [0.1, 0.3]), told=50, budget=100)
    # alpha = (1 - 0.5)^(2 * 0.5) = 0.5; cos 60 degrees = 0.5: reach 0.25
    near = X - 0.25 * 0.4
    jump = 2.0 if variant == "released" else (2.0 - 0.0) * 0.5
    far = X + np.array([0.0, 0.25 * jump])
    # X_i + r1 (X* - X_i) + r2 (RP - X_C), x1 only
    recovered = X.copy()
    recovered[:, 0] += 0.5 * (BEST - X)[:, 0] + 0.25 * (near[:, 0] - 0.6)
    if variant == "released":
        assert_allclose(found, [recovered[0], near[1], far[1]])
    else:
        assert_allclose(found, [near[0], far[0], recovered[1]])


def test_the_rising_branch_of_alpha_is_almost_one() -> None:
    entries = _cache("released", [0.3, 0.3])
    entries[3] = ("uniform", [HEADS, TAILS])
    found = _sweep("released", entries, told=50, budget=100)
    alpha = 0.5 ** (2.0 / 50.0)
    assert alpha > 0.97
    assert_allclose(found[0], X[0] - alpha * 0.5 * 0.4)


def test_a_member_moves_only_for_a_better_point_and_the_best_is_the_best_of_all() -> None:
    """Equation (20): strictly better, else it stays; of two reference points the better counts."""
    run = Nutcracker([0.0, 0.0], [1.0, 2.0], budget=100, settings=NutcrackerSettings(population=2))
    run.ask()
    run.tell([1.0, 0.5])
    run._positions = X.copy()
    run._best = BEST.copy()
    run._rng = Script(_cache("released", [0.1, 0.3]))  # type: ignore[assignment]
    candidates = run.ask()
    run.tell([1.0, 0.4, 0.3])  # no better than before; better; better still
    assert_allclose(run.positions, [X[0], candidates[2]])
    assert_allclose(run.best_position, candidates[2])
    assert run.best_fitness == 0.3
