"""Study ``drift``: a machine followed over model versions, with and without a change.

Random benches run equal days of low points; every half day is identified alone and compared with
the halves before it. Two controls without any change count the false reports: the same plan every
day, and the same points every day in another order and for other times. Three machines change: by
slow ageing of the grease, by grease that bleeds, by a housing that gets covered. What the twin says
has the bench's own truth next to it.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from service.lab.studies.common import Options, Plot, Progress, Report, Table, figure, in_processes
from service.lab.studies.drift_runs import (
    BEARING,
    CASES,
    TRUE_QUANTITIES,
    VERSION_MIN,
    Finding,
    RunResult,
    examine,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "drift"
BENCHES = 8


def run(progress: Progress, options: Options) -> Report:
    """Follow all benches in all cases."""
    tasks = [(case, seed) for seed in options.seeds(BENCHES) for case in CASES]
    return report(in_processes(examine, tasks, progress))


def report(results: Sequence[RunResult]) -> Report:
    """Put all benches together into figures, tables and plots."""
    cases = {case: [one for one in results if one.case == case] for case in CASES}
    found = {case: _figures(case, runs) for case, runs in cases.items() if runs}
    document: dict[str, Any] = {
        "study": NAME,
        "bearing": BEARING,
        "seeds": sorted({result.seed for result in results}),
        "hours_per_version": VERSION_MIN / 60.0,
        "cases": found,
        "runs": [_run_document(result) for result in results],
    }
    shown = min(result.seed for result in results)
    plots = (Plot("drift-series", partial(_draw, [one for one in results if one.seed == shown])),)
    return Report(NAME, document, (_summary(found), _benches(results)), plots)


def _figures(case: str, runs: Sequence[RunResult]) -> dict[str, Any]:
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
        "mean_abs_error": _mean(errors),
        "interval_holds_truth": _mean(held),
        "tripped": sum(result.tripped_h is not None for result in runs),
        "reported_before_trip": sum(result.tripped_h is not None for result, _ in firsts),
    }


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _run_document(result: RunResult) -> dict[str, Any]:
    return {
        "case": result.case,
        "seed": result.seed,
        "onset_h": result.onset_h,
        "tripped_h": result.tripped_h,
        "versions": [asdict(version) for version in result.versions],
    }


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole}" if whole else "-"


def _percent(value: float | None, sign: str = "") -> str:
    return "-" if value is None else f"{100.0 * value:{sign}.0f} %"


def _hours(value: float | None) -> str:
    return "-" if value is None else f"{value:.0f} h"


def _summary(cases: dict[str, dict[str, Any]]) -> Table:
    rows = []
    for case, one in cases.items():
        moves = one["moves"]
        rows.append(
            (
                case,
                moves or "nothing",
                _share(one["false_reports"], one["compared_without_change"]),
                _share(one["detected"], one["benches"]) if moves else "-",
                f"{_hours(one['delay_h_median'])} / {_hours(one['delay_h_max'])}",
                _percent(one["true_change_at_report"], "+"),
                _share(one["named_right"], one["sudden_reports"]) if moves else "-",
                _percent(one["mean_abs_error"]),
                _percent(one["interval_holds_truth"]),
                str(one["failed_fits"]),
            )
        )
    return Table(
        "Changes of the machine: reported, named, measured",
        (
            "case",
            "what moves",
            "false reports",
            "benches detected",
            "delay, median / longest",
            "true change by then",
            "named right",
            "error of the change",
            "95 % interval holds",
            "failed fits",
        ),
        tuple(rows),
        (
            "A version is half a day. The delay counts from the onset of the fault to the end of "
            "the version that reports it, in steps of 12 h. Stated rate of false reports: 1 % per "
            "comparison, besides those of the sums.",
            "A failed fit, as a rule over a change amid its data, is not compared.",
        ),
    )


def _benches(results: Sequence[RunResult]) -> Table:
    rows = []
    for result in results:
        moves = CASES[result.case]
        first = result.first_report()
        if moves is None or first is None or first.finding is None:
            continue
        found = first.finding
        said = found.group if found.sudden else f"creeping {', '.join(found.creeping)}"
        last = [one.finding for one in result.versions if one.finding is not None][-1]
        change, low, high = last.moves[moves]
        rows.append(
            (
                result.case,
                str(result.seed),
                _hours(result.onset_h),
                _hours(first.end_h),
                said,
                _percent(found.truth[moves], "+"),
                f"{_percent(change, '+')} ({_percent(low, '+')} to {_percent(high, '+')})",
                _percent(last.truth[moves], "+"),
                _hours(result.tripped_h),
            )
        )
    return Table(
        "Bench by bench",
        (
            "case",
            "seed",
            "onset",
            "first report",
            "what it names",
            "true change by then",
            "change at the last version",
            "truth",
            "tripped",
        ),
        tuple(rows),
    )


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
            told = np.array([one.reported for _, one in found]) & named
            if told.any():
                ax.plot(hour[told], change[told], "ro", ms=8, mfc="none", label="reported")
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
