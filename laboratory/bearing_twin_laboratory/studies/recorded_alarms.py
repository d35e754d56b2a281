"""Study ``recorded-alarms``: how often the service calls an operator to a healthy machine.

Two bearings of each recorded wind turbine, which no report calls ill. Before each recorded span the
model is identified again on the last low spans before it, and the span is watched with the
service's own estimate, rules and alarm book. Each call is a false one. What is recorded every ten
minutes comes every two here, on a line between: the service takes a longer silence for a stop.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from adapters.samples import Quality, Sample
from bearing_twin_laboratory.studies import turbines
from bearing_twin_laboratory.studies.alarm_runs import (
    MARGIN_ALARM_K,
    MARGIN_WARNING_K,
    Call,
    watched,
)
from bearing_twin_laboratory.studies.field_data_runs import (
    CASES,
    LOW_KW,
    RECENT_SPANS,
    BearingCase,
    case_network,
    fit,
    spans,
)
from bearing_twin_laboratory.studies.study import (
    Document,
    Options,
    Study,
    StudyError,
    Table,
    cell,
    table,
    text,
)
from bearing_twin_laboratory.studies.turbines import Record
from service.live.estimate import RunningModel
from service.site.asset_section import AssetSection
from service.site.machines.machine import Machine
from twin_core.windows import MinuteData

ASKED_PER_1000_H = 0.5

_STEP_S = 120.0
_FORECAST_EVERY_S = 3600.0
_FEWEST_SPANS = 2


@dataclass(frozen=True, slots=True)
class Order:
    """One bearing of one turbine."""

    files: tuple[Path, ...]
    turbine: str
    case: BearingCase


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the service said of one bearing.

    - ``hours``: how long it was watched.
    - ``calls``: every call for an operator.
    - ``not_watched``: spans without a model, and why.
    """

    turbine: str
    bearing: str
    hours: float
    calls: tuple[Call, ...]
    not_watched: Mapping[str, str]


def cases(options: Options) -> list[Order]:
    """All bearings of a folder's turbines; quickly, one bearing over two spans."""
    if options.data is None:
        raise StudyError("--data: the study recorded-alarms needs it")
    orders = [
        Order(tuple(files), turbine, case)
        for turbine, files in turbines.turbine_files(options.data).items()
        for case in CASES
    ]
    if options.quick:
        first = orders[0]
        return [Order(first.files[:2], first.turbine, first.case)]
    return orders


def examine(order: Order) -> Outcome:
    """Watch one bearing through all spans but the first, which teaches the first model."""
    records = [turbines.read_record(file) for file in order.files]
    network = case_network(order.case)
    model = Machine("default", None, network).build()
    hours, calls, not_watched = 0.0, list[Call](), dict[str, str]()
    for number in range(1, len(records)):
        record, before = records[number], records[:number]
        learned = spans(before, order.case, LOW_KW)[-RECENT_SPANS:]
        if len(learned) < _FEWEST_SPANS:
            not_watched[record.name] = f"{len(learned)} low spans before it"
            continue
        posterior, check = fit(model, learned)
        if not check.passed:
            not_watched[record.name] = check.detail
            continue
        rows = _rows(record, order.case)
        begin_us = round(1e6 * float(rows.time_s[0]))
        calls += watched(
            _section(order, before),
            RunningModel(1, model, posterior, begin_us),
            _samples(order.case.sensor, rows),
            _STEP_S,
            begin_us,
            _FORECAST_EVERY_S,
        )
        hours += float(rows.time_s[-1] - rows.time_s[0]) / 3600.0
    return Outcome(order.turbine, order.case.name, hours, tuple(calls), not_watched)


def _rows(record: Record, case: BearingCase) -> MinuteData:
    return record.minutes(0, record.time_s.size, case.ambient, case.sensor, case.column)


def _section(order: Order, before: Sequence[Record]) -> AssetSection:
    """Limits a margin over the hottest that it has been before."""
    case = order.case
    hottest = max(float(np.nanmax(record.values[case.column])) for record in before)
    channels = ("speed_rpm", "load_n", "ambient_c", case.sensor)
    return AssetSection.model_validate(
        {
            "id": "turbine",
            "network": case_network(case).model_dump(mode="json", exclude_none=True),
            "low_risk": {"speed_rpm_max": 1800.0, "load_n_max": 4000.0},
            "limits": {
                case.sensor: {
                    "warning": hottest + MARGIN_WARNING_K,
                    "alarm": hottest + MARGIN_ALARM_K,
                }
            },
            "channels": {name: {"source": "push"} for name in channels},
        }
    )


def _samples(sensor: str, rows: MinuteData) -> Iterator[tuple[int, list[Sample]]]:
    """What arrives during each step: on a line between two rows, nothing next to a missing one."""
    columns = {
        "speed_rpm": rows.speed_rpm,
        "load_n": rows.load_n,
        "ambient_c": rows.ambient_c,
        sensor: rows.temperatures_c[sensor],
    }
    for first, second in pairwise(range(rows.size)):
        begin_s, end_s = float(rows.time_s[first]), float(rows.time_s[second])
        for time_s in np.arange(begin_s + _STEP_S, end_s + 1.0, _STEP_S):
            time_us = round(1e6 * float(time_s))
            share = (float(time_s) - begin_s) / (end_s - begin_s)
            samples = []
            for name, values in columns.items():
                value = float(values[first] + share * (values[second] - values[first]))
                if np.isfinite(value):
                    samples.append(Sample("turbine", name, time_us, value, Quality.GOOD, time_us))
            yield time_us, samples


def figures_of(outcomes: Sequence[Outcome]) -> Document:
    """Calls by kind, over all bearings and by bearing."""
    hours = sum(one.hours for one in outcomes)
    kinds = Counter(call.kind for one in outcomes for call in one.calls)
    return {
        "hours": hours,
        "asked_per_1000_h": ASKED_PER_1000_H,
        "kinds": {
            kind: {"calls": count, "per_1000_h": 1000.0 * count / hours if hours else None}
            for kind, count in sorted(kinds.items())
        },
        "bearings": [
            {
                "turbine": one.turbine,
                "bearing": one.bearing,
                "hours": one.hours,
                "calls": dict(Counter(call.kind for call in one.calls)),
                "not_watched": dict(one.not_watched),
            }
            for one in outcomes
        ],
    }


def tables(outcomes: Sequence[Outcome], document: Document) -> Iterator[Table]:
    """False calls by kind, then by bearing."""
    yield table(
        f"False alarms of recorded healthy machines in {document['hours']:.0f} h",
        [{"kind": kind, **found} for kind, found in document["kinds"].items()],
        (
            ("kind", cell("kind")),
            ("calls", cell("calls")),
            ("per 1000 h", cell("per_1000_h", text)),
        ),
        f"Asked: at most {ASKED_PER_1000_H:g} per 1000 h of each kind. A kind that is not named "
        "has not called.",
    )
    yield table(
        "By bearing",
        document["bearings"],
        (
            ("turbine", cell("turbine")),
            ("bearing", cell("bearing")),
            ("hours", cell("hours", text, 0)),
            ("calls", lambda row: ", ".join(f"{k} {n}" for k, n in row["calls"].items()) or "none"),
            ("spans not watched", lambda row: str(len(row["not_watched"]))),
        ),
    )


STUDY = Study("recorded-alarms", cases, examine, figures_of, tables)
