"""Assets: what they are, how they are now, and what the twin says of them."""

from bisect import bisect_right

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from service.bus.commands import Assets
from service.documents.assets import (
    AssetDocument,
    AssetList,
    GreaseRenewed,
    State,
)
from service.documents.tags import Snapshot
from service.documents.verdicts import VerdictDocument
from service.domain.requests import GreaseRenewedRequest
from service.domain.roles import ENGINEER, VIEWER, VIEWER_OR_GATEWAY
from service.web.api.access import secured
from service.web.api.cursors import (
    After,
    Cursor,
    LimitOrAll,
    decode_cursor,
    encode_cursor,
    next_link,
)
from service.web.api.deps import Asset, Context, copy_response, json_response
from service.web.api.entity_tags import CONDITIONAL, IfNoneMatch, conditional_response
from service.web.api.problems import parameter_problem
from service.web.api.snapshots import snapshot_response
from service.web.api.trail import ChangeLine

router = APIRouter(prefix="/assets", tags=["assets"])


@router.get(
    "",
    response_model=AssetList,
    summary="List assets",
    **secured(VIEWER_OR_GATEWAY, responses=CONDITIONAL),
)
async def list_assets(
    request: Request,
    context: Context,
    if_none_match: IfNoneMatch = None,
    limit: LimitOrAll = None,
    cursor: Cursor = None,
) -> Response:
    """Give configuration, health and active model of every asset.

    Without `limit` all at once, in the order of the configuration; with it in pages by id.
    """
    if limit is None:
        if cursor is not None:
            raise parameter_problem("cursor", "expected a limit with it")
        await context.refresh_summaries(None)
        items = [asset.summary() for asset in context.assets.values()]
        return conditional_response(AssetList(items=items), if_none_match)
    names = sorted(context.assets)
    after = "" if cursor is None else decode_cursor(cursor, After).after
    begin = bisect_right(names, after)
    page = names[begin : begin + limit]
    more = begin + limit < len(names)
    await context.refresh_summaries(page)
    # One may have gone meanwhile.
    items = [context.assets[name].summary() for name in page if name in context.assets]
    following = encode_cursor(After(after=page[-1])) if more else None
    answer = AssetList(items=items, next=following)
    return conditional_response(answer, if_none_match, next_link(request, following))


@router.get(
    "/{asset_id}",
    response_model=AssetDocument,
    summary="Get an asset",
    **secured(VIEWER_OR_GATEWAY, 404, responses=CONDITIONAL),
)
async def get_asset(asset: Asset, if_none_match: IfNoneMatch = None) -> Response:
    """Give configuration, health and active model."""
    await asset.refresh("summary")
    return conditional_response(asset.summary(), if_none_match)


@router.get(
    "/{asset_id}/snapshot",
    response_model=Snapshot,
    summary="Get the current values as tags",
    **secured(VIEWER, 404, responses=CONDITIONAL),
)
async def get_snapshot(asset: Asset, if_none_match: IfNoneMatch = None) -> Response:
    """Measured values, estimates, forecast maxima, times to limit and alarm counts, from memory."""
    return await snapshot_response(asset, if_none_match)


@router.get(
    "/{asset_id}/state",
    response_model=State,
    summary="Get the node temperatures",
    **secured(VIEWER, 404),
)
async def get_state(asset: Asset) -> Response:
    """Mean and standard deviation of every node, null before the first data."""
    await asset.refresh("state")
    return copy_response(asset, "state")


@router.get(
    "/{asset_id}/verdict",
    response_model=VerdictDocument,
    summary="Get the verdict: now, rest of the present step, next step",
    **secured(VIEWER, 404),
)
async def get_verdict(asset: Asset) -> Response:
    """Give one word each, with reasons; without an input it is `unknown`, and named."""
    await asset.refresh("verdict")
    return copy_response(asset, "verdict")


@router.post(
    "/{asset_id}/grease-renewed",
    response_model=GreaseRenewed,
    summary="Record a grease renewal",
    **secured(ENGINEER, 404),
)
async def post_grease_renewed(
    context: Context, asset: Asset, line: ChangeLine, request: GreaseRenewedRequest | None = None
) -> Response:
    """Count the revolutions, and with them the run-in state of the grease, from zero again."""
    comment = (request.comment if request else None) or ""
    renewed = await context.cell(Assets).renew_grease(asset.id, line.who, comment, line)
    return json_response(renewed)
