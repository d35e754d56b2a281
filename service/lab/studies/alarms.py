"""Study ``alarms``: how soon each kind of alarm tells of a fault, and how often without one.

Random virtual benches run the service's own estimate, rules and alarm book, with the defaults of
the configuration and limits set from what was normal before. Two controls without any change count
false alarms; four scenarios bring faults. Process time, nothing waits.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from service.alarm_kinds import KINDS as ALARM_KINDS
from service.lab.studies.alarm_runs import (
    CONTROLS,
    IDENTIFIED_H,
    LONG_CASES,
    MARGIN_ALARM_K,
    MARGIN_WARNING_K,
    SHORT_CASES,
    AlarmRun,
    examine,
)
from service.lab.studies.common import Options, Progress, Report, Table, in_processes

NAME = "alarms"
BENCHES = 4
KINDS = (*ALARM_KINDS, "history not kept")


def run(progress: Progress, options: Options) -> Report:
    """Run all benches through all cases."""
    found = in_processes(examine, list(options.seeds(BENCHES)), progress)
    return report([one for runs in found for one in runs])


def report(runs: Sequence[AlarmRun]) -> Report:
    """Put all benches together into figures and tables."""
    controls = [one for one in runs if one.case in CONTROLS]
    hours = sum(one.hours for one in controls)
    false = Counter(call.kind for one in controls for call in one.calls)
    delays = {
        case: _delays([one for one in runs if one.case == case])
        for case in (*LONG_CASES, *SHORT_CASES)
        if case not in CONTROLS
    }
    document: dict[str, Any] = {
        "study": NAME,
        "seeds": sorted({one.seed for one in runs}),
        "margins_k": {"warning": MARGIN_WARNING_K, "alarm": MARGIN_ALARM_K},
        "watched_from_h": IDENTIFIED_H,
        "fault_free_hours": round(hours, 2),
        "false_alarms_per_1000_h": {
            kind: round(1000.0 * false[kind] / hours, 2) if hours else None for kind in KINDS
        },
        "detection": delays,
        "runs": [asdict(one) for one in runs],
    }
    return Report(NAME, document, (_false_table(false, hours), _delay_table(delays)), ())


def _delays(runs: Sequence[AlarmRun]) -> dict[str, Any]:
    """For every kind: on how many benches it told of the fault, and after how long."""
    found: dict[str, Any] = {}
    for kind in KINDS:
        firsts, faults = [], 0
        for one in runs:
            for number, fault in enumerate(one.faults):
                faults += 1
                ends = [other.onset_h for other in one.faults[number + 1 :]]
                until_h = min(ends, default=np.inf)
                times = [
                    call.time_h - fault.onset_h
                    for call in one.calls
                    if call.kind == kind
                    and fault.onset_h <= call.time_h < until_h
                    and fault.channel in ("", call.channel)
                ]
                firsts += times[:1]
        found[kind] = {
            "told": len(firsts),
            "faults": faults,
            "median_delay_s": round(3600.0 * float(np.median(firsts)), 1) if firsts else None,
            "longest_delay_s": round(3600.0 * max(firsts), 1) if firsts else None,
        }
    return found


def _false_table(false: Counter[str], hours: float) -> Table:
    rows = tuple(
        (kind, str(false[kind]), f"{1000.0 * false[kind] / hours:.2f}" if hours else "-")
        for kind in KINDS
    )
    return Table(
        f"False alarms in {hours:.0f} h without a fault",
        ("kind", "alarms", "per 1000 h"),
        rows,
        (f"Limits {MARGIN_WARNING_K:g} and {MARGIN_ALARM_K:g} K over the hottest reading before.",),
    )


def _delay_table(delays: dict[str, Any]) -> Table:
    rows = []
    for kind in KINDS:
        cells = [kind]
        for found in delays.values():
            one = found[kind]
            cells.append(
                f"{_span(one['median_delay_s'])} ({one['told']} of {one['faults']})"
                if one["told"]
                else "-"
            )
        rows.append(tuple(cells))
    return Table(
        "Median delay from the onset of a fault to the alarm (on how many of the faults)",
        ("kind", *delays),
        tuple(rows),
    )


def _span(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
