"""Two bearings of wind turbines: identified at low power, forecast at high power.

Per turbine and bearing a one-node network of its own (`networks/*.toml`) is identified on spans of
at least six hours below 500 kW. Forecasts begin at the end of such a span, last up to 24 hours and
reach 1200 kW; the twin runs open loop from the temperature at their beginning. The naive forecasts
learn from the same rows and know the same inputs.

The twin learns as a running service does: each forecast at high power is made by the model of the
last low spans before it, since bearings and their cooling change over years.

A network comes in variants that differ in how the heat follows speed and load. Which of them may
forecast is decided before the high part is seen: by a nested extrapolation inside the low part
(identified below 250 kW only, each predicts what lies between 250 and 500 kW), and by whether its
parameters stay within their ranges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies import turbines
from bearing_twin_laboratory.studies.field_data_ledger import LeadScores, issue, scored
from bearing_twin_laboratory.studies.study import Options, StudyError
from bearing_twin_laboratory.studies.turbines import Record
from service.site.machines.machine import Machine
from service.site.machines.networks import NetworkSection, read_network
from twin_core.forecasting import forecast
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.gates import GateCheck
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import Posterior
from twin_core.initial_state import initial_state
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.naive import fit_naive
from twin_core.process_noise import LONG_RUN_IN
from twin_core.simulation import OperatingProfile
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

LOW_KW, HIGH_KW = 500.0, 1200.0
NESTED_LOW_KW, NESTED_HIGH_KW = 250.0, 400.0
SPAN_S, HORIZON_S = 6 * 3600.0, 24 * 3600.0
MOST_SPANS = 60
"""A fit takes at most this many spans, evenly chosen; more hardly teach a network of one node."""

RECENT_SPANS, RECENT_S = 12, 60 * 86400.0
"""A forecast's model is identified on as many of the spans of the time before it, at most."""
_LEAST_SPANS = 2
_LIMIT_Z = 3.8
# Heat in W per rpm and N mm of friction moment.
_W_PER_RPM_NMM = 1e-3 * 2.0 * np.pi / 60.0
_MEMBERS = 200

VARIANTS = ("load on its prior", "speed only", "free law")
"""In the order of preference among those that pass: the more of the physics, the better."""


@dataclass(frozen=True, slots=True)
class BearingCase:
    """One bearing of a turbine.

    - ``name``: for reports.
    - ``file``: its network.
    - ``sensor``, ``column``: the network's sensor and the column that it reads.
    - ``ambient``: columns whose mean is the network's ambient.
    - ``reference_k``: rms error of the best linear static or lumped model on another turbine of the
      farm.
    """

    name: str
    file: str
    sensor: str
    column: str
    ambient: tuple[str, ...]
    reference_k: float


CASES = (
    BearingCase(
        "rotor bearing",
        "rotor_bearing.toml",
        "t_rotor_bearing_c",
        turbines.ROTOR_BEARING,
        (turbines.HUB, turbines.NACELLE),
        2.1,
    ),
    BearingCase(
        "generator bearing 1",
        "generator_bearing.toml",
        "t_generator_bearing_c",
        turbines.GENERATOR_BEARING,
        (turbines.NACELLE,),
        2.7,
    ),
)


@dataclass(frozen=True, slots=True)
class Order:
    """One fit of one variant, for a process of its own."""

    files: tuple[Path, ...]
    turbine: str
    case: BearingCase
    variant: str


@dataclass(frozen=True, slots=True, eq=False)
class Forecasts:
    """Errors of several methods over the same forecasts.

    - ``rmse_k``: by method, over all rows of all forecasts.
    - ``count``: how many forecasts.
    - ``coverage``, ``half_width_k``: of the twin's 95 % band.
    - ``curves``: the forecast that rose most: hours, measured, and the twin's quantiles (3, n).
    """

    rmse_k: Mapping[str, float]
    count: int
    coverage: float
    half_width_k: float
    curves: tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one variant did: on the low part, inside it, and on the high part.

    Of ``spans`` low spans all are fitted together for the gate, and for the forecasts at high power
    ``without_recent`` that begin with fewer than two spans of the time before. ``ledger`` has
    hourly forecasts over the rows of ``high`` by lead time in s, scored as the live ones are.
    """

    order: Order
    parameters: Mapping[str, object]
    train_rms_k: float
    checks: tuple[GateCheck, ...]
    nested: Forecasts
    high: Forecasts
    ledger: Mapping[int, LeadScores]
    spans: int
    without_recent: int


def cases(options: Options) -> list[Order]:
    """All variants of all bearings of a folder's turbines; quickly, of its first turbine.

    Raises `StudyError` if a file cannot be used: that is said before hours of work.
    """
    if options.data is None:
        raise StudyError("--data: the study field-data needs it")
    by_turbine = list(turbines.turbine_files(options.data).items())
    if options.quick:
        del by_turbine[1:]
    for _, files in by_turbine:
        for file in files:
            turbines.read_record(file)
    return [
        Order(tuple(files), turbine, case, variant)
        for turbine, files in by_turbine
        for case in CASES
        for variant in VARIANTS
    ]


def examine(order: Order) -> Outcome:
    """Identify one variant, twice, and forecast."""
    records = [turbines.read_record(file) for file in order.files]
    model = Machine("default", None, variant_of(case_network(order.case), order.variant)).build()
    low = spans(records, order.case, LOW_KW)
    lower = spans(records, order.case, NESTED_LOW_KW)
    ahead = excursions(records, order.case, LOW_KW, HIGH_KW, np.inf)
    within = excursions(records, order.case, NESTED_LOW_KW, NESTED_HIGH_KW, LOW_KW)
    for what, found in (
        (f"no span of 6 h below {LOW_KW:g} kW", low),
        (f"no span of 6 h below {NESTED_LOW_KW:g} kW", lower),
        (f"no rise from such a span to {HIGH_KW:g} kW within 24 h", ahead),
        (f"no rise from such a span to {NESTED_HIGH_KW:g} kW within 24 h", within),
    ):
        if not found:
            raise StudyError(f"turbine {order.turbine}: {what}; expected at least one")
    nested, _ = fit(model, lower)
    nested_forecasts = forecasts(model, [(nested, lower)] * len(within), within, order.case)
    posterior, converged = fit(model, low)
    learned = [recent(low, rows) for rows in ahead]
    known = [
        (fit(model, own)[0], own) if len(own) >= _LEAST_SPANS else (posterior, low)
        for own in learned
    ]
    return Outcome(
        order,
        posterior.parameters(model),
        posterior.train_rms_k[order.case.sensor],
        (converged, _ranges(model, posterior)),
        nested_forecasts,
        forecasts(model, known, ahead, order.case),
        scored(
            [
                issue(model, learnt, fit_naive(own), rows, order.case.sensor)
                for (learnt, own), rows in zip(known, ahead, strict=True)
            ]
        ),
        len(low),
        sum(len(own) < _LEAST_SPANS for own in learned),
    )


def recent(low: Sequence[MinuteData], rows: MinuteData) -> list[MinuteData]:
    """The last low spans of the time before rows; one that ends with their first row counts."""
    begin_s = float(rows.time_s[0])
    before = [
        one for one in low if begin_s - RECENT_S <= one.time_s[0] and one.time_s[-1] <= begin_s
    ]
    return before[-RECENT_SPANS:]


def case_network(case: BearingCase) -> NetworkSection:
    """Read the network of a bearing."""
    return read_network(Path(__file__).parent / "networks" / case.file)


def variant_of(network: NetworkSection, variant: str) -> NetworkSection:
    """Return a network whose heat follows speed and load as a variant says.

    ``speed only`` leaves the load's part out. ``free law`` has powers of speed and load, the
    exponents and the load's share as good as free, as one would fit them to good data.
    """
    document = network.model_dump(mode="json")
    if variant == "speed only":
        del document["parameters"]["load"]
        document["source"]["per_n_w"] = 0.0
    elif variant == "free law":
        parameters, source = document["parameters"], document["source"]
        centre = parameters["speed"]["centre"] / _W_PER_RPM_NMM
        for name in ("speed", "load", "rest"):
            del parameters[name]
        free = {"transform": "linear", "spread": 2.0}
        share = {"centre": 0.5, "spread": 0.5, "lower": 0.0, "upper": 1.0}
        parameters |= {
            "moment": {"unit": "N mm", "centre": centre, "spread": 1.5},
            "speed_exponent": free | {"centre": 0.0},
            "load_share": free | share,
            "load_exponent": free | {"centre": 1.0},
        }
        document["source"] = {
            "kind": "two-part",
            "lubricant_node": source["shares"][0]["node"],
            "moment_nmm": "moment",
            "speed_exponent": "speed_exponent",
            "viscosity_exponent": 0.0,
            "load_share": "load_share",
            "load_exponent": "load_exponent",
            "shares": source["shares"],
        }
    return NetworkSection.model_validate(document)


def spans(records: Sequence[Record], case: BearingCase, below_kw: float) -> list[MinuteData]:
    """Spans of at least six hours below a power."""
    found = []
    for record in records:
        for first, end in _low_runs(record, below_kw):
            rows = record.minutes(first, end, case.ambient, case.sensor, case.column)
            if np.count_nonzero(np.isfinite(rows.temperatures_c[case.sensor])) >= 3:
                found.append(rows)
    return found


def excursions(
    records: Sequence[Record], case: BearingCase, low_kw: float, high_kw: float, ceiling_kw: float
) -> list[MinuteData]:
    """Rows from the end of each low span on, for up to 24 h, that reach the high power.

    They end before a power of ``ceiling_kw`` and before rows without speed, torque or ambient, and
    do not overlap.
    """
    found = []
    for record in records:
        power = record.values[turbines.POWER]
        usable = record.known & (power < ceiling_kw)
        taken_s = -np.inf
        for _, low_end in _low_runs(record, low_kw):
            first = low_end - 1
            start_s = float(record.time_s[first])
            until_s = start_s + HORIZON_S
            end = next(
                (
                    last
                    for begin, last in record.runs(usable & (record.time_s <= until_s))
                    if begin <= first < last
                ),
                first,
            )
            if start_s < taken_s or end - first < 3 or power[first:end].max() < high_kw:
                continue
            rows = record.minutes(first, end, case.ambient, case.sensor, case.column)
            if not np.isfinite(rows.temperatures_c[case.sensor][0]):
                continue
            found.append(rows)
            taken_s = float(record.time_s[end - 1])
    return found


def _low_runs(record: Record, below_kw: float) -> list[tuple[int, int]]:
    with np.errstate(invalid="ignore"):
        low = record.known & (record.values[turbines.POWER] < below_kw)
    return [
        (first, end)
        for first, end in record.runs(low)
        if record.time_s[end - 1] - record.time_s[first] >= SPAN_S
    ]


def fit(model: ThermalModel, rows: Sequence[MinuteData]) -> tuple[Posterior, GateCheck]:
    """Identify a network, and say whether it follows the rows."""
    chosen = np.unique(
        np.linspace(0, len(rows) - 1, min(MOST_SPANS, len(rows))).round().astype(int)
    )
    data = IdentificationData(
        tuple(IdentificationWindow(rows[k], False, LONG_RUN_IN) for k in chosen)
    )
    result = identify(model, data, FitSettings(method="refine", samples=0))
    converged = result.status == "converged"
    return result.posterior, GateCheck("fit", converged, f"fit: {result.reason}", {})


def _ranges(model: ThermalModel, posterior: Posterior) -> GateCheck:
    names = model.parameters.names
    edge = [name for name, z in zip(names, posterior.z, strict=True) if abs(z) > _LIMIT_Z]
    detail = f"{', '.join(edge)} at the edge of its range" if edge else "all within their ranges"
    return GateCheck("ranges", not edge, f"parameters: {detail}", {})


def forecasts(
    model: ThermalModel,
    learned: Sequence[tuple[Posterior, Sequence[MinuteData]]],
    tests: Sequence[MinuteData],
    case: BearingCase,
) -> Forecasts:
    """Forecast from the first row of every test and compare with what was measured.

    ``learned`` has for every test what the model knows, and the rows that it knows it from.
    """
    errors: dict[str, list[FloatArray]] = {}
    inside, half_widths, largest, curves = [], [], -np.inf, (np.zeros(0),) * 3
    for (posterior, training), rows in zip(learned, tests, strict=True):
        naive = fit_naive(training)
        values = model.parameters.values_from_z(posterior.z)
        profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
        measured = rows.temperatures_c[case.sensor]
        now = {case.sensor: float(measured[0])}
        point = (float(rows.ambient_c[0]), float(rows.speed_rpm[0]), float(rows.load_n[0]))
        mean, covariance = initial_state(model, values, now, *point, False)
        state = MachineState(mean, covariance, LONG_RUN_IN, point[0])
        made = forecast(model, posterior, state, profile, members=_MEMBERS, seed=0)
        low, median, high = made.quantile(case.sensor)[[0, 2, 4]]
        known = np.isfinite(measured)
        errors.setdefault("twin", []).append((median - measured)[known])
        inside.append(((measured >= low) & (measured <= high))[known])
        half_widths.append((high - low)[known] / 2.0)
        for kind, by_sensor in naive.forecast(profile, now).items():
            errors.setdefault(kind, []).append((by_sensor[case.sensor] - measured)[known])
        rise = float(np.nanmax(measured) - measured[0])
        if rise > largest:
            largest = rise
            hours = (rows.time_s - rows.time_s[0]) / 3600.0
            curves = (hours, measured, np.stack((low, median, high)))
    return Forecasts(
        {
            method: float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
            for method, parts in errors.items()
        },
        len(tests),
        float(np.mean(np.concatenate(inside))),
        float(np.mean(np.concatenate(half_widths))),
        curves,
    )
