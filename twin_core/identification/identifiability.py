"""What given windows can say about a model's parameters, and what they cannot, whatever the fit.

The sensitivities of all measurements to the parameters, in units of the noise per prior standard
deviation and with sensor lag and initial states eliminated, are decomposed: S = U diag(s) V'. Each
row of V' is a combination of parameters that the data see as one. A posteriori its standard
deviation is 1 / sqrt(1 + s^2) of the prior's: s = 1 is a combination of which data and prior know
equally much. Parameters on their own may all look vague while some of their combinations are known
very well, and it is those that forecasts rest on.

The rank counts the combinations that leave any trace at all in noise-free data. One operating point
too few shows in it: with one speed the paper's 15 parameters have rank 6, with two 11, with three
or more 15 (a network whose contact resistances and four Nusselt numbers depend on speed by laws of
several parameters each cannot be distinguished at fewer speeds).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.problem import IdentificationProblem

FloatArray = NDArray[np.float64]
Verdict = Literal["informed", "weak", "prior only"]

# Posterior over prior standard deviation below which something counts as informed, and as weak.
_INFORMED, _WEAK = 0.5, 0.9
# Singular values below this share of the largest are noise of the derivatives.
_RANK_TOLERANCE = 1e-6
_LARGEST_CONDITION = 1e16
# Weights below these are left out of documents and of the text.
_WEIGHT, _WEIGHT_IN_TEXT, _NAMES_IN_TEXT = 0.05, 0.2, 5


def verdict(std: float) -> Verdict:
    """What the data say, by the posterior's standard deviation in units of the prior's."""
    return "informed" if std < _INFORMED else "weak" if std < _WEAK else "prior only"


@dataclass(frozen=True, slots=True)
class ParameterCombination:
    """A combination of parameters."""

    strength: float  # singular value: prior standard deviation over that of the data alone
    std: float  # posterior standard deviation in units of the prior's
    verdict: Verdict  # see `verdict`
    #: Share of each parameter's standard coordinate, the largest first and positive; the squares of
    #: all sum to one.
    weights: dict[str, float]

    @property
    def text(self) -> str:
        """The main weights as a formula, such as ``0.83 M0 - 0.41 p``."""
        main = [
            (name, weight)
            for number, (name, weight) in enumerate(self.weights.items())
            if number == 0 or (number < _NAMES_IN_TEXT and abs(weight) >= _WEIGHT_IN_TEXT)
        ]
        parts = [f"{'-' if weight < 0 else '+'} {abs(weight):.2f} {name}" for name, weight in main]
        return " ".join(parts).removeprefix("+ ")


@dataclass(frozen=True, slots=True, eq=False)
class Identifiability:
    """What windows say about p parameters."""

    names: tuple[str, ...]
    singular_values: FloatArray  # (p,) descending
    directions: FloatArray  # (p, p) orthonormal rows: the combinations in standard coordinates

    @property
    def rank(self) -> int:
        """Number of combinations that leave a trace in noise-free data."""
        largest = float(self.singular_values[0])
        return int(np.count_nonzero(self.singular_values > _RANK_TOLERANCE * largest))

    @property
    def condition(self) -> float:
        """Largest over smallest singular value, at most 1e16; 1 without any information."""
        largest, smallest = float(self.singular_values[0]), float(self.singular_values[-1])
        if largest == 0.0:
            return 1.0
        return largest / max(smallest, largest / _LARGEST_CONDITION)

    @property
    def covariance(self) -> FloatArray:
        """(p, p) posterior covariance of the standard coordinates; the prior's is the identity."""
        covariance = (self.directions.T / (1.0 + self.singular_values**2)) @ self.directions
        return np.asarray(0.5 * (covariance + covariance.T))

    def covariance_with(self, factor: FloatArray) -> FloatArray:
        """(p, p) posterior covariance with another prior, of covariance factor @ factor.T."""
        seen = (self.singular_values[:, None] * self.directions) @ factor
        p = len(factor)
        covariance = factor @ np.linalg.solve(np.eye(p) + seen.T @ seen, factor.T)
        return np.asarray(0.5 * (covariance + covariance.T))

    @property
    def informed_shares(self) -> FloatArray:
        """(p,) share of each parameter's prior variance that the data take away, 0 to 1."""
        return np.asarray(np.clip(1.0 - np.diag(self.covariance), 0.0, 1.0))

    @property
    def combinations(self) -> tuple[ParameterCombination, ...]:
        """All p combinations, the best known first."""
        return tuple(
            self._combination(float(strength), direction)
            for strength, direction in zip(self.singular_values, self.directions, strict=True)
        )

    def count(self, wanted: Verdict) -> int:
        """Number of combinations with a verdict."""
        return sum(one.verdict == wanted for one in self.combinations)

    def _combination(self, strength: float, direction: FloatArray) -> ParameterCombination:
        std = 1.0 / float(np.sqrt(1.0 + strength**2))
        order = np.argsort(-np.abs(direction), kind="stable")
        sign = -1.0 if direction[order[0]] < 0.0 else 1.0
        weights = {
            self.names[k]: float(sign * direction[k])
            for k in order
            if abs(direction[k]) >= _WEIGHT or k == order[0]
        }
        return ParameterCombination(strength, std, verdict(std), weights)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types; weights below 0.05 are left out."""
        return {
            "rank": self.rank,
            "condition": self.condition,
            "informed": self.count("informed"),
            "weak": self.count("weak"),
            "prior_only": self.count("prior only"),
            "combinations": [
                {
                    "combination": one.text,
                    "weights": {name: round(weight, 4) for name, weight in one.weights.items()},
                    "strength": one.strength,
                    "std_over_prior": one.std,
                    "verdict": one.verdict,
                }
                for one in self.combinations
            ],
        }


def identifiability(problem: IdentificationProblem, unknowns: FloatArray) -> Identifiability:
    """Decompose what a problem's windows say at a point.

    `unknowns` (d,) where: the optimum, or `IdentificationProblem.with_nuisance` of any parameters.
    """
    p, m = problem.parameter_count, problem.measurement_count
    jacobian = problem.jacobian(unknowns)
    return of_sensitivities(problem.model.parameters.names, jacobian[:m, :p], jacobian[:m, p:])


def of_sensitivities(
    names: Sequence[str], sensitivities: FloatArray, nuisance: FloatArray | None = None
) -> Identifiability:
    """Decompose whitened sensitivities.

    `sensitivities` (m, p) of unit-variance measurements to standard coordinates; `nuisance` (m, q)
    to other unknowns with standard normal priors, which are regressed out.
    """
    m, p = sensitivities.shape
    if nuisance is not None and nuisance.shape[1]:
        q = nuisance.shape[1]
        basis, _ = np.linalg.qr(np.concatenate((nuisance, np.eye(q))))
        sensitivities = np.concatenate((sensitivities, np.zeros((q, p))))
        sensitivities = sensitivities - basis @ (basis.T @ sensitivities)
    # With fewer measurements than parameters there are directions that none of them sees.
    padded = np.concatenate((sensitivities, np.zeros((max(p - m, 0), p))))
    _, singular, directions = np.linalg.svd(padded, full_matrices=False)
    return Identifiability(tuple(names), singular, directions)


def of_covariance(names: Sequence[str], covariance: FloatArray) -> Identifiability:
    """Decompose a posterior covariance (p, p) of standard coordinates.

    Singular values below some 1e-7 are lost in rounding, so the rank is not to be had from it.
    """
    variances, vectors = np.linalg.eigh(covariance)
    strengths = np.sqrt(np.maximum(1.0 / np.maximum(variances, 1e-300) - 1.0, 0.0))
    return Identifiability(tuple(names), strengths, vectors.T.copy())
