"""Study ``alarms``: how soon each kind of alarm reports a fault, and how often without one.

Random virtual benches run the service's own estimate, rules and alarm book, with the defaults of
the configuration and limits set from what was normal before. Two controls without any change count
false alarms; four scenarios bring faults. Process time, nothing waits.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict

import numpy as np

from bearing_twin_laboratory.studies.alarm_runs import (
    CONTROLS,
    IDENTIFIED_H,
    LONG_CASES,
    MARGIN_ALARM_K,
    MARGIN_WARNING_K,
    SHORT_CASES,
    AlarmRun,
    examine,
)
from bearing_twin_laboratory.studies.study import Document, Study, Table, table, text
from service.alarm_kinds import KINDS as ALARM_KINDS

BENCHES = 4
KINDS = (*ALARM_KINDS, "history not kept")


def figures_of(results: Sequence[Sequence[AlarmRun]]) -> Document:
    """False alarms, delays, and every run."""
    runs = [one for bench in results for one in bench]
    controls = [one for one in runs if one.case in CONTROLS]
    hours = sum(one.hours for one in controls)
    false = Counter(call.kind for one in controls for call in one.calls)
    return {
        "seeds": sorted({one.seed for one in runs}),
        "margins_k": {"warning": MARGIN_WARNING_K, "alarm": MARGIN_ALARM_K},
        "watched_from_h": IDENTIFIED_H,
        "fault_free_hours": round(hours, 2),
        "false_alarms_per_1000_h": {
            kind: round(1000.0 * false[kind] / hours, 2) if hours else None for kind in KINDS
        },
        "detection": {
            case: _delays([one for one in runs if one.case == case])
            for case in (*LONG_CASES, *SHORT_CASES)
            if case not in CONTROLS
        },
        "runs": [asdict(one) for one in runs],
    }


def _delays(runs: Sequence[AlarmRun]) -> Document:
    """For every kind: on how many benches it reported the fault, and after how long."""
    found: Document = {}
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


def tables(results: Sequence[Sequence[AlarmRun]], document: Document) -> Iterator[Table]:
    """False alarms, then delays."""
    calls = (
        call for bench in results for one in bench if one.case in CONTROLS for call in one.calls
    )
    false = Counter(call.kind for call in calls)
    yield table(
        f"False alarms in {document['fault_free_hours']:.0f} h without a fault",
        KINDS,
        (
            ("kind", str),
            ("alarms", lambda kind: str(false[kind])),
            ("per 1000 h", lambda kind: text(document["false_alarms_per_1000_h"][kind])),
        ),
        f"Limits {MARGIN_WARNING_K:g} and {MARGIN_ALARM_K:g} K over the hottest reading before.",
    )

    def delay(case: str) -> Callable[[str], str]:
        return lambda kind: _delay(document["detection"][case][kind])

    yield table(
        "Median delay from the onset of a fault to the alarm (on how many of the faults)",
        KINDS,
        (("kind", str), *((case, delay(case)) for case in document["detection"])),
    )


def _delay(found: Document) -> str:
    if not found["told"]:
        return "-"
    return f"{_span(found['median_delay_s'])} ({found['told']} of {found['faults']})"


def _span(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


STUDY = Study("alarms", lambda options: options.seeds(BENCHES), examine, figures_of, tables)
