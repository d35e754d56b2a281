"""How far each law of a machine is its family's: a mixture over which of them to doubt.

A family may be one in its housings and not in its friction. So each law (`blocks.laws_of`) has its
own doubt: a priori one in ten that the family's is not this machine's, which then has the
literature's. That is the robust meta-analytic-predictive prior of Schmidli et al. (2014), by
block. The machine's own data give the odds: the evidence, which is the probability of all readings
under a prior. Where they say nothing of a law its doubt stays what it was; a stage at another load
settles that of the load law. The posterior is the mixture of those under each prior.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.data import IdentificationData
from twin_core.identification.family import Law, LawSource, LawTrust
from twin_core.identification.identify import FitSettings, IdentificationResult, fit_problem
from twin_core.identification.posterior import Posterior, TrainedRange, posterior_at
from twin_core.identification.priors import NormalPrior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import refine
from twin_core.identification.sampling import posterior_samples
from twin_core.models import ThermalModel
from twin_core.sisters.blocks import doubted, information, laws_of, load_growth

FloatArray = NDArray[np.float64]

DOUBT = 0.1
"""A priori, of each law separately. What it costs with true sisters and saves with wrong ones is in
`docs/trust/sisters.md`: the study ``trust``."""

# The errors that evidence is reckoned with are those that the machine's own residuals show: these
# readings count as one for each of them, so many as expected, and no less than this in variance.
_EXPECTED_READINGS = 50
_LEAST_VARIANCE = 0.2
# Own data that say less than this of a law, in nats, have not tested it.
_TESTED_NATS = 0.5
# An answer of this probability is followed by those that differ from it by one law.
_WORTH_A_LOOK = 0.05
_STAGE_MIN, _STAGE_FACTOR = 20, 1.25


@dataclass(frozen=True, slots=True, eq=False)
class _Belief:
    """One answer to which laws are the family's, and what the data say under it."""

    doubts: frozenset[Law]  # the laws that are the literature's
    prior: NormalPrior | None  # None for the literature's
    posterior: Posterior  # with samples, if these were drawn
    #: To draw more samples around ``unknowns``.
    problem: IdentificationProblem
    unknowns: FloatArray
    log_evidence: float


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """What is believed of a machine after its own data."""

    #: Of the most probable answer, but for its posterior, which is the mixture's.
    result: IdentificationResult
    laws: Mapping[Law, LawTrust]
    prior: NormalPrior | None  # of the most probable answer; None for the literature's
    #: Natural logarithm of how many times more probable the family makes the data than the
    #: literature does.
    evidence_gain: float


def mixture(
    model: ThermalModel,
    data: IdentificationData,
    prior: NormalPrior,
    family: IdentificationResult,
    literature: IdentificationResult,
    fit: FitSettings,
    cancelled: Callable[[], bool] | None = None,
) -> Mixture:
    """Mix what the data say under all answers.

    `prior`: the family's; `family`, `literature`: what the data gave with it and with the
    literature's, both around the literature's initial states.
    """
    asked = _Asked(model, data, prior, literature, fit, laws_of(model), cancelled)
    beliefs = [
        asked.belief(frozenset(), family.posterior, family.unknowns),
        asked.belief(frozenset(asked.laws), literature.posterior, literature.unknowns),
    ]
    tried = {one.doubts for one in beliefs}
    while (fresh := _next_to_look_at(beliefs, asked.laws, tried)) is not None:
        doubts, start = fresh
        tried.add(doubts)
        found = asked.refined(doubts, start)
        beliefs += [] if found is None else [found]
    weights = _weights(beliefs, len(asked.laws))
    best = beliefs[int(np.argmax(weights))]
    posterior = _mixed(model, beliefs, weights, best, fit)
    why = fit_problem(posterior, model.errors)
    result = replace(
        family,
        posterior=posterior,
        status="failed fit" if why else "converged",
        reason=why or family.reason,
        best_fitness=float(np.sum(best.problem.residuals(best.unknowns) ** 2)),
        unknowns=best.unknowns,
        evaluations=posterior.evaluations,
    )
    return Mixture(
        result,
        _trust(asked.laws, beliefs, weights, prior),
        best.prior,
        beliefs[0].log_evidence - beliefs[1].log_evidence,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """What all beliefs of a machine have in common."""

    model: ThermalModel
    data: IdentificationData
    prior: NormalPrior  # the family's
    literature: IdentificationResult
    fit: FitSettings
    laws: Mapping[Law, Sequence[int]]
    cancelled: Callable[[], bool] | None

    def refined(self, doubts: frozenset[Law], z: FloatArray) -> _Belief | None:
        """What the data say where these laws are the literature's; None where nothing holds."""
        problem = self._problem(self.model, self._prior(doubts))
        found = refine(problem, problem.with_nuisance(z), cancelled=self.cancelled)
        if found is None:
            return None
        return self.belief(doubts, posterior_at(problem, found.unknowns), found.unknowns)

    def belief(self, doubts: frozenset[Law], posterior: Posterior, unknowns: FloatArray) -> _Belief:
        """Give what was found with its evidence."""
        prior = self._prior(doubts)
        honest = _with_own_errors(self.model, self.literature.posterior, self.data)
        likely = log_evidence(self._problem(honest, prior), posterior.z)
        problem = self._problem(self.model, prior)
        return _Belief(doubts, prior, posterior, problem, unknowns, likely)

    def _prior(self, doubts: frozenset[Law]) -> NormalPrior | None:
        if len(doubts) == len(self.laws):
            return None
        return doubted(self.prior, [row for law in doubts for row in self.laws[law]])

    def _problem(self, model: ThermalModel, prior: NormalPrior | None) -> IdentificationProblem:
        guess = self.literature.posterior.z
        return IdentificationProblem(model, self.data, guess, self.fit.loss, prior=prior)


def log_evidence(problem: IdentificationProblem, z: FloatArray) -> float:
    """Natural logarithm of the data's probability under the problem's prior, but for a constant.

    By the Laplace approximation around the optimum, from the best parameters `z` (p,); infinitely
    improbable where no simulation holds. The constant is the same for all priors on the same data,
    if their problems have the same guess of the initial states.
    """
    # With the problem's own initial states, whatever guess the parameters were found with.
    found = refine(problem, problem.with_nuisance(z))
    if found is None:
        return -np.inf
    unknowns = found.unknowns
    residuals = problem.residuals(unknowns)[0]
    jacobian = problem.jacobian(unknowns)
    curvature = np.linalg.slogdet(jacobian.T @ jacobian)[1]
    return float(-0.5 * residuals @ residuals - 0.5 * curvature - problem.prior.log_determinant)


def _with_own_errors(model: ThermalModel, own: Posterior, data: IdentificationData) -> ThermalModel:
    """The model with errors as large as the machine's own residuals say.

    The usual ones are made for forecasts and several times too large for what they are within the
    data; evidence that is reckoned with them counts a reading for a part of what it is worth.
    """
    readings = sum(
        int(np.count_nonzero(np.isfinite(values[window.minutes.good])))
        for window in data.windows
        for values in window.minutes.temperatures_c.values()
    )
    squares = _EXPECTED_READINGS + readings * own.cost_per_residual
    scale = np.sqrt(max(squares / (_EXPECTED_READINGS + readings), _LEAST_VARIANCE))
    errors = model.errors
    scaled = replace(
        errors,
        white_k=float(scale * errors.white_k),
        slow_k=float(scale * errors.slow_k),
        offset_k=float(scale * errors.offset_k),
    )
    return replace(model, errors=scaled)


def _weights(beliefs: Sequence[_Belief], laws: int) -> FloatArray:
    """Probability of each answer.

    All laws are doubted alike, and each separately.
    """
    doubts = np.array([len(one.doubts) for one in beliefs])
    before = DOUBT**doubts * (1.0 - DOUBT) ** (laws - doubts)
    logarithms = np.log(before) + np.array([one.log_evidence for one in beliefs])
    weights = np.exp(logarithms - np.max(logarithms))
    return np.asarray(weights / np.sum(weights))


def _next_to_look_at(
    beliefs: Sequence[_Belief], laws: Mapping[Law, Sequence[int]], tried: set[frozenset[Law]]
) -> tuple[frozenset[Law], FloatArray] | None:
    """An answer that differs by one law from a probable one, and the parameters to begin from."""
    for one, weight in zip(beliefs, _weights(beliefs, len(laws)), strict=True):
        for law in laws:
            doubts = one.doubts ^ {law}
            if weight >= _WORTH_A_LOOK and doubts not in tried:
                return doubts, one.posterior.z
    return None


def _mixed(
    model: ThermalModel,
    beliefs: Sequence[_Belief],
    weights: FloatArray,
    best: _Belief,
    fit: FitSettings,
) -> Posterior:
    """The posterior of the mixture, around the most probable answer's."""
    pairs = fit.samples // 2
    shares = np.floor(weights * pairs).astype(int)
    rest = np.argsort(shares - weights * pairs)[: pairs - int(shares.sum())]
    shares[rest] += 1
    samples = np.concatenate(
        [
            _samples(model, one, 2 * int(count), fit)
            for one, count in zip(beliefs, shares, strict=True)
        ]
    )
    centre = best.posterior.z
    covariance = np.zeros(best.posterior.covariance.shape)
    for one, weight in zip(beliefs, weights, strict=True):
        off = one.posterior.z - centre
        covariance += weight * (one.posterior.covariance + np.outer(off, off))
    return replace(
        best.posterior,
        samples=samples,
        covariance=covariance,
        evaluations=sum(one.problem.evaluations for one in beliefs),
    )


def _samples(model: ThermalModel, one: _Belief, count: int, fit: FitSettings) -> FloatArray:
    """Samples (count, p) of an answer's posterior, spread evenly over what they make of a load.

    The edge of the mixture's band is inside the few that doubt the load law: drawn at random, they
    would move it by a third of their spread.
    """
    drawn = one.posterior.samples
    if count == 0 or len(drawn) == count:
        return drawn[:count]
    if len(drawn) < count:
        drawn = posterior_samples(one.problem, one.unknowns, fit.samples, fit.seed)
    order = np.argsort([load_growth(model, z) for z in drawn])
    taken = (np.arange(count) + 0.5) * len(drawn) / count
    return np.asarray(drawn[order[taken.astype(int)]])


def _trust(
    laws: Mapping[Law, Sequence[int]],
    beliefs: Sequence[_Belief],
    weights: FloatArray,
    prior: NormalPrior,
) -> dict[Law, LawTrust]:
    """What is said of each law."""
    found: dict[Law, LawTrust] = {}
    for law, rows in laws.items():
        weight = 1.0 - sum(
            float(share) for one, share in zip(beliefs, weights, strict=True) if law in one.doubts
        )
        alone = _doubting(law, beliefs)
        own_nats = information(alone.posterior.covariance, rows)
        source: LawSource = "family" if weight >= 0.5 else "literature"
        if own_nats > information(prior.covariance, rows):
            source = "own"
        tested = own_nats >= _TESTED_NATS
        found[law] = LawTrust(
            source,
            weight,
            _log_bayes_factor(law, beliefs),
            tested,
            None if tested else settled_by(law, alone.posterior.trained),
        )
    return found


def laws_without_sisters(model: ThermalModel, posterior: Posterior) -> dict[Law, LawTrust]:
    """Where each law of a posterior with the literature's prior comes from."""
    found: dict[Law, LawTrust] = {}
    for law, rows in laws_of(model).items():
        tested = posterior.identified
        tested = tested and information(posterior.covariance, rows) >= _TESTED_NATS
        settles = None if tested else settled_by(law, posterior.trained)
        source: LawSource = "own" if tested else "literature"
        found[law] = LawTrust(source, 0.0, None, tested, settles)
    return found


def _doubting(law: Law, beliefs: Sequence[_Belief]) -> _Belief:
    """The most probable answer that doubts a law; the fewest further doubts among equals."""
    return max(
        (one for one in beliefs if law in one.doubts),
        key=lambda one: one.log_evidence + len(one.doubts) * np.log(DOUBT),
    )


def _log_bayes_factor(law: Law, beliefs: Sequence[_Belief]) -> float:
    """For the family's law against the literature's, over what is doubted besides."""

    def likely(doubting: bool) -> float:
        return float(
            np.logaddexp.reduce(
                [
                    one.log_evidence + len(one.doubts - {law}) * np.log(DOUBT / (1.0 - DOUBT))
                    for one in beliefs
                    if (law in one.doubts) == doubting
                ]
            )
        )

    return likely(False) - likely(True)


def settled_by(law: Law, trained: TrainedRange) -> str | None:
    """What would test a law that a machine's own data say nothing about."""
    if law == "housing":
        return None
    if law == "start" or not trained.points:
        return "one start of the cold machine"
    if law == "load":
        return f"{_STAGE_MIN} min at {_rounded(_STAGE_FACTOR * trained.load_n_max)} N"
    return f"{_STAGE_MIN} min at {_rounded(_STAGE_FACTOR * trained.speed_rpm_max)} rpm"


def _rounded(value: float) -> str:
    """Two significant digits."""
    return f"{float(f'{value:.1e}'):.0f}"
