"""What must be said along with a forecast that goes beyond what the data taught.

The rules come from an offline study on random virtual benches: a load law learned from one load is
only the prior's, whatever the residuals say; about one machine in thirty runs away thermally under
heavy load although a moderate load looks normal. The ensemble gives the probability of it
(`twin_core.forecasting.runaway`); where that was not tested, simple limits stand in for it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.forecasting.heat_laws import Law
from twin_core.forecasting.runaway import LIKELY
from twin_core.identification.family import BEYOND, SisterKnowledge
from twin_core.identification.identifiability import Verdict
from twin_core.identification.posterior import Posterior
from twin_core.network_model import RunawayLimits
from twin_core.operating_points import STANDING_RPM
from twin_core.simulation import OperatingProfile

NOT_IDENTIFIED = "not identified yet: prior parameters only"
LOAD_LAW = "load law from prior only"
SPEED_LAW = "speed law from prior only"
RUNAWAY = "runaway not excluded"

TAUGHT: dict[Law, Verdict | None] = {"load": "informed", "speed": "informed"}
BEARING_LIMITS = RunawayLimits()
# Share of an ensemble that is more than chance.
_SOME_MEMBERS = 0.005
# A beginning whose 95 % band is wider than this to each side is spoken of.
_DOUBTFUL_K = 5.0


def forecast_labels(
    posterior: Posterior,
    profile: OperatingProfile,
    hottest_c: float,
    runaway_probability: float,
    laws: Mapping[Law, Verdict | None] = TAUGHT,
    limits: RunawayLimits | None = BEARING_LIMITS,
    inputs: Sequence[str] = (),
) -> tuple[str, ...]:
    """Labels of a forecast, from how it goes beyond what the posterior was trained at.

    ``"not identified yet: prior parameters only"`` before any identification. ``"load law from
    prior only"`` when the profile goes more than 10 % beyond the trained loads and the data hold a
    single load, or hold several and yet left the law of load where the prior had it: a second load
    stage is needed. Where the duty varies, a law that the data inform counts as taught whatever
    loads lasted. ``"speed law from prior only"`` also for speeds. Where sisters have seen them the
    words are ``"load law from 12 sisters"``, unless the machine's own data speak against their law;
    where they say nothing of it, ``"load law: family's, not tested on this machine; 20 min at 3300
    N would settle it"`` as well. ``"NAME beyond the identification data"`` when an
    input that drives a loss goes as far beyond them. ``"runaway not excluded"`` when its
    probability is above 5 %, the upper edge passes the limits' temperature (of the default model
    110 degC, of another bearing's 100), or a load beyond the limits' factor (2.1; 1.5) of the
    trained one lies ahead. Where the probability was not tested, and before any identification, one
    member that runs away is enough.

    `hottest_c` is the highest upper edge (97.5 %) of any sensor; `laws` are from
    `twin_core.forecasting.heat_laws.law_verdicts`, None where there is nothing to know; `limits`
    are the model's; `inputs` are the names of the profile's inputs.
    """
    trained = posterior.trained
    running = np.abs(profile.speed_rpm) >= STANDING_RPM
    load_n = float(np.max(profile.load_n[running], initial=0.0))
    speed_rpm = float(np.max(np.abs(profile.speed_rpm), initial=0.0))
    labels = []
    if not posterior.identified:
        labels.append(NOT_IDENTIFIED)
    else:
        varying = bool(trained.duty)
        sisters = posterior.sisters
        # With sisters a posterior may be narrow without any load or speed of the machine's own.
        varying = varying and sisters is None
        if load_n > BEYOND * trained.load_n_max and not _taught(
            trained.distinct_loads, laws["load"], varying
        ):
            seen = sisters.with_load(load_n) if sisters else 0
            labels += _law("load", LOAD_LAW, sisters, seen)
        if speed_rpm > BEYOND * trained.speed_rpm_max and not _taught(
            trained.distinct_speeds, laws["speed"], varying
        ):
            seen = sisters.with_speed(speed_rpm) if sisters else 0
            labels += _law("speed", SPEED_LAW, sisters, seen)
    for name, values in zip(inputs, profile.inputs.T, strict=True):
        most = trained.drives.get(name, 0.0)
        if most > 0.0 and float(np.max(np.abs(values))) > BEYOND * most:
            labels.append(f"{name} beyond the identification data")
    if bool(runaway_not_excluded(posterior, load_n, hottest_c, runaway_probability, limits)):
        labels.append(RUNAWAY)
    return tuple(labels)


def _law(law: Law, prior_only: str, sisters: SisterKnowledge | None, seen: int) -> list[str]:
    """Where a law comes from that the data do not teach, and what would test it.

    `seen`: how many of the sisters have been where the forecast goes.
    """
    if sisters is None or not seen or not sisters.taught(law):
        return [prior_only]
    labels = [f"{law} law from {seen} sister{'s' * (seen > 1)}"]
    trust = sisters.laws.get(law)
    if trust is not None and not trust.tested:
        labels.append(f"{law} law: {trust.said}")
    return labels


def _taught(distinct: int, said: Verdict | None, varying: bool) -> bool:
    """Whether a law comes from the data, or from the network itself."""
    if said is None or (varying and said == "informed"):
        return True
    return distinct >= 2 and said != "prior only"


def doubtful_start(
    names: Sequence[str], quantiles_c: ArrayLike, scale: float = 1.0
) -> tuple[str, ...]:
    """Label of a beginning that is not well known: the widest 95 % band of all.

    `names`: sensors and nodes; `quantiles_c` (5, names) of their temperatures in degC at the
    beginning, the outer ones at 2.5 and 97.5 %; `scale`: how many times the errors of a bearing's
    model are those of this one. Returns ``"initial state of NAME known to ±x K only"``; empty where
    every band is at most 5 K wide to each side.
    """
    bands_c = np.asarray(quantiles_c, np.float64)
    half_k = (bands_c[-1] - bands_c[0]) / 2.0
    widest = int(np.argmax(half_k))
    if half_k[widest] <= _DOUBTFUL_K * max(scale, 1.0):
        return ()
    return (f"initial state of {names[widest]} known to ±{half_k[widest]:.0f} K only",)


def runaway_likely(
    posterior: Posterior, runaway_probability: ArrayLike, limits: RunawayLimits | None
) -> NDArray[np.bool_]:
    """Return where the probability of a runaway alone is too high; see `forecast_labels`."""
    known = limits is not None and limits.tested and posterior.identified
    bar = LIKELY if known else _SOME_MEMBERS
    return np.asarray(np.asarray(runaway_probability) > bar)


def runaway_not_excluded(
    posterior: Posterior,
    load_n: ArrayLike,
    hottest_c: ArrayLike,
    runaway_probability: ArrayLike,
    limits: RunawayLimits | None = BEARING_LIMITS,
) -> NDArray[np.bool_]:
    """Return where a thermal runaway cannot be excluded; see `forecast_labels`.

    `posterior`: what the forecast rests on; `load_n`, `hottest_c`, `runaway_probability`: heaviest
    load, highest upper edge of any sensor and probability of a runaway; arrays of one shape, or
    scalars; `limits`: the model's; None for none: then only members that run away count.
    """
    away = runaway_likely(posterior, runaway_probability, limits)
    if limits is None:
        return away
    most_n = limits.load_factor * posterior.trained.load_n_max
    heavy = posterior.identified & (np.asarray(load_n) > most_n)
    return np.asarray(heavy | (np.asarray(hottest_c) > limits.hot_c) | away)
