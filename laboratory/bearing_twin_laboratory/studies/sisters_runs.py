"""Runs of the study ``sisters``: benches of one family, each the target of the others once.

The runs that calibrate are made once for all targets: in them a sister learns from all others, the
target among them, which is one of nineteen. The product makes them again without it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np

from adapters.virtual_bench.families import FAMILIES, random_bench
from bearing_twin_laboratory.studies.bench_runs import (
    RINGS,
    BenchRun,
    Stage,
    Twin,
    forecast_from,
    identify_twin,
    run_bench,
    with_sensors,
)
from bearing_twin_laboratory.studies.bench_scores import RingScores, score_rings
from twin_core import scores
from twin_core.forecasting import Forecast
from twin_core.identification import IdentificationData, IdentificationWindow, Posterior
from twin_core.identification.family import SisterRun
from twin_core.sisters import Sister, calibration_runs, identify_with_sisters

SISTERS, FEW, STRANGERS = 19, 5, 3
STEADY_ROWS = 30
# Benches are drawn until enough of them have not run away, up to a limit.
_MOST_DRAWN = 3
# Seeds of strangers lie this far from those of the family.
_OTHER_SEEDS = 500

LITERATURE = "literature"
ALL = "all sisters"
PLAIN = "all sisters, band not calibrated"
SOME = "5 sisters"
MIXED = "3 of the sisters strangers"
STRANGE = "strangers only"
CONDITIONS = (LITERATURE, ALL, PLAIN, SOME, MIXED, STRANGE)


@dataclass(frozen=True, slots=True)
class Question:
    """What the target is asked.

    - ``trained``: what the target has seen.
    - ``ahead``: what it has not seen and its sisters have.
    """

    bearing: str
    trained: tuple[Stage, ...]
    ahead: tuple[Stage, ...]

    @property
    def rows(self) -> int:
        """How many rows the target has."""
        return sum(stage.minutes for stage in self.trained)


QUESTIONS = {
    "load": Question(
        "6016",
        (Stage(360, 5800.0, 2650.0),),
        (Stage(180, 5800.0, 4000.0), Stage(180, 5800.0, 5500.0)),
    ),
    "speed": Question(
        "6311",
        (Stage(90, 1500.0, 2650.0),),
        tuple(Stage(90, speed, 2650.0) for speed in (2400.0, 4200.0, 4900.0, 5600.0, 6200.0)),
    ),
}
QUICK = Question("6016", (Stage(60, 5800.0, 2650.0),), (Stage(45, 5800.0, 5500.0),))


@dataclass(frozen=True, slots=True)
class Task:
    """A question to benches of one family.

    - ``name``: of the question.
    - ``family``: name in `adapters.virtual_bench.families.FAMILIES`.
    - ``first_seed``, ``benches``: seed of the first bench, and how many take part; more are drawn
      for those that run away.
    """

    name: str
    question: Question
    family: str
    first_seed: int
    benches: int


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """One forecast of one target.

    - ``rings``: scores over all that lies ahead.
    - ``last``: the same over the last stage.
    - ``end_half_width_k``: half the width of the 95 % band in the last half hour, by ring.
    - ``held_whole``: whether all readings lay inside the band of the whole run, by ring.
    - ``used``, ``set_aside``, ``strangers_found``: sisters that the prior was made of; those that
      were set aside; the real strangers of these.
    - ``accepted``: whether the target's own data spoke for the sisters.
    - ``labels``: of the forecast.
    """

    rings: RingScores
    last: RingScores
    end_half_width_k: dict[str, float]
    held_whole: dict[str, bool]
    used: int
    set_aside: int
    strangers_found: int
    accepted: bool
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FamilyRun:
    """All targets of one family.

    - ``seeds``: of the targets, in order.
    - ``ran_away``, ``refused``: seeds that took no part: their bench ran away, or a fit failed.
    - ``outcomes``: by condition, one per target.
    """

    task: Task
    seeds: tuple[int, ...]
    ran_away: tuple[int, ...]
    refused: tuple[int, ...]
    outcomes: dict[str, tuple[Outcome, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """A bench with what its whole run and what its low part alone have taught."""

    seed: int
    run: BenchRun
    low: Twin
    sister: Sister


def examine(task: Task) -> FamilyRun:
    """Run the benches of a family, and forecast each with what the others know."""
    ran_away: list[int] = []
    refused: list[int] = []
    benches = _benches(task, task.family, task.first_seed, task.benches, ran_away, refused)
    names = list(FAMILIES)
    other = names[(names.index(task.family) + 1) % len(names)]
    strange = _benches(task, other, task.first_seed + _OTHER_SEEDS, 2 * STRANGERS, [], [])
    strangers = [bench.sister for bench in strange]
    outcomes: dict[str, list[Outcome]] = {condition: [] for condition in CONDITIONS}
    runs: tuple[SisterRun, ...] = ()
    if benches:
        trained = benches[0].low.posterior.trained
        runs = calibration_runs(benches[0].low.model, [one.sister for one in benches], trained)
    for target in benches:
        for condition, outcome in _of_target(task.question, target, benches, strangers, runs):
            outcomes[condition].append(outcome)
    return FamilyRun(
        task,
        tuple(bench.seed for bench in benches),
        tuple(ran_away),
        tuple(refused),
        {condition: tuple(found) for condition, found in outcomes.items()},
    )


def _benches(
    task: Task, family: str, first: int, wanted: int, ran_away: list[int], refused: list[int]
) -> list[_Bench]:
    found: list[_Bench] = []
    question = task.question
    stages = (*question.trained, *question.ahead)
    for seed in islice(count(first), _MOST_DRAWN * wanted):
        if len(found) == wanted:
            break
        run = run_bench(random_bench(seed, question.bearing, family), stages, seed)
        end = run.first_row(len(stages))
        if run.ran_away(0, end):
            ran_away.append(seed)
            continue
        low, whole = (identify_twin(run, rows) for rows in (question.rows, end))
        if not (low.may_forecast and whole.may_forecast):
            refused.append(seed)
            continue
        known = whole.posterior
        name = f"{family} {seed}"
        sister = Sister(name, known.z, known.covariance, known.trained, _data(run, end))
        found.append(_Bench(seed, run, low, sister))
    return found


def _data(run: BenchRun, rows: int) -> IdentificationData:
    minutes = with_sensors(run.minutes.take(slice(0, rows)), RINGS)
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))


def _of_target(
    question: Question,
    target: _Bench,
    benches: Sequence[_Bench],
    strangers: Sequence[Sister],
    runs: Sequence[SisterRun],
) -> Iterator[tuple[str, Outcome]]:
    """Outcomes of all conditions for one target."""
    others = [bench.sister for bench in benches if bench is not target][:SISTERS]
    drawn = np.random.default_rng(target.seed).permutation(len(others))[:FEW]
    few = [others[number] for number in drawn]
    exchanged = max(min(STRANGERS, len(others) - 1), 0)
    mixed = [*others[: len(others) - exchanged], *strangers[:exchanged]]
    yield LITERATURE, _outcome(question, target, target.low.posterior, 0, {}, strangers, True)
    for condition, sisters in ((ALL, others), (SOME, few), (MIXED, mixed), (STRANGE, strangers)):
        found = identify_with_sisters(
            target.low.model,
            _data(target.run, question.rows),
            sisters,
            target.low.result,
            calibrate=False,
        )
        said = found.verdict
        known = found.result.posterior
        seen = (said.used, said.set_aside, strangers, said.accepted)
        yield PLAIN if condition == ALL else condition, _outcome(question, target, known, *seen)
        if condition == ALL:
            if known.sisters is not None:
                names = set(known.sisters.names)
                own = tuple(run for run in runs if run.bearing in names)
                known = replace(known, sisters=replace(known.sisters, calibration=own))
            yield ALL, _outcome(question, target, known, *seen)


def _outcome(
    question: Question,
    target: _Bench,
    posterior: Posterior,
    used: int,
    set_aside: Mapping[str, str],
    strangers: Sequence[Sister],
    accepted: bool,
) -> Outcome:
    run, rows = target.run, question.rows
    stages = len(question.trained) + len(question.ahead)
    end, last = run.first_row(stages), run.first_row(stages - 1)
    twin = replace(target.low, result=replace(target.low.result, posterior=posterior))
    made = forecast_from(twin, run, rows - 1, run.measured(rows - 1, end))
    return Outcome(
        rings=score_rings(made, run, rows - 1, rows, end),
        last=score_rings(made, run, rows - 1, last, end),
        end_half_width_k={ring: end_half_width(made, ring) for ring in RINGS},
        held_whole={ring: _held_whole(made, run, ring, rows) for ring in RINGS},
        used=used,
        set_aside=len(set_aside),
        strangers_found=sum(one.name in set_aside for one in strangers),
        accepted=accepted,
        labels=made.labels,
    )


def end_half_width(made: Forecast, ring: str) -> float:
    """Half the width of the 95 % band in the last half hour, K."""
    quantiles = made.quantile(ring)[:, -STEADY_ROWS:]
    return float(0.5 * np.mean(quantiles[-1] - quantiles[0]))


def _held_whole(made: Forecast, run: BenchRun, ring: str, first: int) -> bool:
    """Whether all rows from ``first`` on, which follow the forecast's present one, are inside."""
    low, high = made.whole_run(ring)[:, 1:]
    measured = run.minutes.temperatures_c[ring][first : first + low.size]
    return scores.coverage(low, high, measured) == 1.0


def covered(outcome: Outcome, ring: str) -> bool:
    """Whether at least 95 % of a run's readings lie inside the band."""
    return outcome.rings[ring].coverage_95 >= 0.95
