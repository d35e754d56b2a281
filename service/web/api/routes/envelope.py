"""The safe operating envelope."""

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from service.documents.envelope import EnvelopeDocument
from service.domain.roles import VIEWER
from service.web import worker
from service.web.api.access import secured
from service.web.api.deps import Asset, json_response
from service.web.api.turns import study

router = APIRouter(prefix="/assets/{asset_id}", tags=["planning"])


@router.get(
    "/envelope",
    response_model=EnvelopeDocument,
    summary="Get the safe operating envelope over speed and load",
    **secured(VIEWER, 404),
)
async def get_envelope(asset: Asset, request: Request) -> Response:
    """Steady temperatures and times to the limits, each point held from the present state.

    Kept until the model version, the plan's range or the machine's state changes.
    """
    what = "envelope", await asset.model_version()
    return json_response(await study(request, asset, what, worker.envelope))
