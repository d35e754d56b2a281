# Generated, do not edit: python client/generate_documents.py
"""What the service sends and takes: the schemas of docs/openapi.json that the client uses."""

from __future__ import annotations

from typing import Annotated, Dict, Literal

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field


class ActiveModel(BaseModel):
    """
    The model version that the live twin runs on.
    """

    version: int
    model: str
    """
    Name of the thermal network.
    """
    trusted: bool
    """
    False while its estimate or forecast fails.
    """
    identified: bool
    """
    False for the priors.
    """
    identified_at: AwareDatetime | None


class AlarmCause(BaseModel):
    """
    What an alarm comes of; one cause has one alarm, whatever number of assets it has.
    """

    kind: Literal["source", "machine", "step", "service"]
    """
    A `source` that assets are read from, the `service` itself, a `machine`, or a `step` that lies ahead of it.
    """
    id: str
    """
    Name of the source, part of the service, or id of the asset.
    """


class AlarmSummary(BaseModel):
    """
    The open alarms of an asset, counted.

    What is shelved, suppressed or out of service is neither active nor unacknowledged.
    """

    active: int
    unacknowledged: int
    shelved: int
    highest_priority: int
    """
    1 to 3; 0: none.
    """
    over_limit: Literal["warning", "alarm"] | None
    """
    The highest measured limit that is exceeded, also while its data are lost.
    """


class ApproachLevel(BaseModel):
    """
    One level on the way to the target.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    N
    """
    expected_c: dict[str, float]
    """
    Median of the steady reading, °C.
    """
    stop_above_c: dict[str, float]
    """
    Upper edge (97.5 %), °C: a reading above it means stop and go back.
    """
    runaway_not_excluded: bool
    allowed: bool
    """
    False from the level on whose upper edge reaches an alarm limit.
    """
    reason: str


class BucketItem(BaseModel):
    """
    Statistics over the good samples of a span of time; null where there is none.
    """

    channel: str
    time: AwareDatetime
    """
    Start of the bucket.
    """
    mean: float | None
    """
    In the channel's unit.
    """
    min: float | None
    """
    In the channel's unit.
    """
    max: float | None
    """
    In the channel's unit.
    """
    count: int
    """
    Good samples in the bucket.
    """
    quality: int
    """
    OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.
    """


class ChannelDocument(BaseModel):
    """
    One channel of an asset.
    """

    name: str
    source: str
    """
    Name of its source; `push` for a pushed one, `twin` for an estimate.
    """
    unit: str
    """
    Empty for a number without one.
    """
    reason: str | None
    """
    Why its value is not good now; null when it is.
    """
    max_age_s: float | None
    """
    Process seconds after which a value is stale; null for an estimate.
    """


class Combination(BaseModel):
    """
    A combination of parameters, in standard coordinates of the prior.
    """

    combination: str
    weights: dict[str, float]
    """
    By parameter; those below 0.05 are left out.
    """
    strength: float
    """
    Singular value of the sensitivities.
    """
    std_over_prior: float
    """
    Standard deviation over that of the prior, 0 to 1.
    """
    verdict: Literal["informed", "weak", "prior only"]


class Crossing(BaseModel):
    """
    When and how probably a limit is exceeded within the horizon of a forecast.
    """

    probability: float
    """
    That it is exceeded.
    """
    median_s: float | None
    """
    Seconds from the moment of the forecast until half of its members exceed it; null when fewer do.
    """
    earliest_s: float | None
    """
    Seconds until 2.5 % of its members exceed it; null when fewer do.
    """


class DriftMove(BaseModel):
    """
    By how much a quantity moved, were its group the one that did; 0.1 is +10 %.
    """

    quantity: str
    text: str
    change: float
    low: float
    high: float


class DriftQuantity(BaseModel):
    """
    A physical quantity of a version with its 95 % interval.
    """

    text: str
    group: str | None
    """
    Parameters that make it up; null: all of them.
    """
    unit: str
    value: float
    low: float
    high: float


class DriftReference(BaseModel):
    """
    The operating point at which quantities are stated.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    Radial load, N.
    """
    temperature_c: float
    """
    Of the bearing, °C.
    """


class FieldError(BaseModel):
    """
    One thing that is wrong: where, and what was expected.
    """

    pointer: str | None = None
    """
    JSON pointer into the body.
    """
    parameter: str | None = None
    """
    Name of the query, path or header parameter.
    """
    detail: str


class ForecastStep(BaseModel):
    """
    A span of constant operation that a forecast follows.
    """

    duration_s: float
    """
    Seconds.
    """
    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    Radial load, N.
    """
    ambient_c: float
    """
    Ambient temperature, °C.
    """


class GateDocument(BaseModel):
    """
    One check of a candidate.
    """

    name: str
    passed: bool
    detail: str
    values: dict[str, float | bool | dict[str, float | None] | None]
    """
    What the check compared, by name.
    """


class HealthOfAsset(BaseModel):
    """
    Whether the twin runs, and which channels have no good data.
    """

    status: Literal["good", "degraded"]
    twin_running: bool
    channels_without_good_data: list[str]


class IdentifiabilityDocument(BaseModel):
    """
    What the data inform: rank and condition of the sensitivities, and combinations.
    """

    rank: int
    condition: float | None
    informed: int
    """
    Number of combinations that the data inform.
    """
    weak: int
    prior_only: int
    combinations: list[Combination] | None = None
    """
    Of a single version only.
    """


class IdentificationSettings(BaseModel):
    """
    What is done with new data.
    """

    ladder: Literal["observe", "suggest", "apply"]
    """
    `suggest` identifies automatically; `apply` activates what passes the gates.
    """


class Interval(BaseModel):
    """
    A value with its 95 % interval.
    """

    value: float
    low: float | None
    """
    2.5 %
    """
    high: float | None
    """
    97.5 %
    """


class JobWindow(BaseModel):
    """
    A span of process time that a job identifies from, start inclusive and end exclusive.
    """

    start: AwareDatetime
    end: AwareDatetime


class LawDocument(BaseModel):
    """
    Where one law of a version comes from, and what speaks for it.
    """

    source: Literal["own", "family", "literature"]
    """
    Own: the machine's data decide it; else the more probable prior.
    """
    weight_family: float
    """
    Probability that the family's law is this machine's.
    """
    log_bayes_factor: float | None
    """
    Natural logarithm of how much more probable the family's law makes the machine's own data than the literature's; null where no family was asked.
    """
    tested: bool
    """
    Whether the machine's own data say anything about the law.
    """
    settled_by: str | None
    """
    What would test it; null where it is tested.
    """


class Limit(BaseModel):
    """
    One limit of one temperature.
    """

    channel: str
    level: Literal["warning", "alarm"]
    value_c: float
    """
    The limit itself, °C.
    """


class LimitMap(BaseModel):
    """
    When and how probably a limit is reached, each point held from the present state.
    """

    limit_c: float
    """
    °C
    """
    probability: list[list[float | None]]
    """
    Share of the members that reach it within the horizon.
    """
    steady_probability: list[list[float | None]]
    """
    Probability that the steady state is at or over it, smooth over the map.
    """
    median_s: list[list[float | None]]
    """
    Seconds until half of the members have reached it; null where fewer do.
    """
    earliest_s: list[list[float | None]]
    """
    Seconds until 2.5 % of the members have reached it; null where fewer do.
    """


class Limits(BaseModel):
    """
    Limits of one temperature, °C.
    """

    warning: float
    alarm: float


class LowRisk(BaseModel):
    """
    The region whose data may be used for identification.
    """

    speed_rpm_max: float
    """
    rpm
    """
    load_n_max: float
    """
    Radial load, N.
    """


class ModelWindow(BaseModel):
    """
    A span of process time that a version was identified from.
    """

    start: AwareDatetime
    end: AwareDatetime
    speed_rpm_max: float | None = None
    """
    Highest speed, rpm.
    """
    load_n_max: float | None = None
    """
    Highest radial load, N.
    """


class NextStep(BaseModel):
    """
    What to do next for a forecast that is narrow enough, in words and as a step of the list.
    """

    text: str
    asked_half_width_k: float | None = None
    """
    What was asked, K; null where nothing was.
    """
    reached: bool
    """
    Whether the forecast is as narrow as was asked, so that no step is needed.
    """
    rank: int | None = None
    """
    Of the step in `steps`: the best of at most 20 min, a longer one where none of these is worth while; null where none is needed or none is worth while.
    """


class NodeState(BaseModel):
    """
    Estimate of one node's temperature.
    """

    mean_c: float | None
    """
    °C
    """
    std_c: float | None
    """
    Standard deviation, K.
    """
    known: bool
    """
    Whether half the 95 % interval is within 3.5 K (more with wide `[errors]`); else it is not known, and not to be shown as a temperature.
    """
    reason: str | None
    """
    Why the node is not known; null where it is.
    """


class ParameterDocument(BaseModel):
    """
    One parameter of the model.
    """

    value: float
    low: float | None
    """
    2.5 %
    """
    high: float | None
    """
    97.5 %
    """
    unit: str
    """
    `-` for a number without a unit.
    """
    verdict: Literal["informed", "weak", "prior only"]
    """
    Whether the data say more of it than the prior.
    """
    at_bound: Literal["lower", "upper"] | None = None
    """
    Whether the value lies on a bound of its range.
    """
    informed_share: float | None = None
    """
    Part of the prior's variance that the data take away, 0 to 1.
    """
    description: str | None = None


class Peak(BaseModel):
    """
    The highest value while the condition was there.
    """

    value: float
    time: AwareDatetime


class PredictionScore(BaseModel):
    """
    Errors at a point of the data that a fit without it predicts, rms in K.
    """

    speed_rpm: float
    """
    Speed of the point, rpm.
    """
    load_n: float
    """
    Radial load of the point, N.
    """
    nested_rms_k: float | None
    """
    Of a fit to the other data.
    """
    active_rms_k: float | None
    """
    Of the version that was active then.
    """
    candidate_rms_k: float | None
    """
    Of this version, which has seen the point.
    """
    active_has_seen_it: bool
    """
    Whether the active version was identified from this point, too.
    """


class PresentPoint(BaseModel):
    """
    Where the machine is now, and what is measured there.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    N
    """
    measured_c: dict[str, float | None]
    """
    Good and fresh readings by sensor, °C; `labels` say where the map is low.
    """
    over_limit: dict[str, dict[str, float | None]]
    """
    Probability that the sensor is at or over each limit here: 1 where it is measured so now, whatever the map shows; else `steady_probability` of the nearest point.
    """


class ProfileStep(BaseModel):
    """
    So long at this speed, radial load and, if given, ambient temperature.
    """

    model_config = ConfigDict(
        extra="forbid",
    )
    duration_s: float
    """
    Length of the step in seconds.
    """
    speed_rpm: float
    """
    Speed in revolutions per minute.
    """
    load_n: float
    """
    Radial load in newtons.
    """
    ambient_c: float | None = None
    """
    Ambient temperature in degrees Celsius; absent: as it is now.
    """


class Quantiles(BaseModel):
    """
    Quantiles of a temperature over time: of the measured value for sensors, else of the true.
    """

    q025: list[float | None]
    """
    One temperature per time, °C.
    """
    q25: list[float | None]
    """
    One temperature per time, °C.
    """
    q50: list[float | None]
    """
    One temperature per time, °C.
    """
    q75: list[float | None]
    """
    One temperature per time, °C.
    """
    q975: list[float | None]
    """
    One temperature per time, °C.
    """


class ReceivedSampleItem(BaseModel):
    """
    One raw sample, and when the service received it.
    """

    channel: str
    time: AwareDatetime
    value: float | None
    """
    In the channel's unit; null when the quality is bad.
    """
    quality: int
    """
    OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.
    """
    received: AwareDatetime | None
    """
    Process time at which the service received it; null when an earlier version stored it.
    """


class RunawayMap(BaseModel):
    """
    Thermal runaway: beyond the limit (130 °C of a bearing), or without a steady state.
    """

    probability: list[list[float | None]]
    """
    That the machine runs away, held at the point: of the default model from how much hotter the inner ring gets than the outer one, which takes up clearance; else, and before any identification, the share of the members that run away.
    """
    not_excluded: list[list[bool]]
    """
    True where the probability is above 5 %, the upper edge passes 110 °C, or the load is beyond 2.1 times what the data hold; of other models 100 °C, 1.5 times, or one member that runs away.
    """
    loop_gain: list[list[float | None]]
    """
    Heat that a rise gives back over heat that it carries away, median of the members; a machine runs away above 1. Null where half of the members run away.
    """
    loop_gain_upper: list[list[float | None]]
    """
    The same, 97.5 % of the members; null where so many run away.
    """
    margin_k: list[list[float | None]]
    """
    How much hotter the hottest sensor may become until the loop gain is 1 or the limit (130 °C of a bearing) is passed: 95 % of the members have more, K. Null where there is no limit.
    """
    margin_n: list[list[float | None]]
    """
    How much more load until the probability is 5 %, N; negative where it is more already. Null where no load of the map is as bad.
    """


class RunawayMargin(BaseModel):
    """
    How far the machine is from a thermal runaway, held for hours at this point.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    N
    """
    probability: float
    """
    That it runs away, held here for 8 h.
    """
    loop_gain: float | None
    """
    Heat that a rise gives back over heat that it carries away, median of the members; a machine runs away above 1. Null where half of the members run away.
    """
    loop_gain_upper: float | None
    """
    The same, 97.5 % of the members; null where so many run away.
    """
    margin_k: float | None
    """
    How much hotter the hottest sensor may become until the loop gain is 1 or the limit (130 °C of a bearing) is passed, K; null where there is no limit.
    """
    margin_n: float | None
    """
    How much more load until the probability is 5 %, N; negative where it is more already. Null where twice the load is not as bad.
    """


class SampleItem(BaseModel):
    """
    One raw sample.

    A typed dictionary and no model: an answer holds thousands of them.
    """

    channel: str
    time: AwareDatetime
    value: float | None
    """
    In the channel's unit; null when the quality is bad.
    """
    quality: int
    """
    OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.
    """


class Scores(BaseModel):
    """
    Errors in the training data, and one member for each prediction test, by its name.
    """

    model_config = ConfigDict(
        extra="allow",
    )
    __annotations__ = {
        "__pydantic_extra__": Dict[str, PredictionScore],
    }
    train_rms_k: dict[str, float | None] | None = None
    """
    Rms in K by sensor; left out before the first identification.
    """


class SistersDocument(BaseModel):
    """
    What machines of the asset's family have given to a version.
    """

    used: int
    """
    Number of sisters that the prior was made of.
    """
    names: list[str]
    """
    Their assets.
    """
    loads_n: list[float]
    """
    Heaviest load that each has seen, N; in their order.
    """
    speeds_rpm: list[float]
    """
    Highest speed that each has seen, rpm.
    """
    load_n_max: float
    """
    Heaviest load that any of them has seen, N.
    """
    speed_rpm_max: float
    """
    Highest speed that any of them has seen, rpm.
    """
    accepted: bool
    """
    Whether any law of the version rests on them; if not, on its own data alone.
    """
    reason: str
    """
    Why, or why not.
    """
    evidence_gain: float | None
    """
    Natural logarithm of how much more probable they make the machine's own data.
    """
    membership: Annotated[float | None, Field(deprecated=True)] = None
    """
    Deprecated: of versions before each law was trusted separately, the share of the family's members whose own data would be further off; null since, see `laws`.
    """
    set_aside: dict[str, str]
    """
    Assets that were not used, with the reason.
    """
    calibrated_runs: int
    """
    Number of sisters that calibrate the band.
    """
    without_them: dict[str, Interval]
    """
    The parameters without sisters; empty where the version rests on its own data.
    """


class State(BaseModel):
    """
    The node temperatures as the twin sees them now.
    """

    time: AwareDatetime
    model_version: int
    revolutions: float
    """
    Of the shaft since the grease was renewed.
    """
    nodes: dict[str, NodeState]
    missing: list[str]
    """
    Speed, load and ambient without a usable value now; with any of them the estimate is uncertain.
    """


class Steady(BaseModel):
    """
    When a reading counts as steady.
    """

    change_k: float
    """
    It changes by no more, K.
    """
    within_s: float
    """
    In this time, s.
    """


class SteadyMap(BaseModel):
    """
    Quantiles of what the sensor will read in the steady state, °C; 500 where it runs away.
    """

    q025: list[list[float | None]]
    """
    One row per load, one column per speed.
    """
    q50: list[list[float | None]]
    """
    One row per load, one column per speed.
    """
    q975: list[list[float | None]]
    """
    One row per load, one column per speed.
    """


class StepLevel(BaseModel):
    """
    A span at constant speed and load.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    N
    """
    duration_s: float
    """
    Seconds.
    """


class StopRule(BaseModel):
    """
    How to approach the target, and when to stop.
    """

    rules: list[str]
    largest_ratio: float
    """
    Of one level to the next.
    """
    hold_at_least_s: float
    """
    Seconds.
    """
    steady: Steady
    levels: list[ApproachLevel]


class Tag(BaseModel):
    """
    One value for a SCADA system; null when the quality is bad.
    """

    value: float | None
    unit: str
    """
    Empty for a number without one.
    """
    quality: int
    """
    OPC DA byte: below 64 bad, 64 to 191 uncertain, 192 and above good.
    """
    time: AwareDatetime
    """
    Of the value, process time.
    """


class TargetSensor(BaseModel):
    """
    The present forecast of a sensor at the end of the target, °C; half-width in K.
    """

    q025: float
    q50: float
    q975: float
    half_width_k: float


class TimeToLimit(BaseModel):
    """
    The limit that is exceeded first along all that is planned.

    Of a channel that is over its warning already it is the alarm limit.
    """

    limit: Limit
    expected: bool
    """
    Whether the probability is above that of the verdict safe.
    """
    probability: float
    """
    That it is exceeded.
    """
    earliest_s: float | None
    """
    Seconds from now, 2.5 % of the forecasts.
    """
    median_s: float | None
    """
    Seconds from now, half of the forecasts.
    """
    horizon_s: float
    """
    How far the forecast looks, seconds from now.
    """


class TimeWindow(BaseModel):
    """
    A span of process time, start inclusive and end exclusive.
    """

    model_config = ConfigDict(
        extra="forbid",
    )
    start: AwareDatetime
    end: AwareDatetime


class VerdictOf(BaseModel):
    """
    One word with what stands behind it.
    """

    word: Literal["safe", "not safe", "recovering", "unknown"]
    reasons: list[str]
    limit: Limit | None
    """
    The limit that decides.
    """
    probability: float | None
    """
    That this limit is exceeded; 1 when it is exceeded already.
    """
    seconds_to_limit: float | None
    """
    Process seconds until it is exceeded at the earliest (2.5 % of the forecasts); null when fewer exceed it.
    """
    alarm_probability: float | None
    """
    That the alarm limit of the same channel is exceeded.
    """


class VerdictOfPresentStep(BaseModel):
    """
    The verdict on the step in hand, and when that step ends.
    """

    word: Literal["safe", "not safe", "recovering", "unknown"]
    reasons: list[str]
    limit: Limit | None
    """
    The limit that decides.
    """
    probability: float | None
    """
    That this limit is exceeded; 1 when it is exceeded already.
    """
    seconds_to_limit: float | None
    """
    Process seconds until it is exceeded at the earliest (2.5 % of the forecasts); null when fewer exceed it.
    """
    alarm_probability: float | None
    """
    That the alarm limit of the same channel is exceeded.
    """
    ends_at: AwareDatetime | None
    """
    When the step ends by the plan; null where nothing is planned.
    """


class VerdictSettings(BaseModel):
    """
    When the next step is called safe.
    """

    safe_below_probability: float
    """
    Of exceeding a warning limit.
    """


class WholeRun(BaseModel):
    """
    Bands that a whole run stays inside, beside those of each moment (`nodes`).
    """

    level: float
    """
    Probability that all readings at `time_s`, from the first to the last, lie inside the band of a sensor.
    """
    factors: dict[str, list[float | None]]
    """
    By sensor that was asked for, at `time_s`: the band reaches from q50 - factor * (q50 - q025) to q50 + factor * (q975 - q50).
    """


class WindowDocument(BaseModel):
    """
    A low-risk window with its operating points and score.
    """

    start: AwareDatetime
    end: AwareDatetime
    speed_rpm_max: float
    """
    Highest speed, rpm.
    """
    load_n_max: float
    """
    Highest radial load, N.
    """
    operating_points: list[StepLevel]
    """
    Spans at constant speed and load.
    """
    score: float
    """
    How much the window varies speed and load, 0 to 1.
    """


class WindowList(BaseModel):
    """
    Low-risk windows found in the store.
    """

    next: str | None
    """
    Cursor of the next page; null on the last one.
    """
    items: list[WindowDocument]


class AdvisedStep(BaseModel):
    """
    A feasible step inside the low-risk region.
    """

    rank: int
    levels: list[StepLevel]
    duration_s: float
    half_width_k: dict[str, float]
    """
    Half the 95 % interval at the target, expected after the step, K.
    """
    cautious_half_width_k: dict[str, float]
    """
    The same if the machine's friction shifts by some per cent between stages.
    """
    runaway_probability: float | None = None
    """
    Of a runaway at the target, cautiously expected after the step if the machine is what it is taken for; null where the probability was not tested.
    """
    narrower_by: float
    """
    Fraction by which the deciding sensor's interval narrows, cautiously.
    """
    peak_c: dict[str, float]
    """
    Highest upper edge during the step, °C.
    """
    why: str


class AlarmDocument(BaseModel):
    """
    One alarm; states after ISA-18.2.
    """

    id: str
    asset: str | None
    """
    Null where it is about several: see `assets`.
    """
    assets: list[str]
    """
    All that have it now; of one that has returned all that had it.
    """
    cause: AlarmCause
    action: None
    """
    What would clear a predicted alarm; not computed yet.
    """
    kind: str
    channel: str
    """
    Empty for an alarm of the asset as a whole.
    """
    limit_level: str | None
    """
    Which limit: `warning` or `alarm`; null where there is none.
    """
    priority: int
    """
    1 high, 2 medium, 3 low.
    """
    state: Literal["NORM", "UNACK", "ACKED", "RTNUN", "LATCH", "SHLVD", "DSUPR", "OOSRV"]
    """
    States with the standard's mnemonics, and one for latched alarms.
    """
    active: bool
    """
    Whether the condition is there, whatever the state.
    """
    message: str
    raised_at: AwareDatetime | None
    """
    Null for an alarm that was suppressed before it was raised.
    """
    since: AwareDatetime
    """
    When the present state began.
    """
    returned_at: AwareDatetime | None
    """
    When the condition was last gone.
    """
    acknowledged_at: AwareDatetime | None
    acknowledged_by: str | None
    shelved_until: AwareDatetime | None
    shelved_by: str | None
    suppressed_reason: str | None
    """
    Reason of the suppression, in state DSUPR.
    """
    latched: bool
    """
    It stays after its return to normal until it is reset.
    """
    comment: str | None
    """
    The latest one.
    """
    value: float | None
    """
    Last value that was compared, in `unit`.
    """
    limit_value: float | None
    """
    What it is compared with, in `unit`.
    """
    unit: str | None
    """
    Null where nothing is compared.
    """
    peak: Peak | None
    """
    Of this alarm's life, in its `unit`; null where nothing is compared.
    """
    duration_s: float | None
    """
    Process seconds from raise to return; null until it has returned.
    """
    predicted: bool
    """
    Not measured, but forecast.
    """
    lead_time_s: float | None
    """
    Process seconds until the limit is exceeded at the earliest (2.5 % of the forecasts), as `seconds_to_limit` of a verdict.
    """
    probability: float | None
    """
    That the limit is exceeded; of a forecast only.
    """


class AlarmList(BaseModel):
    """
    Alarms, most urgent first.
    """

    next: str | None
    """
    Cursor of the next page; null on the last one.
    """
    items: list[AlarmDocument]


class Controller(BaseModel):
    """
    What the controller of the bench reports; null where no channel is configured.
    """

    phase: float | None
    """
    Of its program.
    """
    speed_setpoint_rpm: float | None
    """
    rpm
    """
    load_setpoint_n: float | None
    """
    Radial load, N.
    """
    plan: list[ForecastStep] | None
    """
    What is left of its plan; null before the first plan was read.
    """


class DriftComparison(BaseModel):
    """
    Comparison with the earlier version whose operation was most similar.
    """

    version: int
    shared: float
    """
    Part of its data that both share.
    """
    alike: str
    """
    How similar the operation of both is.
    """
    statistic: float
    """
    Squared distance of both, in standard deviations.
    """
    dimensions: int
    probability: float
    """
    Probability of such a difference without any change.
    """
    groups: dict[str, float]
    """
    Probability of each to be what changed.
    """
    moves: list[DriftMove]


class DriftDocument(BaseModel):
    """
    Comparison of a version with earlier ones.
    """

    changed: bool | None
    """
    Null where nothing could be compared.
    """
    text: str
    point: DriftReference | None
    """
    Where the quantities are stated.
    """
    quantities: dict[str, DriftQuantity]
    comparison: DriftComparison | None
    sums: dict[str, float | None]
    """
    Cumulative sums of the quantities; 5 reports.
    """
    creeping: list[str]
    """
    Quantities whose sum reports a slow change.
    """


class ExcludedStep(BaseModel):
    """
    A step that must not be run, and why.
    """

    levels: list[StepLevel]
    reason: str


class ForecastRequest(BaseModel):
    """
    A what-if: the profile to be forecast from the present state of the twin.
    """

    model_config = ConfigDict(
        extra="forbid",
    )
    profile: list[ProfileStep]
    """
    The steps in order, together at most 48 h.
    """
    step_s: float | None = None
    """
    Spacing of the answer in seconds, at most 3000 rows.
    """
    nodes: list[str] | None = None
    """
    Sensors and nodes to be answered; absent: all.
    """
    keep: bool | None = None
    """
    Keep it, and hold it against what comes if the machine does this from now on.
    """


class GatesDocument(BaseModel):
    """
    Whether a candidate may become the active version, and why.
    """

    accepted: bool
    reason: str
    checks: list[GateDocument]
    scores: Scores
    naive: dict[str, dict[str, dict[str, float | None]]]


class IdentificationRequest(BaseModel):
    """
    What to identify from, and how.
    """

    model_config = ConfigDict(
        extra="forbid",
    )
    windows: Literal["auto"] | list[TimeWindow] | None = None
    """
    `auto` takes the low-risk windows of the store, else these windows.
    """
    method: Literal["noa+refine", "refine", "noa"] | None = None
    seed: int | None = None
    """
    Seed of the search.
    """
    budget: int | None = None
    """
    Most evaluations; absent: the method's own.
    """


class JobDocument(BaseModel):
    """
    One identification job.
    """

    id: str
    status: Literal["queued", "running", "succeeded", "failed", "cancelled"]
    progress: float
    best_fitness: float | None
    """
    Smallest sum of squared residuals so far.
    """
    evaluations: int
    """
    Simulations of the data so far.
    """
    created_at: AwareDatetime
    started_at: AwareDatetime | None
    ended_at: AwareDatetime | None
    error: str | None
    """
    Why it failed or was cancelled.
    """
    model_version: int | None
    """
    That came of it.
    """
    windows: list[JobWindow]
    method: Literal["noa+refine", "refine", "noa"]
    seed: int
    """
    Of the search.
    """
    budget: int | None
    """
    Most evaluations; null: the method's own.
    """
    requested_by: str
    """
    Role, prefix and label of the key, or `automatic`.
    """
    attempts: int
    """
    How often a worker began it.
    """
    phase: str | None
    """
    Of a running job: search, refinement, sampling or gates.
    """
    seconds_left: float | None
    """
    Wall seconds that a running job still takes; null while not known.
    """
    active_fitness: float | None
    """
    Best fitness to beat: of the active version on the same data.
    """
    convergence: list[list[float]] | None = None
    """
    How the best fitness fell; of a single job only.
    """


class LiveForecast(BaseModel):
    """
    The latest live forecast: of the controller's plan, else of the present point held.
    """

    time_s: list[float]
    """
    Seconds from the present moment.
    """
    nodes: dict[str, Quantiles]
    """
    By sensor and node.
    """
    whole_run: WholeRun
    limits: dict[str, Limits]
    not_known: dict[str, str]
    """
    Nodes without a sensor whose temperature the model does not know well enough, and why: by node. Their quantiles are no forecast to act on.
    """
    time_to_limit: dict[str, dict[str, Crossing]]
    """
    By sensor and level.
    """
    labels: list[str]
    """
    What the result rests on.
    """
    runaway_probability: float
    """
    That the machine runs away thermally; see `runaway` of the envelope.
    """
    runaway_margin: RunawayMargin | None = None
    """
    The margin at the heaviest point of the profile (speed times load). Null before the first identification, for a network without limits of a runaway, and where nothing but standing or no load lies ahead.
    """
    model_version: int
    profile: list[ForecastStep]
    """
    What the forecast follows.
    """
    missing: list[str]
    """
    Speed, load and ambient without a usable value now; with any of them the forecast starts from an uncertain state.
    """
    made_at: AwareDatetime
    """
    Process time of the state that it begins from.
    """
    intervals_made_at: AwareDatetime
    """
    Process time of the state that the widths of the intervals are of. Earlier than `made_at`, by 15 minutes at most, where the machine goes on at its operating point far from its limits; the medians are always of `made_at`.
    """
    planned: bool
    """
    Whether it follows the controller's plan.
    """


class Measurements(BaseModel):
    """
    History with quality, ascending by time, then by channel.
    """

    next: str | None
    """
    Cursor of the next page; null on the last one.
    """
    resolution: str
    """
    What `items` are: raw samples, or buckets of this length.
    """
    items: list[SampleItem] | list[ReceivedSampleItem] | list[BucketItem]


class ModelDocument(BaseModel):
    """
    One model version with its parameters, the data it comes from and its scores.
    """

    version: int
    status: Literal["candidate", "active", "retired", "rejected"]
    reason: str | None
    created_at: AwareDatetime
    model: str
    """
    Name of the thermal network.
    """
    parameters: dict[str, ParameterDocument]
    windows: list[ModelWindow]
    scores: Scores
    naive: dict[str, dict[str, dict[str, float | None]]]
    """
    Rms in K of naive forecasts in the same tests, by test, kind and sensor.
    """
    gates: GatesDocument | None
    """
    Null before the first identification.
    """
    job: str | None
    """
    The job that it comes from; null for the priors.
    """
    identifiability: IdentifiabilityDocument | None
    """
    Null for versions of older releases.
    """
    paper_view: dict[str, Interval] | None
    """
    The paper's 15 numbers, of the model paper-reduced only.
    """
    drift: DriftDocument | None
    """
    Comparison with earlier versions; see `GET …/drift`. Null: none made.
    """
    sisters: SistersDocument | None
    """
    Null where the family has taught nothing yet, or the asset has none.
    """
    laws: dict[str, LawDocument]
    """
    Where each law comes from: how friction grows with load, with speed and temperature, how it falls from fresh grease on, housing and films. Empty before the first identification and for versions of older releases.
    """
    method: Literal["noa+refine", "refine", "noa"] | None
    """
    Of the identification; null for the priors.
    """
    seed: int | None


class ModelList(BaseModel):
    """
    Model versions, newest first.
    """

    next: str | None
    """
    Cursor of the next page; null on the last one.
    """
    items: list[ModelDocument]


class ProblemDocument(BaseModel):
    """
    An error as RFC 9457 has it.
    """

    type: str | None = None
    title: str
    status: int
    detail: str
    instance: str
    errors: list[FieldError] | None = None
    job: JobDocument | None = None
    """
    The job in the way, of a conflict with one (409).
    """


class SensorMaps(BaseModel):
    """
    Maps of one sensor; `limits` holds `warning` and `alarm`, or nothing if it has none.
    """

    steady_c: SteadyMap
    limits: dict[str, LimitMap]


class Snapshot(BaseModel):
    """
    Flat tags: measured, estimated (`.twin`), forecast maxima, times to limit, alarm counts.
    """

    tags: dict[str, Tag]


class Target(BaseModel):
    """
    The point asked for, as it is forecast now.
    """

    speed_rpm: float
    """
    rpm
    """
    load_n: float
    """
    N
    """
    duration_s: float
    """
    Seconds.
    """
    inside_low_risk: bool
    sensor: str
    """
    The sensor with the widest interval; of intervals, this one's counts.
    """
    sensors: dict[str, TargetSensor]
    labels: list[str]
    runaway_margin: RunawayMargin | None = None
    """
    Held at the target for hours, as it is forecast now.
    """


class VerdictDocument(BaseModel):
    """
    Whether the machine is safe now, to the end of its present step, and in its next step.
    """

    now: VerdictOf
    present_step: VerdictOfPresentStep
    """
    Of what is left of the present planned step; with none planned, of the present point, held to the end of the forecast. A step that was called `not safe` stays so until it has ended or was changed.
    """
    next_step: VerdictOf
    """
    Of the next planned step; with none planned, of the present one to its end.
    """
    time_to_limit: TimeToLimit | None
    """
    Null while an input of `next_step` is missing.
    """
    missing: list[str]
    """
    Inputs that are not there: channels, `twin` (it does not run), `limits`, `identified model`, `forecast`.
    """
    time: AwareDatetime


class WhatIfAnswer(BaseModel):
    """
    A what-if, and whether it was kept.
    """

    time_s: list[float]
    """
    Seconds from the present moment.
    """
    nodes: dict[str, Quantiles]
    """
    By sensor and node.
    """
    whole_run: WholeRun
    limits: dict[str, Limits]
    not_known: dict[str, str]
    """
    Nodes without a sensor whose temperature the model does not know well enough, and why: by node. Their quantiles are no forecast to act on.
    """
    time_to_limit: dict[str, dict[str, Crossing]]
    """
    By sensor and level.
    """
    labels: list[str]
    """
    What the result rests on.
    """
    runaway_probability: float
    """
    That the machine runs away thermally; see `runaway` of the envelope.
    """
    runaway_margin: RunawayMargin | None = None
    """
    The margin at the heaviest point of the profile (speed times load). Null before the first identification, for a network without limits of a runaway, and where nothing but standing or no load lies ahead.
    """
    model_version: int
    profile: list[ForecastStep]
    """
    What the forecast follows.
    """
    missing: list[str]
    """
    Speed, load and ambient without a usable value now; with any of them the forecast starts from an uncertain state.
    """
    kept_at: AwareDatetime | None
    """
    Process time of the state that it begins from, where it is kept; else null.
    """


class AdviceDocument(BaseModel):
    """
    Which low-risk step to run next, which not, and how to approach the target itself.
    """

    made_at: AwareDatetime
    model_version: int
    target: Target
    worth_while: bool
    """
    Whether the best step narrows the interval by a tenth or more.
    """
    ranked_by: Literal["runaway", "interval"] | None = None
    """
    Where a runaway at the target is not excluded, steps are ranked by its probability after them, and those with like odds by the cautious interval; else by the cautious interval alone. Steps that reach the asked half-width are alike but for how long they take.
    """
    next_step: NextStep
    steps: list[AdvisedStep]
    excluded: list[ExcludedStep]
    stop_rule: StopRule


class AssetDocument(BaseModel):
    """
    Configuration, health and active model of an asset.
    """

    id: str
    name: str
    """
    Name on the pages.
    """
    group: str | None
    """
    Null without one.
    """
    family: str | None
    """
    Machines of one type; null without one.
    """
    bearing: str | None
    """
    Null for a machine with a custom network.
    """
    network: str
    clock_rate: float
    """
    Process seconds per wall second; 1 on a real machine.
    """
    low_risk: LowRisk
    limits: dict[str, Limits]
    """
    By sensor or node.
    """
    channels: list[ChannelDocument]
    alarms: AlarmSummary
    ambient_assumed_c: float | None
    """
    Assumed ambient temperature where no channel measures it, °C.
    """
    verdict: VerdictSettings
    health: HealthOfAsset
    active_model: ActiveModel
    identification: IdentificationSettings
    controller: Controller | None


class AssetList(BaseModel):
    """
    All assets of the service.
    """

    next: str | None
    """
    Cursor of the next page; null on the last one.
    """
    items: list[AssetDocument]


class EnvelopeDocument(BaseModel):
    """
    Steady temperatures and times to the limits over speed and load.
    """

    made_at: AwareDatetime
    model_version: int
    ambient_c: float
    """
    Assumed to stay, °C.
    """
    horizon_s: float
    """
    How long each point is held for the times, s.
    """
    members: int
    """
    Of the ensemble.
    """
    speed_rpm: list[float]
    """
    Columns of all maps.
    """
    load_n: list[float]
    """
    Rows of all maps.
    """
    sensors: dict[str, SensorMaps]
    runaway: RunawayMap
    low_risk: LowRisk
    labels: list[str]
    """
    What the result rests on.
    """
    present: PresentPoint