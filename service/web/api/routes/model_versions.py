"""Model versions: what was identified, and which one is active."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from service.bus.commands import Identifications
from service.bus.replica import AssetReplica
from service.documents.models import (
    ActivationList,
    ModelDocument,
    ModelList,
    activation_line,
    model_document,
)
from service.domain.requests import RequestBody
from service.domain.roles import ENGINEER
from service.domain.texts import OneLine
from service.web.api.access import secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Asset, Context, Recorded, RecordedAsset, json_response
from service.web.api.problems import Problem, parameter_problem
from service.web.api.trail import ChangeLine

router = APIRouter(prefix="/assets/{asset_id}/models", tags=["models"])

Version = Annotated[int, Path(ge=1, le=2**31 - 1, description="Counted from 1 per asset.")]


class ActivationRequest(RequestBody):
    """Why a version is made the active one."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"comment": "back to the version before the new grease"}]},
    )

    comment: OneLine | None = Field(None, max_length=500, description="For the journal.")
    force: bool = Field(False, description="Activate a rejected version; needs a comment.")


@router.get("", response_model=ModelList, summary="List model versions", **secured(ENGINEER, 404))
def list_models(
    context: Context, asset: Recorded, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """All versions, newest first; informed combinations are counted, not spelled out."""
    newest_first = context.store.models.versions(asset.id)[::-1]
    page, following = page_of(newest_first, limit, cursor, lambda model: model.version)
    items = [model_document(version, combinations=False) for version in page]
    return json_response(
        ModelList(items=items, next=following), headers=next_link(request, following)
    )


@router.get(
    "/activations",
    response_model=ActivationList,
    summary="List model activations",
    **secured(ENGINEER, 404),
)
def list_activations(
    context: Context, asset: Recorded, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """The activation journal, newest first: who changed the active version, when and why."""
    newest_first = list(enumerate(context.store.models.activations(asset.id)))[::-1]
    page, following = page_of(newest_first, limit, cursor, lambda numbered: numbered[0])
    items = [activation_line(line) for _, line in page]
    answer = ActivationList(items=items, next=following)
    return json_response(answer, headers=next_link(request, following))


@router.get(
    "/{version}",
    response_model=ModelDocument,
    summary="Get a model version",
    **secured(ENGINEER, 404),
)
def get_model(context: Context, asset: Recorded, version: Version) -> Response:
    """Parameters with intervals, what the data inform, scores next to the naive forecasts."""
    model = context.store.models.version(asset.id, version)
    if model is None:
        raise _no_version(asset, version)
    return json_response(model_document(model))


@router.post(
    "/{version}/activate",
    response_model=ModelDocument,
    summary="Activate a model version",
    **secured(ENGINEER, 404, 409),
)
async def activate_model(
    context: Context,
    asset: Asset,
    version: Version,
    line: ChangeLine,
    request: ActivationRequest | None = None,
) -> Response:
    """Switch the live twin to this version, forward or back, and write it into the journal."""
    wanted = request or ActivationRequest(comment=None, force=False)
    try:
        activated = await context.cell(Identifications).activate(
            asset.id, version, line.who, wanted.comment, wanted.force, line
        )
    except KeyError as error:
        raise _no_version(asset, version) from error
    return json_response(activated)


def _no_version(asset: AssetReplica | RecordedAsset, version: int) -> Problem:
    return parameter_problem("version", f"asset {asset.id!r} has no model version {version}", 404)
