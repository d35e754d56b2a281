"""How the machine changed over model versions."""

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from service.clock import rfc3339
from service.domain.roles import ENGINEER
from service.store.records import ModelVersion
from service.web.api.access import secured
from service.web.api.bodies import Number, Page, Time
from service.web.api.deps import Asset, Context, json_response

router = APIRouter(prefix="/assets/{asset_id}", tags=["models"])

MOST_VERSIONS = 200
_EXAMPLE: dict[str, Any] = {
    "items": [
        {
            "version": 3,
            "status": "active",
            "created_at": "2026-11-21T08:00:00.000Z",
            "data_end": "2026-11-21T07:30:00.000Z",
            "parameters": {"M0": {"value": 1.21, "low": 1.02, "high": 1.43, "verdict": "informed"}},
            "point": {"speed_rpm": 3000.0, "load_n": 2700.0, "temperature_c": 50.0},
            "quantities": {
                "friction": {
                    "text": "friction heat at 3000 rpm, 2700 N, 50 degC",
                    "group": "friction",
                    "unit": "W",
                    "value": 78.1,
                    "low": 66.0,
                    "high": 92.4,
                }
            },
            "changed": True,
            "text": "friction moved, friction heat at 3000 rpm, 2700 N, 50 degC: +18 % "
            "(95 %: +9 to +27 %)",
            "comparison": {
                "version": 2,
                "shared": 0.0,
                "alike": "the same run again",
                "statistic": 61.2,
                "dimensions": 9,
                "probability": 8e-10,
                "groups": {"friction": 0.99, "convection inside": 0.01},
                "moves": [
                    {
                        "quantity": "friction",
                        "text": "friction heat at 3000 rpm, 2700 N, 50 degC: +18 % "
                        "(95 %: +9 to +27 %)",
                        "change": 0.18,
                        "low": 0.09,
                        "high": 0.27,
                    }
                ],
            },
            "sums": {"friction": 6.2, "t_inner_ring_c": 5.4},
            "creeping": ["friction", "t_inner_ring_c"],
        }
    ],
    "next": None,
}


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow")


class DriftQuantity(_Part):
    """A physical quantity of a version with its 95 % interval."""

    text: str
    group: str | None = Field(description="Parameters that make it up; null: all of them.")
    unit: str
    value: float
    low: float
    high: float


class DriftMove(_Part):
    """By how much a quantity moved, were its group the one that did; 0.1 is +10 %."""

    quantity: str
    text: str
    change: float
    low: float
    high: float


class DriftComparison(_Part):
    """Comparison with the earlier version whose operation was most alike."""

    version: int = Field(ge=1)
    shared: float = Field(ge=0, le=1, description="Part of its data that both share.")
    alike: str
    statistic: float
    dimensions: int
    probability: float = Field(description="Probability of such a difference without any change.")
    groups: dict[str, float] = Field(description="Probability of each to be what changed.")
    moves: list[DriftMove]


class DriftPoint(_Part):
    """One version of the series."""

    version: int = Field(ge=1)
    status: Literal["candidate", "active", "retired", "rejected"]
    created_at: Time
    data_end: Time | None
    parameters: dict[str, Any]
    point: dict[str, float] | None = Field(description="Where the quantities are stated.")
    quantities: dict[str, DriftQuantity]
    changed: bool | None = Field(description="Null where nothing could be compared.")
    text: str
    comparison: DriftComparison | None
    sums: dict[str, Number] = Field(description="Cumulative sums of the quantities; 5 reports.")
    creeping: list[str] = Field(description="Quantities whose sum reports a slow change.")


class DriftSeries(Page):
    """Parameters and quantities over the versions, oldest first."""

    model_config = ConfigDict(extra="allow", json_schema_extra={"examples": [_EXAMPLE]})

    items: list[DriftPoint]


@router.get(
    "/drift",
    response_model=DriftSeries,
    summary="Drift over the model versions",
    **secured(ENGINEER, 404),
)
def get_drift(
    context: Context,
    asset: Asset,
    limit: Annotated[
        int, Query(ge=1, le=MOST_VERSIONS, description="Number of newest versions.")
    ] = 50,
) -> Response:
    """Parameters and physical quantities with intervals, and what was said about changes.

    A change is reported when noise and model error explain the difference from an earlier version
    in less than one case of a hundred, or when small differences add up over versions.
    """
    versions = context.store.models.versions(asset.id)
    identified = [one for one in versions if one.document["windows"]]
    return json_response({"items": [_item(one) for one in identified[-limit:]], "next": None})


def _item(version: ModelVersion) -> dict[str, Any]:
    document = version.document
    drift = document.get("drift") or {
        "point": None,
        "quantities": {},
        "changed": None,
        "text": "identified before this software compared versions",
        "comparison": None,
        "sums": {},
        "creeping": [],
    }
    return {
        "version": version.version,
        "status": version.status,
        "created_at": rfc3339(version.created_at_us),
        "data_end": max((window["end"] for window in document["windows"]), default=None),
        "parameters": {
            name: {key: parameter.get(key) for key in ("value", "low", "high", "verdict")}
            for name, parameter in document["parameters"].items()
        },
    } | drift
