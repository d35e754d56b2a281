"""The safe operating envelope."""

from fastapi import APIRouter
from starlette.responses import Response

from service.api.access import secured
from service.api.deps import Asset, json_response
from service.api.planning import EnvelopeDocument
from service.security.roles import VIEWER

router = APIRouter(prefix="/assets/{asset_id}", tags=["planning"])


@router.get(
    "/envelope",
    response_model=EnvelopeDocument,
    summary="Safe operating envelope over speed and load",
    **secured(VIEWER, 404),
)
async def get_envelope(asset: Asset) -> Response:
    """Steady temperatures and times to the limits, each point held from the present state.

    Kept until the model version, the plan's range or the machine's state changes.
    """
    return json_response(await asset.envelope())
