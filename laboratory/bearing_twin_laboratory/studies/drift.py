"""Study ``drift``: a machine followed over model versions, with and without a change.

Random benches run equal days of low points; every half day is identified alone and compared with
the halves before it. Two controls without any change count the false reports: the same plan every
day, and the same points every day in another order and for other times. Three machines change: by
slow ageing of the grease, by grease that bleeds, by a housing that gets covered. What the twin says
has the bench's own truth next to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from bearing_twin_laboratory.studies.drift_runs import (
    BEARING,
    CASES,
    TRUE_QUANTITIES,
    VERSION_MIN,
    Finding,
    RunResult,
    Task,
    examine,
)
from bearing_twin_laboratory.studies.study import (
    Document,
    Drawing,
    Options,
    Study,
    Table,
    cell,
    figure,
    mean,
    named,
    table,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BENCHES = 8
QUICK_DAYS = 4


def figures_of(results: Sequence[RunResult]) -> Document:
    """Figures of all cases, and every run."""
    cases = {case: [one for one in results if one.case == case] for case in CASES}
    return {
        "bearing": BEARING,
        "seeds": sorted({result.seed for result in results}),
        "hours_per_version": VERSION_MIN / 60.0,
        "cases": {case: _figures(case, runs) for case, runs in cases.items() if runs},
        "runs": [asdict(result) for result in results],
    }


def _figures(case: str, runs: Sequence[RunResult]) -> Document:
    moves = CASES[case]
    calm: list[Finding] = []
    after: list[Finding] = []
    firsts: list[tuple[RunResult, Finding]] = []
    delays = []
    for result in runs:
        onset_h = np.inf if moves is None else result.onset_h or 0.0
        for version in result.versions:
            if version.finding is not None:
                (calm if version.end_h <= onset_h else after).append(version.finding)
        first = result.first_report()
        if moves is not None and first is not None and first.finding is not None:
            firsts.append((result, first.finding))
            delays.append(first.end_h - onset_h)
    sudden = [one for one in after if one.sudden]
    errors, held = [], []
    for one in sudden:
        if moves is not None and one.group == moves:
            change, low, high = one.moves[moves]
            errors.append(abs(change - one.truth[moves]))
            held.append(float(low <= one.truth[moves] <= high))
    return {
        "benches": len(runs),
        "versions": sum(len(result.versions) for result in runs),
        "failed_fits": sum(bool(one.failed) for result in runs for one in result.versions),
        "compared_without_change": len(calm),
        "false_reports": sum(one.reported for one in calm),
        "false_sudden": sum(one.sudden for one in calm),
        "false_creeping": sum(bool(one.creeping) for one in calm),
        "moves": moves,
        "detected": len(firsts),
        "delay_h_median": float(np.median(delays)) if delays else None,
        "delay_h_max": max(delays) if delays else None,
        "true_change_at_report": _median([one.truth[moves] for _, one in firsts if moves]),
        "sudden_reports": len(sudden),
        "named_right": sum(one.group == moves for one in sudden),
        "mean_abs_error": mean(errors),
        "interval_holds_truth": mean(held),
        "tripped": sum(result.tripped_h is not None for result in runs),
        "reported_before_trip": sum(result.tripped_h is not None for result, _ in firsts),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" if whole else "-"


def _percent(value: float | None, sign: str = "") -> str:
    return "-" if value is None else f"{100.0 * value:{sign}.0f} %"


def _hours(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f} h"


def tables(results: Sequence[RunResult], document: Document) -> Iterator[Table]:
    """Cases, then benches."""
    yield table(
        "Changes of the machine: reported, named, measured",
        named(document["cases"]),
        (
            ("case", cell("name")),
            ("what moves", lambda one: one["moves"] or "nothing"),
            (
                "false reports",
                lambda one: _share(one["false_reports"], one["compared_without_change"]),
            ),
            (
                "benches detected",
                lambda one: _share(one["detected"], one["benches"]) if one["moves"] else "-",
            ),
            (
                "delay, median / longest",
                lambda one: f"{_hours(one['delay_h_median'])} / {_hours(one['delay_h_max'])}",
            ),
            ("true change by then", cell("true_change_at_report", _percent, "+")),
            (
                "named right",
                lambda one: (
                    _share(one["named_right"], one["sudden_reports"]) if one["moves"] else "-"
                ),
            ),
            ("error of the change", cell("mean_abs_error", _percent)),
            ("95 % interval holds", cell("interval_holds_truth", _percent)),
            ("failed fits", cell("failed_fits")),
        ),
        "A version is half a day. The delay counts from the onset of the fault to the end of "
        "the version that reports it, in steps of 12 h. Stated rate of false reports: 1 % per "
        "comparison, besides those of the sums.",
        "A failed fit, as a rule over a change amid its data, is not compared.",
    )
    yield table(
        "Bench by bench",
        [shown for result in results if (shown := _shown(result)) is not None],
        [
            (heading, cell(heading))
            for heading in (
                "case",
                "seed",
                "onset",
                "first report",
                "what it names",
                "true change by then",
                "change at the last version",
                "truth",
                "tripped",
            )
        ],
    )


def _shown(result: RunResult) -> Document | None:
    """Texts of a bench whose change was reported."""
    moves = CASES[result.case]
    first = result.first_report()
    if moves is None or first is None or first.finding is None:
        return None
    found = first.finding
    last = [one.finding for one in result.versions if one.finding is not None][-1]
    change, low, high = last.moves[moves]
    return {
        "case": result.case,
        "seed": result.seed,
        "onset": _hours(result.onset_h),
        "first report": _hours(first.end_h),
        "what it names": found.group if found.sudden else f"creeping {', '.join(found.creeping)}",
        "true change by then": _percent(found.truth[moves], "+"),
        "change at the last version": (
            f"{_percent(change, '+')} ({_percent(low, '+')} to {_percent(high, '+')})"
        ),
        "truth": _percent(last.truth[moves], "+"),
        "tripped": _hours(result.tripped_h),
    }


def plots(results: Sequence[RunResult], document: Document) -> dict[str, Drawing]:
    """The first bench in all cases."""
    first = min(result.seed for result in results)
    return {"drift-series": partial(_draw, [one for one in results if one.seed == first])}


def _draw(results: Sequence[RunResult]) -> "Figure":
    """Change of both quantities against the unchanged versions, truth next to it, one bench."""
    drawn = figure(3.2 * len(results), 6.0)
    axes = drawn.subplots(2, len(results), squeeze=False, sharex="col", sharey="row")
    for column, result in enumerate(results):
        found = [(one.end_h, one.finding) for one in result.versions if one.finding is not None]
        hours = [hour for hour, _ in found]
        for row, name in enumerate(TRUE_QUANTITIES):
            ax = axes[row, column]
            moves = 100.0 * np.array([one.moves[name] for _, one in found]).reshape(-1, 3)
            change = moves[:, 0]
            named = np.array([not one.reported or one.group == name for _, one in found])
            hour = np.array(hours)
            for mine, colour, label in ((named, "C0", "twin"), (~named, "0.75", "not what moved")):
                if mine.any():
                    half = np.abs(moves[mine, 1:] - change[mine, None]).T
                    style = {"fmt": "o", "ms": 4, "capsize": 2, "color": colour, "label": label}
                    ax.errorbar(hour[mine], change[mine], half, **style)
            ax.plot(hours, [100.0 * one.truth[name] for _, one in found], "k-", label="bench")
            reported = np.array([one.reported for _, one in found]) & named
            if reported.any():
                ax.plot(hour[reported], change[reported], "ro", ms=8, mfc="none", label="reported")
            if result.onset_h is not None:
                ax.axvline(result.onset_h, color="0.6", ls="--", lw=1.0)
            ax.grid(alpha=0.3)
            if row == 0:
                ax.set_title(f"{result.case}\nbench {result.seed}", fontsize=9)
            if column == 0:
                ax.set_ylabel(f"change of {name}, %")
            if row == 1:
                ax.set_xlabel("hours")
    entries = {
        label: line
        for ax in axes.flat
        for line, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    axes[0, 0].legend(entries.values(), entries, fontsize=8, loc="upper left")
    return drawn


def cases(options: Options) -> list[Task]:
    """All benches in all cases; quickly, the first days of each."""
    days = QUICK_DAYS if options.quick else None
    return [Task(case, seed, days) for seed in options.seeds(BENCHES) for case in CASES]


STUDY = Study("drift", cases, examine, figures_of, tables, plots)
