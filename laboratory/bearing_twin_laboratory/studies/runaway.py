"""Study ``runaway``: which machines run away under a load that they have never seen.

A 6016 runs at 5800 rpm under 2650 N for six hours, or besides under 2000 and 3300 N for an hour
each, as the advice proposes; then 4000 and 5500 N follow, three hours each.
Benches of three families are mounted with less clearance than they should have, so that some run
away. What the forecast says of it before the step is compared with what happened: the probability
with the verdict that follows from it, and the rule of thumb that it replaced.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from adapters.virtual_bench.families import FAMILIES, random_bench
from bearing_twin_laboratory.studies.bench_runs import Stage, follow, identify_twin, run_bench
from bearing_twin_laboratory.studies.study import (
    Document,
    Options,
    Study,
    Table,
    cell,
    share,
    table,
    text,
)
from twin_core.forecasting import forecast
from twin_core.forecasting.labels import RUNAWAY
from twin_core.forecasting.margins import runaway_margin
from twin_core.forecasting.runaway import LIKELY, RunawayDistance
from twin_core.network_model import RunawayLimits

BEARING = "6016"
SPEED_RPM = 5800.0
TRAINED = {
    "one load": (Stage(360, SPEED_RPM, 2650.0),),
    "three loads": (
        Stage(360, SPEED_RPM, 2650.0),
        Stage(60, SPEED_RPM, 2000.0),
        Stage(60, SPEED_RPM, 3300.0),
    ),
}
AHEAD = (Stage(180, SPEED_RPM, 4000.0), Stage(180, SPEED_RPM, 5500.0))
QUICK = (Stage(60, SPEED_RPM, 2650.0), Stage(45, SPEED_RPM, 5500.0))
BENCHES = 50
LOST_CLEARANCES_UM = (8.0, 11.0, 14.0)
_THUMB = RunawayLimits()
_CLASSES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 1.01)


@dataclass(frozen=True, slots=True)
class Task:
    """One bench.

    - ``trained``: name in `TRAINED`.
    - ``seed``, ``family``: see `adapters.virtual_bench.families.random_bench`.
    - ``lost_um``: by how much its clearance is too small, micrometres.
    - ``quick``: whether it runs for an hour or two only.
    """

    trained: str
    seed: int
    family: str
    lost_um: float
    quick: bool


@dataclass(frozen=True, slots=True)
class RunawayRun:
    """What was said of one bench, and what happened.

    - ``ran_away``: whether the bench ran away under the loads ahead.
    - ``lost``: whether it did so in the training already; nothing else is known then.
    - ``refused``: why the fit must not forecast; empty if it may.
    - ``probability``, ``share``: of the forecast: that the machine runs away, and the share of the
      members that do.
    - ``labelled``, ``by_rule``: whether the forecast says "runaway not excluded", and whether the
      rule of thumb does.
    - ``margin``: at the heaviest load.
    """

    task: Task
    ran_away: bool
    lost: bool
    refused: str = ""
    probability: float = 1.0
    share: float = 1.0
    labelled: bool = True
    by_rule: bool = True
    margin: RunawayDistance | None = None


def cases(options: Options) -> list[Task]:
    """Every seed as a bench of each family; the lost clearance goes by the seed."""
    return [
        Task(
            trained, seed, family, LOST_CLEARANCES_UM[seed % len(LOST_CLEARANCES_UM)], options.quick
        )
        for trained in TRAINED
        for seed in options.seeds(BENCHES)
        for family in FAMILIES
    ]


def examine(task: Task) -> RunawayRun:
    """Run a bench, identify its twin from the light load and ask it for the heavy ones."""
    trained, ahead = (QUICK[:1], QUICK[1:]) if task.quick else (TRAINED[task.trained], AHEAD)
    bench = random_bench(task.seed, BEARING, task.family)
    bench = replace(bench, clearance_um=bench.clearance_um - task.lost_um)
    run = run_bench(bench, (*trained, *ahead), task.seed)
    first, end = run.first_row(len(trained)), run.first_row(len(trained) + len(ahead))
    if run.ran_away(0, first):
        return RunawayRun(task, ran_away=True, lost=True)
    twin = identify_twin(run, first)
    planned = run.planned(first - 1, end)
    state = follow(twin, run, first - 1).state(float(planned.ambient_c[0]))
    made = forecast(twin.model, twin.posterior, state, planned)
    hottest_c = max(float(np.max(made.quantile(name)[-1])) for name in made.sensors)
    heaviest_n = ahead[-1].load_n
    heavy = heaviest_n > _THUMB.load_factor * twin.posterior.trained.load_n_max
    return RunawayRun(
        task,
        run.ran_away(first, end),
        lost=False,
        refused="" if twin.may_forecast else twin.result.reason,
        probability=made.runaway_probability,
        share=made.runaway_share,
        labelled=RUNAWAY in made.labels,
        by_rule=heavy or hottest_c > _THUMB.hot_c or made.runaway_share > 0.0,
        margin=runaway_margin(twin.model, twin.posterior, state, SPEED_RPM, heaviest_n),
    )


def _judged(runs: Sequence[RunawayRun], *, accepted: bool) -> list[RunawayRun]:
    return [one for one in runs if not one.lost and not (accepted and one.refused)]


def _rule(
    name: str,
    runs: Sequence[RunawayRun],
    says: Callable[[RunawayRun], bool],
    how_likely: Callable[[RunawayRun], float],
) -> Document:
    away = [one for one in runs if one.ran_away]
    calm = [one for one in runs if not one.ran_away]
    brier = [(how_likely(one) - one.ran_away) ** 2 for one in runs]
    return {
        "name": name,
        "benches": len(runs),
        "ran_away": len(away),
        "recalled": sum(map(says, away)),
        "false": sum(map(says, calm)),
        "false_share": sum(map(says, calm)) / len(calm) if calm else None,
        "brier": float(np.mean(brier)) if brier else None,
    }


def figures_of(runs: Sequence[RunawayRun]) -> Document:
    """Recall, false alarms and Brier score of the rule of thumb, the share and the probability."""
    rows = []
    for trained in TRAINED:
        of_trained = [one for one in runs if one.task.trained == trained]
        for title, accepted in (("all fits", False), ("accepted fits", True)):
            judged = _judged(of_trained, accepted=accepted)
            name = f"{trained}, {title}"
            rows += [
                _rule(f"{name}: rule of thumb", judged, lambda one: one.by_rule, _as_said),
                _rule(f"{name}: share", judged, lambda o: o.share > LIKELY, lambda o: o.share),
                _rule(f"{name}: probability", judged, _is_probable, lambda o: o.probability),
                _rule(f"{name}: label", judged, lambda o: o.labelled, lambda o: o.probability),
            ]
    judged = _judged(runs, accepted=False)
    return {
        "bearing": BEARING,
        "families": list(FAMILIES),
        "seeds": sorted({one.task.seed for one in runs}),
        "lost_clearances_um": list(LOST_CLEARANCES_UM),
        "ran_away_in_training": sum(one.lost for one in runs),
        "refused": {
            f"{one.task.family} {one.task.seed}, {one.task.trained}": one.refused
            for one in judged
            if one.refused
        },
        "rules": rows,
        "reliability": _reliability(_judged(runs, accepted=True)),
        "benches": [
            {
                "trained": one.task.trained,
                "seed": one.task.seed,
                "family": one.task.family,
                "lost_um": one.task.lost_um,
                "ran_away": one.ran_away,
                "probability": one.probability,
                "share": one.share,
                **_margin_figures(one.margin),
            }
            for one in judged
        ],
    }


def _reliability(runs: Sequence[RunawayRun]) -> list[Document]:
    """How often it happened where it was said to be so probable."""
    classes = []
    for low, high in pairwise(_CLASSES):
        said = [one for one in runs if low <= one.probability < high]
        if said:
            classes.append(
                {
                    "from": low,
                    "to": high,
                    "benches": len(said),
                    "said": float(np.mean([one.probability for one in said])),
                    "happened": float(np.mean([one.ran_away for one in said])),
                }
            )
    return classes


def _is_probable(one: RunawayRun) -> bool:
    return one.probability > LIKELY


def _as_said(one: RunawayRun) -> float:
    return float(one.by_rule)


def _margin_figures(margin: RunawayDistance | None) -> Document:
    """Figures of a margin; None where they are not finite."""
    names = ("loop_gain_upper", "margin_k", "margin_n")
    values = {name: float("nan") if margin is None else getattr(margin, name) for name in names}
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def tables(runs: Sequence[RunawayRun], document: Document) -> Iterator[Table]:
    """Rules beside each other, and the benches of which a runaway was said or that ran away."""
    yield table(
        '"Runaway not excluded" before 4000 and 5500 N (6016, 5800 rpm)',
        document["rules"],
        (
            ("rule", cell("name")),
            ("benches", cell("benches")),
            ("ran away", cell("ran_away")),
            ("recalled", cell("recalled")),
            ("false", cell("false")),
            ("false, %", cell("false_share", share)),
            ("Brier", cell("brier", text, 3)),
        ),
        "Rule of thumb: a load 1.5 times the trained one, an upper edge above 100 degC, or a "
        "member that runs away. A share or probability counts as said above 5 %; the "
        "label takes an upper edge above 110 degC besides.",
        f"Ran away in the training already: {document['ran_away_in_training']}; they count "
        f"nowhere. Fits that were refused: {len(document['refused'])}.",
    )
    yield table(
        "Probability that was said of accepted fits, and how often it happened",
        document["reliability"],
        (
            ("from", cell("from", text)),
            ("to", cell("to", text)),
            ("benches", cell("benches")),
            ("said, mean", cell("said", text, 3)),
            ("happened", cell("happened", text, 3)),
        ),
    )
    yield table(
        "Benches that ran away, or of which it was said",
        [one for one in document["benches"] if one["ran_away"] or one["probability"] > LIKELY],
        (
            ("trained", cell("trained")),
            ("family", cell("family")),
            ("seed", cell("seed")),
            ("clearance lost, um", cell("lost_um", text, 0)),
            ("ran away", lambda row: "yes" if row["ran_away"] else ""),
            ("probability", cell("probability", text)),
            ("loop gain, 97.5 %", cell("loop_gain_upper", text)),
            ("margin, K", cell("margin_k", text, 0)),
            ("margin, N", cell("margin_n", text, 0)),
        ),
    )


STUDY = Study("runaway", cases, examine, figures_of, tables)
