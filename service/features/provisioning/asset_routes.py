"""One asset: made, changed, removed; templates."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Final

from anyio import to_thread
from fastapi import APIRouter, Header, Path
from starlette.requests import Request
from starlette.responses import Response

from service.clock import wall_us
from service.documents.base import time_or_none
from service.domain.errors import ChangedMeanwhileError
from service.domain.roles import ADMIN, ENGINEER, VIEWER
from service.features.provisioning.documents import (
    AssetConfiguration,
    ProvisioningDocument,
    RemovedAsset,
    RemovedAssetList,
    TemplateDocument,
)
from service.features.provisioning.requests import AssetTable
from service.site.asset_section import ASSET_ID
from service.site.asset_tables import (
    AssetInFileError,
    check_asset,
    key_line,
    outside_network,
)
from service.site.configuration import SettingsError, TomlTable
from service.site.page_sources import outside_folder
from service.site.settings import Settings
from service.site.templates import templates_by_name
from service.store import AuditEntry, ProvisionedAsset
from service.web.api.access import LOCATION, secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, json_response
from service.web.api.problems import Problem, line_error, parameter_problem
from service.web.api.trail import ChangeLine

_AWAY: Final = "the cell has not answered yet; it takes the asset up automatically"
_NOT_TAKEN_UP: Final = "the cell has not taken it up"
#: How often a merge begins again when somebody else changes the same asset meanwhile.
_TRIES = 5

router = APIRouter(tags=["provisioning"])

NewId = Annotated[str, Path(pattern=ASSET_ID, description="The asset's id.", examples=["axle-1"])]
OnlyNew = Annotated[
    str | None,
    Header(
        alias="If-None-Match",
        pattern=r"^\*$",
        description="`*`: only make it; an asset that there is, running or not, is left as it is "
        "(412).",
    ),
]
KnownId = Annotated[str, Path(max_length=200, description="The asset's id.", examples=["axle-1"])]

_KEPT: dict[str, Any] = {
    "model": AssetConfiguration,
    "description": "Kept, but not in effect now; `not_running` says why.",
}


@router.get(
    "/assets/{asset_id}/configuration",
    response_model=AssetConfiguration,
    summary="Get the configuration of an asset",
    **secured(ENGINEER, 404),
)
def get_configuration(context: Context, asset_id: KnownId) -> Response:
    """Give the table of an asset that is not in the configuration file."""
    why = None if asset_id in context.assets else _NOT_TAKEN_UP
    for asset in context.settings.assets:
        if asset.id == asset_id:
            return json_response(AssetConfiguration.of_file(asset, why))
    return json_response(AssetConfiguration.of(_stored(context, asset_id), why))


@router.put(
    "/assets/{asset_id}",
    response_model=AssetConfiguration,
    summary="Create or replace an asset",
    **secured(
        ADMIN,
        409,
        412,
        audit="asset.put",
        responses={
            201: {"model": AssetConfiguration, "description": "Made.", "headers": LOCATION},
            202: _KEPT,
        },
    ),
)
async def put_asset(
    context: Context,
    asset_id: NewId,
    line: ChangeLine,
    table: AssetTable,
    request: Request,
    if_none_match: OnlyNew = None,
) -> Response:
    """Check the table like one of the configuration file, store it, and follow the asset.

    The answer means that it is in effect. A table that changes nothing writes nothing. 409 for an
    asset of the configuration file.
    """
    before, asset, changed = await to_thread.run_sync(
        partial(_put, context, asset_id, table.root, line, only_new=if_none_match is not None)
    )
    headers = {"Location": request.url.path} if before is None else {}
    return await _answer(context, asset, changed, 201 if before is None else 200, headers)


@router.patch(
    "/assets/{asset_id}",
    response_model=AssetConfiguration,
    summary="Update an asset",
    **secured(ADMIN, 404, 409, audit="asset.patch", responses={202: _KEPT}),
)
async def patch_asset(
    context: Context, asset_id: NewId, line: ChangeLine, table: AssetTable
) -> Response:
    """Merge the body into the table (JSON merge patch, RFC 7396): null removes a key."""
    asset, changed = await to_thread.run_sync(partial(_patch, context, asset_id, table.root, line))
    return await _answer(context, asset, changed)


@router.delete(
    "/assets/{asset_id}",
    status_code=204,
    response_class=Response,
    summary="Remove an asset",
    **secured(
        ADMIN,
        404,
        409,
        audit="asset.delete",
        responses={202: {"description": "Removed, but the cell does not answer now."}},
    ),
)
async def delete_asset(context: Context, asset_id: KnownId, line: ChangeLine) -> Response:
    """Stop following an asset; its history stays. 409 for an asset of the configuration file."""
    await to_thread.run_sync(partial(_delete, context, asset_id, line))
    return Response(status_code=202 if await context.apply_stored_assets() is None else 204)


@router.get(
    "/provisioning/removed",
    response_model=RemovedAssetList,
    summary="List removed assets",
    **secured(VIEWER),
)
def get_removed(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """List what was removed and has a history: measurements, runs, models and the journal stay."""
    assets = context.store.assets
    configured = {one.id for one in context.settings.assets} | {one.id for one in assets.present()}
    times = {one.id: one.removed_us for one in assets.once_removed()}
    names = sorted(context.store.samples.with_history() - configured)
    page, following = page_of(names, limit, cursor, str)
    items = [RemovedAsset(id=name, removed_at=time_or_none(times.get(name))) for name in page]
    return json_response(
        RemovedAssetList(items=items, next=following), headers=next_link(request, following)
    )


@router.get(
    "/provisioning",
    response_model=ProvisioningDocument,
    summary="List templates and provisioned assets",
    **secured(ENGINEER),
)
def get_provisioning(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """Give all templates, and the tables of the provisioned assets by id."""
    present = context.store.assets.present()
    page, following = page_of(present, limit, cursor, lambda asset: asset.id)
    templates = templates_by_name(context.settings.templates)
    running = context.assets
    answer = ProvisioningDocument(
        templates=[TemplateDocument.of(name, table) for name, table in templates.items()],
        items=[
            AssetConfiguration.of(one, None if one.id in running else _NOT_TAKEN_UP) for one in page
        ],
        next=following,
    )
    return json_response(answer, headers=next_link(request, following))


def _put(
    context: ServiceContext,
    asset_id: str,
    table: TomlTable,
    line: AuditEntry,
    *,
    only_new: bool = False,
) -> tuple[ProvisionedAsset | None, ProvisionedAsset, bool]:
    """Write a table; returns what there was, what there is, and whether they differ."""
    before = context.store.assets.get(asset_id)
    _check(context, asset_id, table, before)
    whole = _without_id(table)
    if only_new and before is not None:
        raise _exists(asset_id)
    if before is not None and before.table == whole:
        return before, before, False
    try:
        based_on = {asset_id: None} if only_new else None
        return before, _written(context, asset_id, whole, line, based_on), True
    except ChangedMeanwhileError as error:  # somebody else was quicker
        raise _exists(asset_id) from error


def _patch(
    context: ServiceContext, asset_id: str, patch: TomlTable, line: AuditEntry, tries: int = _TRIES
) -> tuple[ProvisionedAsset, bool]:
    """Merge a patch into a table; returns what there is, and whether it has changed."""
    if any(asset.id == asset_id for asset in context.settings.assets):
        raise _in_file(asset_id)
    before = _stored(context, asset_id)
    merged = merge_patch(before.table, patch)
    _check(context, asset_id, merged, before)
    whole = _without_id(merged)
    if whole == before.table:
        return before, False
    try:
        return _written(context, asset_id, whole, line, {asset_id: before.revision}), True
    except ChangedMeanwhileError:
        if tries == 1:
            raise
        return _patch(context, asset_id, patch, line, tries - 1)


def _written(
    context: ServiceContext,
    asset_id: str,
    table: TomlTable,
    line: AuditEntry,
    based_on: Mapping[str, int | None] | None = None,
) -> ProvisionedAsset:
    at_us = wall_us()
    revision = context.store.assets.change({asset_id: table}, at_us, line, based_on)
    return ProvisionedAsset(asset_id, table, revision, at_us)


def _delete(context: ServiceContext, asset_id: str, line: AuditEntry) -> None:
    in_file = any(asset.id == asset_id for asset in context.settings.assets)
    if in_file and context.store.assets.get(asset_id) is None:
        raise _in_file(asset_id)
    _stored(context, asset_id)
    context.store.assets.change({asset_id: None}, wall_us(), line)


def _check(
    context: ServiceContext, asset_id: str, table: TomlTable, before: ProvisionedAsset | None
) -> None:
    line = network_line(context.settings, table, None if before is None else before.table)
    if line is not None:
        raise Problem(422, line, errors=[line_error(line)])
    try:
        lines = check_asset(context.settings, asset_id, table).section.lines_in_names
    except AssetInFileError as error:
        raise _in_file(asset_id) from error
    except SettingsError as error:
        lines = [key_line(asset_id, line) for line in error.lines]
    if lines:
        raise Problem(422, first_of(lines), errors=[line_error(one) for one in lines])


def network_line(settings: Settings, table: TomlTable, before: TomlTable | None) -> str | None:
    """Say that a network lies where callers name no files; one that is there already may stay."""
    network = outside_network(settings, table)
    if network is None or (before is not None and outside_network(settings, before) == network):
        return None
    return f"network = {network!r}: {outside_folder(network)}"


def _in_file(asset_id: str) -> Problem:
    return parameter_problem(
        "asset_id",
        f"asset {asset_id!r} stands in the configuration file; expected a change there",
        409,
    )


def _exists(asset_id: str) -> Problem:
    return parameter_problem(
        "asset_id", f"there is an asset {asset_id!r} already; it is left as it is", 412
    )


def _stored(context: ServiceContext, asset_id: str) -> ProvisionedAsset:
    found = context.store.assets.get(asset_id)
    if found is None:
        raise parameter_problem("asset_id", f"no asset {asset_id!r} is provisioned", 404)
    return found


def _without_id(table: TomlTable) -> TomlTable:
    return {name: part for name, part in table.items() if name != "id"}


def merge_patch(target: Any, patch: Any) -> Any:
    """Apply a JSON merge patch (RFC 7396, section 2)."""
    if not isinstance(patch, dict):
        return patch
    merged = dict(target) if isinstance(target, dict) else {}
    for name, part in patch.items():
        if part is None:
            merged.pop(name, None)
        else:
            merged[name] = merge_patch(merged.get(name), part)
    return merged


def first_of(lines: Sequence[str]) -> str:
    """Give the first of some lines, and how many more there are."""
    return f"{lines[0]} (and {len(lines) - 1} more)" if len(lines) > 1 else lines[0]


async def _answer(
    context: ServiceContext,
    asset: ProvisionedAsset,
    changed: bool,
    status: int = 200,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Answer with an asset once it is in effect."""
    if not changed:
        why = None if asset.id in context.assets else _NOT_TAKEN_UP
    else:
        taken_up = await context.apply_stored_assets()
        why = _AWAY if taken_up is None else taken_up.get(asset.id)
    document = AssetConfiguration.of(asset, why)
    return json_response(document, status if why is None else 202, headers)
