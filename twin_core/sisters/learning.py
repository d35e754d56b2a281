"""Identification of a machine with what its sisters know, and whether that is to be believed.

Whether the sisters are sisters is asked of the machine's own data, twice. Their prior must explain
these at least as well as the literature's: what decides is the evidence, the probability of all
readings under a prior, the product of what would have been predicted for each reading from those
before it. A narrow prior in the right place gains, in the wrong place it loses. And what the data
say by themselves must be what one would see of a member of the family now and then.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from twin_core.identification.data import IdentificationData
from twin_core.identification.family import CalibrationRun
from twin_core.identification.identify import (
    DEFAULT_SAMPLES,
    IdentificationResult,
    Progress,
    identify,
)
from twin_core.identification.posterior import Posterior, TrainedRange
from twin_core.identification.priors import NormalPrior
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import refine
from twin_core.identification.whitening import Loss
from twin_core.models import ThermalModel
from twin_core.sisters.calibration import calibration_runs
from twin_core.sisters.population import (
    FEWEST_SISTERS,
    Sister,
    knowledge_of,
    population_prior,
    strangers,
)

FloatArray = NDArray[np.float64]

# A machine that is further off than this share of a family's members is taken for none of them.
# Among 40 development targets the least was .04; of twelve of another family five lay below.
_RAREST = 0.01
_LEAST_VARIANCE = 1e-4
# Ranges of loads and speeds that differ by less, as by their noise, are the same.
_SAME_RANGE = 0.02
# Share of the progress with which the machine itself is identified; the rest is its sisters'.
_IDENTIFIED = 0.2


@dataclass(frozen=True, slots=True)
class SisterVerdict:
    """What became of the sisters.

    Attributes
    ----------
    names, loads_n, speeds_rpm
        Of those that the prior was made of; the heaviest load in N and highest speed in rpm that
        each has seen.
    accepted
        Whether the model rests on them; if not, on the literature's prior as without sisters.
    reason
        Why, or why not.
    evidence_gain
        Natural logarithm of how many times more probable the data are under the sisters' prior than
        under the literature's; None where it was not asked.
    membership
        Share of a family's members whose own data would be further off; None where not asked.
    set_aside
        Sisters that were not used, with the reason, by name.
    calibrated_runs
        How many sisters could be played as the target.
    """

    names: Sequence[str]
    loads_n: Sequence[float]
    speeds_rpm: Sequence[float]
    accepted: bool
    reason: str
    evidence_gain: float | None
    membership: float | None
    set_aside: Mapping[str, str]
    calibrated_runs: int

    @property
    def used(self) -> int:
        """How many the prior was made of."""
        return len(self.names)

    @property
    def load_n_max(self) -> float:
        """Heaviest load in N that any of them has seen."""
        return max(self.loads_n, default=0.0)

    @property
    def speed_rpm_max(self) -> float:
        """Highest speed in rpm that any of them has seen."""
        return max(self.speeds_rpm, default=0.0)

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON types."""
        return {
            "used": self.used,
            "names": list(self.names),
            "loads_n": list(self.loads_n),
            "speeds_rpm": list(self.speeds_rpm),
            "load_n_max": self.load_n_max,
            "speed_rpm_max": self.speed_rpm_max,
            "accepted": self.accepted,
            "reason": self.reason,
            "evidence_gain": self.evidence_gain,
            "membership": self.membership,
            "set_aside": dict(self.set_aside),
            "calibrated_runs": self.calibrated_runs,
        }


@dataclass(frozen=True, slots=True, eq=False)
class WithSisters:
    """An identification with sisters.

    Attributes
    ----------
    result
        The one to use: with the sisters' prior if they were accepted, else the literature's.
    verdict
        What became of the sisters.
    prior
        The prior of ``result``; None for the literature's.
    """

    result: IdentificationResult
    verdict: SisterVerdict
    prior: NormalPrior | None


def identify_with_sisters(
    model: ThermalModel,
    data: IdentificationData,
    sisters: Sequence[Sister],
    literature: IdentificationResult,
    *,
    seed: int = 0,
    samples: int = DEFAULT_SAMPLES,
    loss: Loss = "linear",
    calibrate: bool = True,
    earlier: Posterior | None = None,
    progress: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> WithSisters:
    """Identify again with the sisters' prior, and use it if the data speak for it.

    Parameters
    ----------
    model, data
        The machine and its own low-risk data.
    sisters
        Machines of its family, all of the same model; strangers among them are set aside.
    literature
        What the same data gave with the literature's prior.
    seed, samples, loss
        As of `identify`.
    calibrate
        Whether to play each sister that has rows as the target, for the band's width.
    earlier
        A posterior of this machine from before: its calibration is used again if it was made with
        the same sisters and over the same range of loads and speeds.
    progress, cancelled
        As of `identify`.
    """
    aside = strangers(model, sisters)
    kept = [sister for sister in sisters if sister.name not in aside]
    if len(kept) < FEWEST_SISTERS:
        why = f"{len(kept)} of {len(sisters)} sisters left, expected at least {FEWEST_SISTERS}"
        return WithSisters(literature, _verdict(kept, False, why, aside), None)
    prior = population_prior(kept)
    result = identify(
        model,
        data,
        method="refine",
        guess_z=literature.posterior.z,
        seed=seed,
        samples=samples,
        loss=loss,
        prior=prior,
        progress=part_of(progress, 0.0, _IDENTIFIED),
        cancelled=cancelled,
    )
    gain = log_evidence(
        IdentificationProblem(model, data, literature.posterior.z, loss, prior=prior),
        result.posterior.z,
    ) - log_evidence(
        IdentificationProblem(model, data, literature.posterior.z, loss), literature.posterior.z
    )
    share = membership(literature.posterior, prior)
    why = ""
    if result.status != "converged":
        why = result.reason
    elif not gain >= 0.0:
        why = (
            "the sisters' prior explains the machine's own data worse than the literature's "
            f"(logarithm of the evidence {gain:+.1f})"
        )
    elif share < _RAREST:
        why = (
            "the machine's own data are not those of a sister: of such a family, "
            f"{share:.1%} would be further off"
        )
    if why:
        return WithSisters(literature, _verdict(kept, False, why, aside, gain, share), None)
    runs: tuple[CalibrationRun, ...] = ()
    if calibrate:
        onwards = part_of(progress, _IDENTIFIED, 1.0)

        def tell(fraction: float) -> None:
            if onwards is not None:
                onwards(Progress(fraction, "sampling", result.evaluations, result.best_fitness))

        trained = result.posterior.trained
        runs = _made_before(earlier, kept, trained) or calibration_runs(
            model, kept, trained, seed=seed, progress=tell, cancelled=cancelled
        )
    known = replace(knowledge_of(kept), calibration=runs)
    why = (
        f"the prior of {len(kept)} sisters explains the machine's own data better than the "
        f"literature's (logarithm of the evidence {gain:+.1f})"
    )
    posterior = replace(result.posterior, sisters=known)
    return WithSisters(
        replace(result, posterior=posterior),
        _verdict(kept, True, why, aside, gain, share, len(runs)),
        prior,
    )


def _made_before(
    earlier: Posterior | None, kept: Sequence[Sister], trained: TrainedRange
) -> tuple[CalibrationRun, ...]:
    """Give the calibration of an earlier posterior if it would be the same now."""
    if earlier is None or earlier.sisters is None:
        return ()
    known, range_then = earlier.sisters, earlier.trained
    same = set(known.names) == {sister.name for sister in kept} and np.allclose(
        [range_then.load_n_max, range_then.speed_rpm_max],
        [trained.load_n_max, trained.speed_rpm_max],
        rtol=_SAME_RANGE,
    )
    reached = sorted(known.loads_n) + sorted(known.speeds_rpm)
    reach = sorted(sister.trained.load_n_max for sister in kept) + sorted(
        sister.trained.speed_rpm_max for sister in kept
    )
    return known.calibration if same and np.allclose(reached, reach, rtol=_SAME_RANGE) else ()


def part_of(
    progress: Callable[[Progress], None] | None, begin: float, end: float
) -> Callable[[Progress], None] | None:
    """Tell the progress of a part of the work as that of the whole.

    Parameters
    ----------
    progress
        Is told; None for nobody.
    begin, end
        Where the part begins and ends in the whole, 0 to 1.
    """
    if progress is None:
        return None
    return lambda part: progress(replace(part, fraction=begin + (end - begin) * part.fraction))


def membership(own: Posterior, prior: NormalPrior) -> float:
    """Share of a family's members whose own data would be further off than a machine's.

    What a machine's own data say, with the literature's prior, is its coordinates z shrunk towards
    zero: (I - C) z and an error of covariance C (I - C). For z of the family both are normal.

    Parameters
    ----------
    own
        Posterior of the machine's own data with the literature's prior.
    prior
        Of the family.
    """
    covariance = own.covariance
    shrunk = np.eye(len(covariance)) - covariance
    spread = shrunk @ prior.covariance @ shrunk.T + covariance @ shrunk
    variances, directions = np.linalg.eigh(0.5 * (spread + spread.T))
    seen = variances > _LEAST_VARIANCE
    off = directions[:, seen].T @ (own.z - shrunk @ prior.mean)
    distance = float(np.sum(off**2 / variances[seen]))
    return float(gammaincc(0.5 * np.count_nonzero(seen), 0.5 * distance))


def log_evidence(problem: IdentificationProblem, z: FloatArray) -> float:
    """Natural logarithm of the data's probability under the problem's prior, but for a constant.

    By the Laplace approximation around the optimum. The constant is the same for all priors on the
    same data, if their problems have the same guess of the initial states.

    Parameters
    ----------
    problem, z
        The problem and its best parameters (p,); infinitely improbable where no simulation holds.
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


def _verdict(
    kept: Sequence[Sister],
    accepted: bool,
    reason: str,
    aside: Mapping[str, str],
    gain: float | None = None,
    share: float | None = None,
    runs: int = 0,
) -> SisterVerdict:
    return SisterVerdict(
        [sister.name for sister in kept],
        [sister.trained.load_n_max for sister in kept],
        [sister.trained.speed_rpm_max for sister in kept],
        accepted,
        reason,
        gain,
        share,
        dict(aside),
        runs,
    )
