"""The single moves of the Nutcracker Optimization Algorithm, as pure functions.

Every function takes the random numbers that its equation needs, so that each branch can be
checked against values worked out by hand. Rows are members, columns are coordinates; arguments
broadcast, so one call moves one member or a whole population. Equation numbers are those of
Abdel-Basset, Mohamed, Jameel, Abouhawwash, Knowledge-Based Systems 262 (2023) 110248,
doi 10.1016/j.knosys.2022.110248.
"""

from math import gamma, pi, sin
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Variant = Literal["released", "printed"]


def mantegna_sigma(exponent: float) -> float:
    """Return the scale of the numerator of Mantegna's Lévy step for a stability ``exponent``."""
    numerator = gamma(1.0 + exponent) * sin(pi * exponent / 2.0)
    denominator = gamma((1.0 + exponent) / 2.0) * exponent * 2.0 ** ((exponent - 1.0) / 2.0)
    return float((numerator / denominator) ** (1.0 / exponent))


def levy_steps(
    rng: np.random.Generator, shape: tuple[int, ...], exponent: float = 1.5, scale: float = 0.05
) -> FloatArray:
    """Draw scaled Lévy steps of the given shape by Mantegna's method."""
    numerator = rng.standard_normal(shape) * mantegna_sigma(exponent)
    denominator = np.abs(rng.standard_normal(shape)) ** (1.0 / exponent)
    return np.asarray(scale * numerator / denominator)


def step_factor(
    variant: Variant,
    choices: FloatArray,
    uniform: FloatArray,
    normal: FloatArray,
    levy: FloatArray,
) -> FloatArray:
    """Return the step factor mu of Eq. 2, one number per member.

    `variant`: ``"released"``: two independent coins (50 % uniform, 25 % normal, 25 % Lévy).
    ``"printed"``: r1 < r2, then r2 < r3, else the Lévy number. The printed third condition r1 < r3
    cannot hold where the first two failed, so it is read as "otherwise". `choices` (n, 4) uniform
    numbers; the released coins compare columns 0 with 1 and 2 with 3, the printed conditions use
    columns 0 to 2 as r1, r2, r3; `uniform`, `normal`, `levy` (n,) candidates for mu.
    """
    first = choices[:, 0] < choices[:, 1]
    if variant == "released":
        second = choices[:, 2] < choices[:, 3]
    else:
        second = choices[:, 1] < choices[:, 2]
    return np.where(first, uniform, np.where(second, normal, levy))


def forage_early(
    position: FloatArray,
    mean: FloatArray,
    member_a: FloatArray,
    member_b: FloatArray,
    levy: FloatArray,
    mu: FloatArray,
    r: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    keep: BoolArray,
) -> FloatArray:
    """Eq. 1 in the first half of the budget: around the population mean, with a wide jump."""
    moved = mean + levy * (member_a - member_b) + mu * (r**2 * upper - lower)
    return np.where(keep, position, moved)


def forage_late(
    position: FloatArray,
    member_a: FloatArray,
    member_b: FloatArray,
    member_c: FloatArray,
    mu: FloatArray,
    r: FloatArray,
    jump: BoolArray,
    lower: FloatArray,
    upper: FloatArray,
    keep: BoolArray,
) -> FloatArray:
    """Eq. 1 in the second half: around a random member; the wide jump only where ``jump``."""
    wide = np.where(jump, mu * (r**2 * upper - lower), 0.0)
    moved = member_c + mu * (member_a - member_b) + wide
    return np.where(keep, position, moved)


def store_towards_best(
    position: FloatArray,
    best: FloatArray,
    member_a: FloatArray,
    member_b: FloatArray,
    levy: FloatArray,
    mu: FloatArray,
    r1: FloatArray,
) -> FloatArray:
    """Eq. 3, first branch: a Lévy-scaled pull towards the best plus a random difference."""
    return position + mu * np.abs(levy) * (best - position) + r1 * (member_a - member_b)


def store_around_best(
    position: FloatArray,
    best: FloatArray,
    member_a: FloatArray,
    member_b: FloatArray,
    mu: FloatArray,
    moves: BoolArray,
) -> FloatArray:
    """Eq. 3, second branch: a random difference around the best, in the coordinates ``moves``.

    The released code moves each coordinate with probability one half, the printed form moves all.
    """
    return np.where(moves, best + mu * (member_a - member_b), position)


def store_towards_origin(best: FloatArray, shrink: FloatArray) -> FloatArray:
    """Eq. 3, third branch: the best scaled by l (a known bias towards the coordinate origin)."""
    return best * shrink


def cache_step(fraction: float, evaluations: int, rising: bool) -> float:
    """Return alpha of Eq. 11 for t = ``evaluations`` > 0 and ``fraction`` = t / T."""
    if rising:
        return float(fraction ** (2.0 / evaluations))
    return float(max(0.0, 1.0 - fraction) ** (2.0 * fraction))


def reference_point_near(
    position: FloatArray, member_a: FloatArray, member_b: FloatArray, reach: FloatArray
) -> FloatArray:
    """Eq. 9: the first reference point; ``reach`` = alpha cos(theta)."""
    return position + reach * (member_a - member_b)


def reference_point_far(
    variant: Variant,
    position: FloatArray,
    reach: FloatArray,
    tau: FloatArray,
    mask: BoolArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray:
    """Eq. 10: the second reference point, in the coordinates of ``mask``.

    The printed jump is (U - L) tau + L, the released code has (U - L) + L = U.
    """
    jump = upper if variant == "released" else (upper - lower) * tau + lower
    return np.where(mask, position + reach * jump, position)


def recover_cache(
    position: FloatArray,
    best: FloatArray,
    reference_point: FloatArray,
    member_c: FloatArray,
    r1: FloatArray,
    r2: FloatArray,
    changes: BoolArray,
) -> FloatArray:
    """Eqs. 13, 15: towards the best and along a reference point, in the coordinates ``changes``."""
    moved = position + r1 * (best - position) + r2 * (reference_point - member_c)
    return np.where(changes, moved, position)


def repair(
    trial: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    redraw: BoolArray,
    uniform: FloatArray,
) -> FloatArray:
    """Bring trials back into the box.

    `trial` (n, d) points. A NaN coordinate counts as outside. `redraw` (n, 1) one coin per trial:
    True draws every violating coordinate again in its box, False clamps all of them (NaN goes to
    the lower bound). `uniform` (n, d) uniform numbers for the new draws.
    """
    inside = (trial >= lower) & (trial <= upper)
    fresh = np.clip(lower + uniform * (upper - lower), lower, upper)  # rounding may step out
    clamped = np.where(np.isnan(trial), lower, np.clip(trial, lower, upper))
    return np.where(inside, trial, np.where(redraw, fresh, clamped))
