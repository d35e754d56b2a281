"""Model versions: parameters, what the data inform, scores and gates."""

from typing import Literal

from pydantic import ConfigDict, Field

from service.clock import rfc3339
from service.documents.base import Document, Number, Page, StoredDocument, Time, is_none
from service.store.records import Activation, ModelVersion

Verdict = Literal["informed", "weak", "prior only"]
ModelStatus = Literal["candidate", "active", "retired", "rejected"]


class Interval(StoredDocument):
    """A value with its 95 % interval."""

    value: float
    low: Number = Field(description="2.5 %")
    high: Number = Field(description="97.5 %")


class ParameterDocument(Interval):
    """One parameter of the model."""

    unit: str = Field(description="`-` for a number without a unit.", examples=["W/K"])
    verdict: Verdict = Field(description="Whether the data say more of it than the prior.")
    at_bound: Literal["lower", "upper"] | None = Field(
        None, description="Whether the value lies on a bound of its range."
    )
    informed_share: Number = Field(
        None, description="Part of the prior's variance that the data take away, 0 to 1."
    )
    description: str = Field("", examples=["viscous friction: exponent of speed"])


class Combination(StoredDocument):
    """A combination of parameters, in standard coordinates of the prior."""

    combination: str = Field(examples=["0.78 M0 - 0.35 gs + 0.29 q"])
    weights: dict[str, float] = Field(description="By parameter; those below 0.05 are left out.")
    strength: float = Field(description="Singular value of the sensitivities.")
    std_over_prior: float = Field(description="Standard deviation over that of the prior, 0 to 1.")
    verdict: Verdict


class IdentifiabilityDocument(StoredDocument):
    """What the data inform: rank and condition of the sensitivities, and combinations."""

    rank: int
    condition: Number
    informed: int = Field(description="Number of combinations that the data inform.")
    weak: int
    prior_only: int
    combinations: list[Combination] | None = Field(
        None, exclude_if=is_none, description="Of a single version only."
    )


class ModelWindow(StoredDocument):
    """A span of process time that a version was identified from."""

    start: Time
    end: Time
    speed_rpm_max: Number = Field(None, description="Highest speed, rpm.")
    load_n_max: Number = Field(None, description="Highest radial load, N.")


class PredictionScore(StoredDocument):
    """Errors at a point of the data that a fit without it predicts, rms in K."""

    speed_rpm: float = Field(description="Speed of the point, rpm.")
    load_n: float = Field(description="Radial load of the point, N.")
    nested_rms_k: Number = Field(description="Of a fit to the other data.")
    active_rms_k: Number = Field(description="Of the version that was active then.")
    candidate_rms_k: Number = Field(description="Of this version, which has seen the point.")
    active_has_seen_it: bool = Field(
        description="Whether the active version was identified from this point, too."
    )


class Scores(Document):
    """Errors in the training data, and one member for each prediction test, by its name."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, PredictionScore]
    train_rms_k: dict[str, Number] | None = Field(
        None,
        exclude_if=is_none,
        description="Rms in K by sensor; left out before the first identification.",
    )


GateValue = float | bool | None | dict[str, float | None]


class GateDocument(StoredDocument):
    """One check of a candidate."""

    name: str = Field(examples=["fit"])
    passed: bool
    detail: str
    values: dict[str, GateValue] = Field(description="What the check compared, by name.")


NaiveScores = dict[str, dict[str, dict[str, Number]]]


class GatesDocument(StoredDocument):
    """Whether a candidate may become the active version, and why."""

    accepted: bool
    reason: str
    checks: list[GateDocument]
    scores: Scores
    naive: NaiveScores


class LawDocument(StoredDocument):
    """Where one law of a version comes from, and what speaks for it."""

    source: Literal["own", "family", "literature"] = Field(
        description="Own: the machine's data decide it; else the more probable prior."
    )
    weight_family: float = Field(
        ge=0, le=1, description="Probability that the family's law is this machine's."
    )
    log_bayes_factor: Number = Field(
        description="Natural logarithm of how much more probable the family's law makes the "
        "machine's own data than the literature's; null where no family was asked."
    )
    tested: bool = Field(description="Whether the machine's own data say anything about the law.")
    settled_by: str | None = Field(
        description="What would test it; null where it is tested.", examples=["20 min at 3300 N"]
    )


Laws = dict[Literal["load", "speed", "start", "housing"], LawDocument]


class SistersDocument(StoredDocument):
    """What machines of the asset's family have given to a version."""

    used: int = Field(ge=0, description="Number of sisters that the prior was made of.")
    names: list[str] = Field(description="Their assets.")
    loads_n: list[float] = Field(description="Heaviest load that each has seen, N; in their order.")
    speeds_rpm: list[float] = Field(description="Highest speed that each has seen, rpm.")
    load_n_max: float = Field(description="Heaviest load that any of them has seen, N.")
    speed_rpm_max: float = Field(description="Highest speed that any of them has seen, rpm.")
    accepted: bool = Field(
        description="Whether any law of the version rests on them; if not, on its own data alone."
    )
    reason: str = Field(description="Why, or why not.")
    evidence_gain: Number = Field(
        description="Natural logarithm of how much more probable they make the machine's own data."
    )
    membership: Number = Field(
        None,
        description="Deprecated: of versions before each law was trusted separately, the share of "
        "the family's members whose own data would be further off; null since, see `laws`.",
        json_schema_extra={"deprecated": True},
    )
    set_aside: dict[str, str] = Field(description="Assets that were not used, with the reason.")
    calibrated_runs: int = Field(ge=0, description="Number of sisters that calibrate the band.")
    without_them: dict[str, Interval] = Field(
        description="The parameters without sisters; empty where the version rests on its own data."
    )


class DriftQuantity(StoredDocument):
    """A physical quantity of a version with its 95 % interval."""

    text: str
    group: str | None = Field(description="Parameters that make it up; null: all of them.")
    unit: str
    value: float
    low: float
    high: float


class DriftMove(StoredDocument):
    """By how much a quantity moved, were its group the one that did; 0.1 is +10 %."""

    quantity: str
    text: str
    change: float
    low: float
    high: float


class DriftComparison(StoredDocument):
    """Comparison with the earlier version whose operation was most similar."""

    version: int = Field(ge=1)
    shared: float = Field(ge=0, le=1, description="Part of its data that both share.")
    alike: str = Field(description="How similar the operation of both is.")
    statistic: float = Field(description="Squared distance of both, in standard deviations.")
    dimensions: int
    probability: float = Field(description="Probability of such a difference without any change.")
    groups: dict[str, float] = Field(description="Probability of each to be what changed.")
    moves: list[DriftMove]


class DriftReference(StoredDocument):
    """The operating point at which quantities are stated."""

    speed_rpm: float = Field(description="rpm", examples=[3000])
    load_n: float = Field(description="Radial load, N.", examples=[2700])
    temperature_c: float = Field(description="Of the bearing, °C.", examples=[50])


class DriftDocument(StoredDocument):
    """Comparison of a version with earlier ones."""

    changed: bool | None = Field(description="Null where nothing could be compared.")
    text: str
    point: DriftReference | None = Field(description="Where the quantities are stated.")
    quantities: dict[str, DriftQuantity]
    comparison: DriftComparison | None
    sums: dict[str, Number] = Field(description="Cumulative sums of the quantities; 5 reports.")
    creeping: list[str] = Field(description="Quantities whose sum reports a slow change.")


NOT_COMPARED = DriftDocument(
    changed=None,
    text="identified before this software compared versions",
    point=None,
    quantities={},
    comparison=None,
    sums={},
    creeping=[],
)


class ModelDocument(Document):
    """One model version with its parameters, the data it comes from and its scores."""

    version: int = Field(ge=1)
    status: ModelStatus
    reason: str | None
    created_at: Time
    model: str = Field(description="Name of the thermal network.", examples=["bearing-14"])
    parameters: dict[str, ParameterDocument]
    windows: list[ModelWindow]
    scores: Scores
    naive: NaiveScores = Field(
        description="Rms in K of naive forecasts in the same tests, by test, kind and sensor."
    )
    gates: GatesDocument | None = Field(description="Null before the first identification.")
    job: str | None = Field(description="The job that it comes from; null for the priors.")
    identifiability: IdentifiabilityDocument | None = Field(
        description="Null for versions of older releases."
    )
    paper_view: dict[str, Interval] | None = Field(
        description="The paper's 15 numbers, of the model paper-reduced only."
    )
    drift: DriftDocument | None = Field(
        description="Comparison with earlier versions; see `GET …/drift`. Null: none made."
    )
    sisters: SistersDocument | None = Field(
        description="Null where the family has taught nothing yet, or the asset has none."
    )
    laws: Laws = Field(
        description="Where each law comes from: how friction grows with load, with speed and "
        "temperature, how it falls from fresh grease on, housing and films. Empty before the first "
        "identification and for versions of older releases."
    )
    method: Literal["noa+refine", "refine", "noa"] | None = Field(
        description="Of the identification; null for the priors."
    )
    seed: int | None


class ModelList(Page):
    """Model versions, newest first."""

    items: list[ModelDocument]


class ActivationLine(Document):
    """One change of the active version."""

    time: Time
    version: int = Field(ge=1, description="The version that became the active one.")
    who: str
    comment: str


class ActivationList(Page):
    """The activation journal, newest first."""

    items: list[ActivationLine]


def model_document(version: ModelVersion, combinations: bool = True) -> ModelDocument:
    """Show a model version.

    ``combinations``: whether to spell out which combinations of parameters are informed, besides
    how many.
    """
    stored = version.document
    identifiability = IdentifiabilityDocument.read(stored.get("identifiability"))
    if identifiability is not None and not combinations:
        identifiability.combinations = None
    paper_view = stored.get("paper_view")
    return ModelDocument(
        version=version.version,
        status=version.status,
        reason=version.reason,
        created_at=rfc3339(version.created_at_us),
        model=stored["model"],
        parameters={
            name: ParameterDocument.model_validate(one)
            for name, one in stored["parameters"].items()
        },
        windows=[ModelWindow.model_validate(one) for one in stored["windows"]],
        scores=Scores.model_validate(stored["scores"]),
        naive=stored["naive"],
        gates=GatesDocument.read(stored["gates"]),
        job=stored["job"],
        identifiability=identifiability,
        paper_view=None
        if paper_view is None
        else {name: Interval.model_validate(one) for name, one in paper_view.items()},
        drift=DriftDocument.read(stored.get("drift")),
        sisters=SistersDocument.read(stored.get("sisters")),
        laws={law: LawDocument.model_validate(one) for law, one in stored.get("laws", {}).items()},
        method=stored.get("method"),
        seed=stored.get("seed"),
    )


def activation_line(line: Activation) -> ActivationLine:
    """Show a line of the activation journal."""
    return ActivationLine(
        time=rfc3339(line.at_us), version=line.version, who=line.who, comment=line.comment
    )
