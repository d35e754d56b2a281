"""Study ``recorded-sisters``: a recorded family, from low heat to high heat.

The machine is a board with two small heaters (Temperature Control Lab) that several owners have
recorded: no virtual bench made these numbers. A run's first part, at low heat, is identified; the
rest, with hotter heaters than it has seen, is forecast whole. Each run is forecast by the
literature's prior, by what recordings of *other* boards teach, and by what the same board did on
other days. All goes the way of the command line: identify, follow, forecast.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bearing_twin_laboratory.studies.study import (
    Document,
    Options,
    Study,
    StudyError,
    Table,
    cell,
    mean,
    share,
    table,
    text,
)
from service.offline.forecasting import follow, forecast_profile
from service.offline.identification import (
    FailedFitError,
    Identified,
    check_options,
    identify_recording,
)
from service.offline.tables import PlannedRows, Recording
from service.site.machines.machine import Machine
from service.site.machines.networks import read_network
from twin_core import scores
from twin_core.sisters import Sister, sister_of

TARGETS, OTHERS = "saopaulo_*.csv", ("apmonitor_*.csv", "kantor*.csv")
LOW_S = 3000.0
"""The heaters stay below 67 % this long; then they go to 82 %, the sensors to 100 degC."""

ALONE = "literature"
OTHER_BOARDS = "other boards"
OTHER_DAYS = "this board, other days"
CONDITIONS = (ALONE, OTHER_BOARDS, OTHER_DAYS)

_SENSORS = {"t_1_c": "t1_c", "t_2_c": "t2_c"}
_HEATERS = ("heater1_percent", "heater2_percent")
_QUICK_TARGETS = 1


@dataclass(frozen=True, slots=True)
class Order:
    """One run that is forecast, and all recordings of the folder."""

    target: Path
    same_board: tuple[Path, ...]
    other_boards: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class SensorScores:
    """A sensor's forecast over all rows that lie ahead.

    - ``held_whole``: whether all of them lay inside the band of the whole run (90 %).
    - ``outside_whole``: share of the rows that did not.
    """

    rms_k: float
    coverage_95: float
    half_width_k: float
    interval_score_k: float
    held_whole: bool
    outside_whole: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run under all conditions.

    - ``sensors``: by condition and sensor; a condition whose fit failed is missing.
    - ``accepted``: what the product said of the sisters, by condition.
    - ``not_learned``: recordings that the network does not follow, and why.
    """

    run: str
    sensors: Mapping[str, Mapping[str, SensorScores]]
    accepted: Mapping[str, bool]
    not_learned: Mapping[str, str]


def cases(options: Options) -> list[Order]:
    """Each run of the board that was recorded most; quickly, its first."""
    folder = options.data
    if folder is None:
        raise StudyError("--data: the study recorded-sisters needs it")
    same = sorted(folder.glob(TARGETS))
    others = sorted(path for pattern in OTHERS for path in folder.glob(pattern))
    for pattern, found in ((TARGETS, same), (" or ".join(OTHERS), others)):
        if len(found) < 2:
            raise StudyError(f"--data {folder}: {len(found)} files {pattern}, expected at least 2")
    for path in (*same, *others):
        read_board(path)
    return [
        Order(path, tuple(one for one in same if one != path), tuple(others))
        for path in same[: _QUICK_TARGETS if options.quick else None]
    ]


def read_board(path: Path) -> Recording:
    """Read a recording; the ambient is the mean of both sensors at its first row, at rest.

    Raises `StudyError` if the file cannot be used.
    """
    try:
        rows = np.genfromtxt(path, delimiter=",", names=True)
        # Of rows of one time the last holds.
        rows = rows[np.append(np.diff(rows["time_s"]) > 0.0, True)]
        temperatures = {name: rows[column].copy() for name, column in _SENSORS.items()}
        heaters = {name: rows[name].copy() for name in _HEATERS}
    except (OSError, ValueError) as error:
        raise StudyError(f"{path}: {error}") from error
    for name, values in (heaters | temperatures).items():
        missing = np.flatnonzero(~np.isfinite(values))
        if missing.size:
            raise StudyError(f"{path}: {name}, row {missing[0] + 1}: not a number")
    ambient_c = float(np.mean([values[0] for values in temperatures.values()]))
    return Recording(
        name=path.stem,
        start_us=None,
        time_s=rows["time_s"].copy(),
        speed_rpm=np.zeros(rows.size),
        load_n=np.zeros(rows.size),
        ambient_c=np.full(rows.size, ambient_c),
        temperatures_c=temperatures,
        inputs=heaters,
    )


def examine(order: Order) -> Outcome:
    """Identify the low part of a run under each condition, and forecast the rest."""
    network = read_network(Path(__file__).parent / "networks" / "heater_pair.toml")
    machine = Machine("default", None, network)
    not_learned: dict[str, str] = {}
    run = read_board(order.target)
    begin = int(np.searchsorted(run.time_s, LOW_S))
    low = _rows(run, slice(0, begin + 1))
    families: dict[str, list[Sister]] = {ALONE: []}
    for condition, paths in (
        (OTHER_BOARDS, order.other_boards),
        (OTHER_DAYS, order.same_board),
    ):
        families[condition] = list(_sisters(machine, paths, not_learned))
    sensors: dict[str, dict[str, SensorScores]] = {}
    accepted: dict[str, bool] = {}
    for condition, sisters in families.items():
        try:
            found = _identified(machine, low, sisters)
        except FailedFitError as error:
            not_learned[f"{order.target.stem}, {condition}"] = str(error)
            continue
        sensors[condition] = _scores(found, run, begin)
        if found.sisters is not None:
            accepted[condition] = found.sisters.accepted
    return Outcome(order.target.stem, sensors, accepted, not_learned)


def _identified(machine: Machine, rows: Recording, sisters: Sequence[Sister]) -> Identified:
    return identify_recording(
        rows,
        machine=machine,
        procedure=check_options("refine", None, 0),
        at_rest=True,
        sisters_of=(lambda _: sisters) if sisters else None,
    )


def _sisters(
    machine: Machine, paths: Sequence[Path], not_learned: dict[str, str]
) -> Iterator[Sister]:
    for path in paths:
        try:
            found = _identified(machine, read_board(path), ()).model
        except FailedFitError as error:
            not_learned[path.stem] = str(error)
            continue
        yield sister_of(path.stem, found.posterior, found.data)


def _rows(run: Recording, chosen: slice) -> Recording:
    return replace(
        run,
        time_s=run.time_s[chosen],
        speed_rpm=run.speed_rpm[chosen],
        load_n=run.load_n[chosen],
        ambient_c=run.ambient_c[chosen],
        temperatures_c={name: of[chosen] for name, of in run.temperatures_c.items()},
        inputs={name: of[chosen] for name, of in run.inputs.items()},
    )


def _scores(found: Identified, run: Recording, begin: int) -> dict[str, SensorScores]:
    state = follow(found.model, _rows(run, slice(0, begin + 1)))
    ahead = _rows(run, slice(begin, None))
    planned = PlannedRows(
        ahead.time_s - ahead.time_s[0],
        ahead.speed_rpm,
        ahead.load_n,
        ahead.ambient_c,
        np.stack(list(ahead.inputs.values()), axis=1),
    )
    made = forecast_profile(found.model, state, planned)
    result = {}
    for name in made.sensors:
        # The present row is no forecast.
        low, _, median, _, high = made.quantiles[:, 1:, made.names.index(name)]
        measured = ahead.temperatures_c[name][1:]
        lowest, highest = made.whole_run[name][:, 1:]
        outside = 1.0 - scores.coverage(lowest, highest, measured)
        result[name] = SensorScores(
            rms_k=float(np.sqrt(np.mean((median - measured) ** 2))),
            coverage_95=scores.coverage(low, high, measured),
            half_width_k=float(np.mean(high - low) / 2.0),
            interval_score_k=float(np.mean(scores.interval_score(low, high, measured))),
            held_whole=outside == 0.0,
            outside_whole=outside,
        )
    return result


def figures_of(outcomes: Sequence[Outcome]) -> Document:
    """Figures by condition over all runs, and by run."""
    return {
        "low_s": LOW_S,
        "conditions": {name: _figures(name, outcomes) for name in CONDITIONS},
        "runs": {
            one.run: {
                condition: {
                    name: {field: getattr(found, field) for field in SensorScores.__slots__}
                    for name, found in sensors.items()
                }
                for condition, sensors in one.sensors.items()
            }
            for one in outcomes
        },
        "not_learned": {name: why for one in outcomes for name, why in one.not_learned.items()},
    }


def _figures(condition: str, outcomes: Sequence[Outcome]) -> Document:
    found = [sensor for one in outcomes for sensor in one.sensors.get(condition, {}).values()]
    judged = [one.accepted[condition] for one in outcomes if condition in one.accepted]
    return {
        "runs": sum(condition in one.sensors for one in outcomes),
        "accepted": sum(judged) if judged else None,
        "rms_k": mean(one.rms_k for one in found),
        "worst_rms_k": max((one.rms_k for one in found), default=None),
        "coverage_95": mean(one.coverage_95 for one in found),
        "worst_coverage_95": min((one.coverage_95 for one in found), default=None),
        "half_width_k": mean(one.half_width_k for one in found),
        "interval_score_k": mean(one.interval_score_k for one in found),
        "sensor_runs": len(found),
        "held_whole": sum(one.held_whole for one in found),
        "outside_whole": mean(one.outside_whole for one in found),
    }


def tables(outcomes: Sequence[Outcome], document: Document) -> Iterator[Table]:
    """All conditions."""
    yield table(
        f"Recorded sisters: {len(outcomes)} runs from low heat to high heat, K",
        [{"name": name, **found} for name, found in document["conditions"].items()],
        (
            ("prior", cell("name")),
            ("runs", cell("runs")),
            ("accepted", cell("accepted", lambda v: "–" if v is None else str(v))),
            ("rms", cell("rms_k", text)),
            ("worst", cell("worst_rms_k", text)),
            ("covers, %", cell("coverage_95", share)),
            ("worst, %", cell("worst_coverage_95", share)),
            ("half-width", cell("half_width_k", text)),
            ("interval score", cell("interval_score_k", text)),
            ("whole runs in 90 %", lambda row: f"{row['held_whole']} of {row['sensor_runs']}"),
            ("rows outside it, %", cell("outside_whole", share, 2)),
        ),
        "Two sensors a run. Identified in the first 50 min, forecast for the 80 min after them "
        "with the heaters known and the ambient as at the beginning.",
        *(f"Not followed: {name}: {why}" for name, why in document["not_learned"].items()),
    )


STUDY = Study("recorded-sisters", cases, examine, figures_of, tables)
