"""Study ``sisters``: what machines of a family teach one that has seen less than they have.

Each bench of a family is the target once. It has run under one load (a 6016 at 5800 rpm) or at one
speed (a 6311 at 1500 rpm); its sisters have run under heavy loads and at high speeds as well. Three
families of benches differ in friction law, housing and clearance. The bands are those of the
literature's prior, of the sisters', and of the sisters' calibrated by conformal prediction; what
strangers among the sisters do is counted apart.
"""

from collections.abc import Iterator, Sequence

from adapters.virtual_bench.families import FAMILIES
from bearing_twin_laboratory.studies.bench_runs import RINGS
from bearing_twin_laboratory.studies.bench_scores import LEAST_COVERAGE, figures, pair, percent
from bearing_twin_laboratory.studies.sisters_runs import (
    CONDITIONS,
    MIXED,
    QUESTIONS,
    QUICK,
    SISTERS,
    STRANGE,
    STRANGERS,
    FamilyRun,
    Outcome,
    Task,
    covered,
    examine,
)
from bearing_twin_laboratory.studies.study import (
    Document,
    Options,
    Study,
    Table,
    cell,
    mean,
    table,
    text,
)

BENCHES = SISTERS + 1
QUICK_BENCHES = 4

ASKED = {
    "load": "all sisters: steady error at 5500 N at most 0.9/0.8 K, worst bench 2.2 K, half-width "
    "at the end 3.5/3 K, 95 % of runs covered; 5 sisters, or 3 strangers among them: 1.5/1.0 K, no "
    "run below 80 %",
    "speed": "all sisters: largest error 1.8/0.9 K, half-width 4/2 K, 95 % of runs covered",
}


def cases(options: Options) -> list[Task]:
    """All questions to all families; quickly, a short one to a few benches of one family."""
    seed = options.seeds(BENCHES)[0]
    if options.quick:
        return [Task("load", QUICK, next(iter(FAMILIES)), seed, options.benches or QUICK_BENCHES)]
    benches = options.benches or BENCHES
    return [
        Task(name, question, family, seed, benches)
        for name, question in QUESTIONS.items()
        for family in FAMILIES
    ]


def figures_of(runs: Sequence[FamilyRun]) -> Document:
    """Figures by question, family and condition."""
    found: dict[str, dict[str, Document]] = {}
    for run in runs:
        found.setdefault(run.task.name, {})[run.task.family] = {
            "bearing": run.task.question.bearing,
            "seeds": list(run.seeds),
            "ran_away": list(run.ran_away),
            "refused": list(run.refused),
            "conditions": {
                condition: _figures(outcomes) for condition, outcomes in run.outcomes.items()
            },
        }
    return {"questions": found, "asked": ASKED}


def _figures(outcomes: Sequence[Outcome]) -> Document:
    return {
        **figures([one.rings for one in outcomes]),
        "last_stage": figures([one.last for one in outcomes]),
        "end_half_width_c": {
            ring: mean(one.end_half_width_k[ring] for one in outcomes) for ring in RINGS
        },
        "runs_covered": {ring: mean(covered(one, ring) for one in outcomes) for ring in RINGS},
        "held_whole": {ring: mean(one.held_whole[ring] for one in outcomes) for ring in RINGS},
        "accepted": sum(one.accepted for one in outcomes),
        "sisters_used": mean(one.used for one in outcomes),
        "set_aside": sum(one.set_aside for one in outcomes),
        "strangers_found": sum(one.strangers_found for one in outcomes),
    }


def tables(runs: Sequence[FamilyRun], document: Document) -> Iterator[Table]:
    """One table per question: errors and bands of all families under all conditions."""
    for name, families in document["questions"].items():
        rows = [
            {"family": family, "condition": condition, **found["conditions"][condition]}
            for family, found in families.items()
            for condition in CONDITIONS
        ]
        apart = "; ".join(
            f"{family}: {len(found['seeds'])} benches, {len(found['ran_away'])} ran away, "
            f"{len(found['refused'])} fits refused"
            for family, found in families.items()
        )
        yield table(
            f"Sisters, {name}: forecast of what the target has not seen, K, T_ir/T_or",
            rows,
            (
                ("family", cell("family")),
                ("prior", cell("condition")),
                ("largest error", cell("max_error_c", pair)),
                ("steady, last stage", cell("last_stage.steady_error_c", pair)),
                ("worst bench", cell("last_stage.worst_steady_error_c", pair, 1)),
                ("half-width, mean", cell("half_width_c", pair, 1)),
                ("at the end", cell("end_half_width_c", pair, 1)),
                ("covers, %", cell("coverage_95_by_sensor", percent)),
                ("worst, %", cell("worst_coverage_95", percent)),
                ("runs covered, %", cell("runs_covered", percent)),
                ("whole runs in 90 %", cell("held_whole", percent)),
                ("interval score", cell("interval_score_c", pair, 1)),
            ),
            f"Asked, {ASKED[name]}.",
            f"{apart}. A run is covered if its band holds 95 % of its readings; below "
            f"{LEAST_COVERAGE:.0%} a band is wrong. Steady: last half hour of a stage. Bands are "
            "calibrated where all sisters are sisters, else as they are.",
        )
        strange = [row for row in rows if row["condition"] in (MIXED, STRANGE)]
        yield table(
            f"Sisters, {name}: strangers",
            strange,
            (
                ("family", cell("family")),
                ("prior", cell("condition")),
                ("targets", cell("benches")),
                ("accepted", cell("accepted")),
                ("sisters used, mean", cell("sisters_used", text, 1)),
                ("strangers found", cell("strangers_found")),
                ("set aside in all", cell("set_aside")),
            ),
            f"{STRANGERS} strangers among the sisters of each target, or {2 * STRANGERS} strangers "
            "alone, of the next family. A target that has seen nothing of what distinguishes the "
            "families cannot distinguish them.",
        )


STUDY = Study("sisters", cases, examine, figures_of, tables)
