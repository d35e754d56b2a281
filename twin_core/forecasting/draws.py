"""Random draws that an ensemble is made of, in antithetic pairs."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.posterior import Posterior

FloatArray = NDArray[np.float64]

_DRAWN_AT_ONCE = 1 << 16
#: Draws that are kept, and the largest: those of an ensemble of 200 members over four hours are
#: three and half a million numbers, 4 MB.
_KEPT, _LARGEST = 9, 1_000_000


def parameter_draws(rng: np.random.Generator, members: int, posterior: Posterior) -> FloatArray:
    """Standard coordinates (members, p): the posterior's samples, or the normal distribution."""
    count = len(posterior.samples)
    if count == 0:
        return posterior.z + normal_draws(rng, members, posterior.covariance)
    # Whole rounds through the samples before any is used once more than another.
    order = np.concatenate([rng.permutation(count) for _ in range(-(-members // count))])
    return np.asarray(posterior.samples[order[:members]])


def paired_draws(rng: np.random.Generator, members: int, shape: tuple[int, ...]) -> FloatArray:
    """Standard normal numbers (members, ...) in antithetic pairs; members is even."""
    half = rng.standard_normal((members // 2, *shape))
    return np.concatenate((half, -half))


def normal_draws(rng: np.random.Generator, members: int, covariance: FloatArray) -> FloatArray:
    """Antithetic draws (members, k) of N(0, covariance); the covariance may be singular."""
    variance, directions = np.linalg.eigh(0.5 * (covariance + covariance.T))
    factor = directions * np.sqrt(np.maximum(variance, 0.0))
    return np.asarray(paired_draws(rng, members, (len(covariance),)) @ factor.T)


def standard_normals(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Draw as `rng.standard_normal` does, and to the same figures; not to be written to.

    Ensembles of one seed draw the same numbers again and again, of which the latest are kept.

    `rng`: with PCG64, as of `numpy.random.default_rng`.
    """
    if math.prod(shape) > _LARGEST:
        return _in_pieces(rng, shape)
    before = rng.bit_generator.state
    inner = before["state"]
    drawn, after = _drawn(
        inner["state"], inner["inc"], before["has_uint32"], before["uinteger"], shape
    )
    rng.bit_generator.state = {**before, "state": {**inner, "state": after}}
    return drawn


@lru_cache(_KEPT)
def _drawn(
    state: int, increment: int, has_uint32: int, uinteger: int, shape: tuple[int, ...]
) -> tuple[FloatArray, int]:
    """Standard normal numbers from a state of PCG64, and its state afterwards."""
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": state, "inc": increment},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    drawn = _in_pieces(np.random.Generator(bits), shape)
    return drawn, bits.state["state"]["state"]


def _in_pieces(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Draw, and let other threads run now and then.

    numpy holds the interpreter while it draws: millions at once would stop all of them for a
    tenth of a second.
    """
    drawn = np.empty(shape)
    flat = drawn.reshape(-1)
    for begin in range(0, flat.size, _DRAWN_AT_ONCE):
        rng.standard_normal(out=flat[begin : begin + _DRAWN_AT_ONCE])
    return drawn
