"""How the machine changed over model versions."""

from typing import Literal

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Document, Number, Page, StoredDocument, Time
from service.documents.models import NOT_COMPARED, DriftDocument
from service.store.records import ModelVersion


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


class FileDrift(DriftDocument):
    """One model file, compared with an earlier one."""

    file: str
    start: Time | None
    end: Time | None
    against: str | None = Field(description="The file that it was compared with.")


class DriftOfFiles(Document):
    """Whether a machine has changed over model files."""

    changed: bool | None
    text: str
    models: list[FileDrift]


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
