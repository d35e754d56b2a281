"""Identification of a machine with what its sisters know, each law as far as it is to be believed.

What the sisters know is one prior; `twin_core.sisters.trust` says how far each law of it is trusted
and mixes it with the literature's.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin_core.identification.data import IdentificationData
from twin_core.identification.family import Law, LawTrust, SisterRun
from twin_core.identification.identify import (
    FitSettings,
    IdentificationProgress,
    IdentificationResult,
    identify,
)
from twin_core.identification.posterior import Posterior, TrainedRange
from twin_core.identification.priors import NormalPrior
from twin_core.models import ThermalModel
from twin_core.sisters.calibration import calibration_runs
from twin_core.sisters.population import (
    FEWEST_SISTERS,
    Sister,
    knowledge_of,
    population_prior,
    strangers,
)
from twin_core.sisters.trust import Mixture, laws_without_sisters, mixture

# Ranges of loads and speeds that differ by less, as by their noise, are the same.
_SAME_RANGE = 0.02
# Share of the progress with which the machine itself is identified; the rest is its sisters'.
_IDENTIFIED = 0.2


@dataclass(frozen=True, slots=True)
class SisterVerdict:
    """What became of the sisters."""

    #: Of those that the prior was made of; the heaviest load in N and highest speed in rpm that
    #: each has seen.
    names: Sequence[str]
    loads_n: Sequence[float]
    speeds_rpm: Sequence[float]
    #: Whether any law rests on them; if not, all are the literature's, as without sisters.
    accepted: bool
    reason: str
    #: Natural logarithm of how many times more probable the data are under the sisters' prior than
    #: under the literature's; None where it was not asked.
    evidence_gain: float | None
    set_aside: Mapping[str, str]  # sisters that were not used, with the reason, by name
    calibrated_runs: int  # how many sisters could be played as the target
    #: How far each law is trusted; empty where the data were not asked.
    laws: Mapping[Law, LawTrust] = field(default_factory=dict)

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
            "set_aside": dict(self.set_aside),
            "calibrated_runs": self.calibrated_runs,
        }


@dataclass(frozen=True, slots=True, eq=False)
class WithSisters:
    """An identification with sisters."""

    #: The one to use: the mixture of both priors, or the literature's where no law is the sisters'.
    result: IdentificationResult
    verdict: SisterVerdict
    prior: NormalPrior | None  # the most probable of ``result``; None for the literature's


def identify_with_sisters(
    model: ThermalModel,
    data: IdentificationData,
    sisters: Sequence[Sister],
    literature: IdentificationResult,
    fit: FitSettings = FitSettings(),  # noqa: B008 - frozen
    *,
    calibrate: bool = True,
    earlier: Posterior | None = None,
    progress: Callable[[IdentificationProgress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> WithSisters:
    """Identify again with the sisters' prior, and use it law by law as far as the data let it.

    `sisters`: machines of its family, all of the same model; strangers among them are set aside;
    `literature`: what the same data gave with the literature's prior; `calibrate`: whether to play
    each sister that has rows as the target, for the band's width; `earlier`: a posterior of this
    machine from before: its calibration is used again if it was made with the same sisters and over
    the same range of loads and speeds.
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
        replace(fit, method="refine"),
        guess_z=literature.posterior.z,
        prior=prior,
        progress=part_of(progress, 0.0, _IDENTIFIED),
        cancelled=cancelled,
    )
    mixed = mixture(model, data, prior, result, literature, fit, cancelled)
    result, why = mixed.result, _said(mixed, len(kept))
    if result.status != "converged":
        why = result.reason
    if result.status != "converged" or not any(
        trust.rests_on_family for trust in mixed.laws.values()
    ):
        return WithSisters(literature, _verdict(kept, False, why, aside, mixed), None)
    runs: tuple[SisterRun, ...] = ()
    if calibrate:
        onwards = part_of(progress, _IDENTIFIED, 1.0)

        def report(fraction: float) -> None:
            if onwards is not None:
                onwards(
                    IdentificationProgress(
                        fraction, "sampling", result.evaluations, result.best_fitness
                    )
                )

        trained = result.posterior.trained
        runs = _made_before(earlier, kept, trained) or calibration_runs(
            model, kept, trained, seed=fit.seed, progress=report, cancelled=cancelled
        )
    known = replace(knowledge_of(kept), calibration=runs, laws=mixed.laws)
    posterior = replace(result.posterior, sisters=known)
    return WithSisters(
        replace(result, posterior=posterior),
        _verdict(kept, True, why, aside, mixed, len(runs)),
        mixed.prior,
    )


def law_documents(
    model: ThermalModel, posterior: Posterior, verdict: SisterVerdict | None
) -> dict[str, dict[str, Any]]:
    """Where each law of a model comes from, as plain JSON types.

    `verdict`: on its sisters; None without any.
    """
    laws = verdict.laws if verdict is not None else {}
    return {
        law: trust.to_dict()
        for law, trust in (laws or laws_without_sisters(model, posterior)).items()
    }


def _said(mixed: Mixture, sisters: int) -> str:
    """What the machine's own data say of each law of its sisters."""
    by_law = [
        f"{law} law: {trust.said}" if law != "housing" else f"housing and films: {trust.said}"
        for law, trust in mixed.laws.items()
    ]
    return f"{sisters} sisters, evidence for them {mixed.evidence_gain:+.1f}; {'; '.join(by_law)}"


def _made_before(
    earlier: Posterior | None, kept: Sequence[Sister], trained: TrainedRange
) -> tuple[SisterRun, ...]:
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
    progress: Callable[[IdentificationProgress], None] | None, begin: float, end: float
) -> Callable[[IdentificationProgress], None] | None:
    """Report the progress of a part of the work as that of the whole.

    `progress`: called with it; None for no one; `begin`, `end`: where the part begins and ends in
    the whole, 0 to 1.
    """
    if progress is None:
        return None
    return lambda part: progress(replace(part, fraction=begin + (end - begin) * part.fraction))


def _verdict(
    kept: Sequence[Sister],
    accepted: bool,
    reason: str,
    aside: Mapping[str, str],
    mixed: Mixture | None = None,
    runs: int = 0,
) -> SisterVerdict:
    return SisterVerdict(
        [sister.name for sister in kept],
        [sister.trained.load_n_max for sister in kept],
        [sister.trained.speed_rpm_max for sister in kept],
        accepted,
        reason,
        None if mixed is None else mixed.evidence_gain,
        dict(aside),
        runs,
        {} if mixed is None else mixed.laws,
    )
