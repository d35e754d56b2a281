"""How the machine changed over model versions."""

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from service.domain.roles import ENGINEER
from service.features.drift.documents import DriftSeries, drift_point
from service.web.api.access import secured
from service.web.api.deps import Asset, Context, json_response

router = APIRouter(prefix="/assets/{asset_id}", tags=["models"])

MOST_VERSIONS = 200


@router.get(
    "/drift",
    response_model=DriftSeries,
    summary="Get the drift over model versions",
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
    return json_response(DriftSeries(items=[drift_point(one) for one in identified[-limit:]]))
