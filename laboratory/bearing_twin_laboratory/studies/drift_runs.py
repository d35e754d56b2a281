"""Runs of the study ``drift``: machines that change and machines that do not, followed."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench import (
    BenchParameters,
    Condition,
    MeasuredRun,
    Scenario,
    Truth,
    find_scenario,
    friction_moment_nmm,
    measure,
    scenario_profile,
    simulate,
)
from service.domain.channels import RING_SENSORS
from twin_core.bearings import bearing
from twin_core.drift import usual_point
from twin_core.drift_series import follow
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationWindow,
    Posterior,
    identify,
)
from twin_core.minute_rows import rows_of_samples
from twin_core.models import ThermalModel, build_model
from twin_core.quantities import ReferencePoint
from twin_core.windows import LowRiskRegion, MinuteData, find_windows

FloatArray = NDArray[np.float64]

BEARING = "6311"
CASES: dict[str, str | None] = {
    "unchanged": None,
    "unchanged, other plans": None,
    "durability": "friction",
    "grease-degradation": "friction",
    "cooling-loss": "convection outside",
}
"""What is run, and what truly moves."""

RINGS = RING_SENSORS
REGION = LowRiskRegion(4300.0, 3400.0)
TRUE_QUANTITIES = ("friction", "convection outside")
_TRIP_C = 130.0
_ROW_S, _STEP_S = 10.0, 5.0
VERSION_MIN = 720
_REST_MIN = 3


@dataclass(frozen=True, slots=True)
class Finding:
    """What the comparison of a version with earlier ones says, and the truth.

    - ``probability``: of the difference without any change.
    - ``sudden``: whether the comparison with one earlier version reports a change.
    - ``creeping``: what the sums over versions report.
    - ``group``: what is named as having moved.
    - ``moves``: relative change of friction and outside film, were it that which moved, with 95 %
      interval.
    - ``truth``: the same of the bench.
    """

    probability: float
    sudden: bool
    creeping: tuple[str, ...]
    group: str
    moves: dict[str, tuple[float, float, float]]
    truth: dict[str, float]

    @property
    def reported(self) -> bool:
        """Whether a change is reported."""
        return self.sudden or bool(self.creeping)


@dataclass(frozen=True, slots=True)
class Version:
    """One identification of half a day.

    - ``end_h``: end of its data.
    - ``failed``: why its fit failed; empty if it did not.
    - ``finding``: none if there was nothing to compare it with.
    """

    end_h: float
    failed: str = ""
    finding: Finding | None = None

    @property
    def reported(self) -> bool:
        """Whether a change is reported."""
        return self.finding is not None and self.finding.reported


@dataclass(frozen=True, slots=True)
class RunResult:
    """One bench in one case.

    - ``onset_h``: when the fault begins; None without one.
    - ``tripped_h``: when the thermostat stopped the machine; None if it did not.
    - ``versions``: in time order, the day of running in left out.
    """

    case: str
    seed: int
    onset_h: float | None
    tripped_h: float | None
    versions: tuple[Version, ...]

    def first_report(self) -> Version | None:
        """First version at which a change is reported after the onset."""
        start = self.onset_h or 0.0
        return next((one for one in self.versions if one.reported and one.end_h > start), None)


class Task(NamedTuple):
    """One bench in one case; a number of days cuts the run short."""

    case: str
    seed: int
    days: int | None = None


def examine(task: Task) -> RunResult:
    """Follow one bench in one case."""
    case, seed, days = task
    bench = BenchParameters.random(seed, BEARING)
    scenario = scenario_of(case, seed)
    profile = scenario_profile(scenario, bench, seed, _ROW_S)
    truth = simulate(profile, bench, max_step_s=_STEP_S)
    condition = profile.condition or Condition.unchanged(profile.time_s.size)
    minutes = minute_rows(measure(profile, truth, seed))
    hot = np.flatnonzero(truth.t_inner_ring_c > _TRIP_C)
    tripped_h = float(truth.time_s[hot[0]] / 3600.0) if hot.size else None
    end_h = min(tripped_h or np.inf, 24.0 * (days or np.inf), minutes.time_s[-1] / 3600.0)
    model = build_model(bearing=bearing(BEARING))
    found: list[tuple[int, Posterior]] = []
    versions: list[Version] = []
    # the first day is that of running in
    first = 2 * VERSION_MIN + _REST_MIN
    for start in range(first, int(60 * end_h) - VERSION_MIN + _REST_MIN + 1, VERSION_MIN):
        guess = found[-1][1].z if found else None
        posterior, failed = _identified(model, minutes, start, guess)
        versions.append(Version((start + VERSION_MIN) / 60.0, failed))
        if not failed:
            found.append((len(versions) - 1, posterior))
    if found:
        point = usual_point(model, found[0][1])
        readings = follow(model, [posterior for _, posterior in found], point)
        for (number, _), reading in zip(found, readings, strict=True):
            if reading.drift is None or reading.against is None:
                continue
            drift, against = reading.drift, versions[found[reading.against][0]]
            now, then = (
                _true_quantities(bench, condition.cooling, truth, one, point)
                for one in (versions[number], against)
            )
            finding = Finding(
                drift.probability,
                drift.changed,
                reading.creeping,
                next(iter(drift.groups)),
                {
                    move.quantity.name: (move.change, move.low, move.high)
                    for move in drift.moves
                    if move.quantity.name in TRUE_QUANTITIES
                },
                {name: now[name] / then[name] - 1.0 for name in TRUE_QUANTITIES},
            )
            versions[number] = replace(versions[number], finding=finding)
    onset_s = min((change.start_s for change in scenario.changes), default=None)
    return RunResult(
        case,
        seed,
        None if onset_s is None else onset_s / 3600.0,
        tripped_h,
        tuple(versions),
    )


def scenario_of(case: str, seed: int) -> Scenario:
    """The scenario of a case; the controls are its days on a machine that does not age."""
    if case in ("durability", "grease-degradation", "cooling-loss"):
        return find_scenario(case)
    durability = find_scenario("durability")
    rest, *steps = durability.steps
    day, steps = steps[:6], steps[6:]
    if case != "unchanged":
        rng = np.random.default_rng([seed, 0xD21F7])
        steps = []
        while len(steps) < 24:
            *points, stop = day
            minutes = rng.multinomial(22 * 60 - 5 * 120, np.full(5, 0.2)) + 120
            steps += [
                replace(points[k], duration_s=60.0 * float(minutes[k])) for k in rng.permutation(5)
            ]
            steps.append(stop)
    return replace(durability, steps=(rest, *day, *steps), oil_loss=0.0)


def minute_rows(seen: MeasuredRun) -> MinuteData:
    """Rows of the whole minutes, as the service makes them, from rows of 10 s."""
    rows = rows_of_samples(
        seen.time_s,
        {"speed_rpm": seen.speed_rpm, "load_n": seen.load_n, "ambient_c": seen.ambient_c},
        {name: getattr(seen, name) for name in RINGS},
    )
    return rows.take(slice(0, int(seen.time_s[-1] // 60.0)))


def _identified(
    model: ThermalModel, minutes: MinuteData, start: int, guess: FloatArray | None
) -> tuple[Posterior, str]:
    """Identify half a day as the service would: from the running machine's windows in it."""
    half_day = minutes.take(slice(start, start + VERSION_MIN))
    windows = [
        IdentificationWindow(
            half_day.between(window.start_s, window.end_s),
            at_rest=window.at_rest,
            revolutions=float(minutes.speed_rpm[minutes.time_s < window.start_s].sum()),
        )
        for window in find_windows(half_day, REGION)
    ]
    result = identify(
        model,
        IdentificationData(tuple(windows)),
        FitSettings(method="refine", samples=0),
        guess_z=guess,
    )
    return result.posterior, "" if result.status == "converged" else result.reason


def _true_quantities(
    bench: BenchParameters,
    cooling: FloatArray,
    truth: Truth,
    version: Version,
    point: ReferencePoint,
) -> dict[str, float]:
    """Friction at the point in N.mm and factor of the outer film, means over a version."""
    first, last = (
        round(3600.0 * hours / _ROW_S) for hours in (version.end_h - 12.0, version.end_h)
    )
    rows = range(first, min(last, truth.time_s.size), 360)
    friction = [
        friction_moment_nmm(
            bench,
            speed_rpm=point.speed_rpm,
            load_n=point.load_n,
            oil_temperature_c=point.temperature_c,
            run_in=float(truth.run_in[row]),
            oil=float(truth.oil[row]),
        )
        for row in rows
    ]
    return {
        "friction": float(np.mean(friction)),
        "convection outside": float(np.mean(cooling[first:last])),
    }
