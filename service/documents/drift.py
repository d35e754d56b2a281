"""How the machine changed over model versions."""

from typing import Literal

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Number, Page, StoredDocument, Time
from service.store.records import ModelVersion


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


class DriftParameter(StoredDocument):
    """A parameter with its 95 % interval."""

    value: float
    low: Number = Field(None, description="2.5 %")
    high: Number = Field(None, description="97.5 %")
    verdict: Literal["informed", "weak", "prior only"] | None = None


class DriftPoint(DriftDocument):
    """One version of the series."""

    version: int = Field(ge=1)
    status: Literal["candidate", "active", "retired", "rejected"]
    created_at: Time
    data_end: Time | None
    parameters: dict[str, DriftParameter]


class DriftSeries(Page):
    """Parameters and quantities over the versions, oldest first."""

    items: list[DriftPoint]


def drift_point(version: ModelVersion) -> DriftPoint:
    """Show one version of the series."""
    stored = version.document
    drift = DriftDocument.read(stored.get("drift") or None) or NOT_COMPARED
    return DriftPoint(
        **dict(drift),
        version=version.version,
        status=version.status,
        created_at=rfc3339(version.created_at_us),
        data_end=max((window["end"] for window in stored["windows"]), default=None),
        parameters={
            name: DriftParameter.model_validate(one) for name, one in stored["parameters"].items()
        },
    )
