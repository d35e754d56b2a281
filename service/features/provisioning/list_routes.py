"""Many assets at once: lists that are imported, and ids that are removed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from adapters.configuration import listed
from service.clock import wall_us
from service.documents.problems import FieldError
from service.domain.roles import ADMIN
from service.domain.upload_limits import CELLS_MAX, JUDGING_S, UploadTooLargeError
from service.features.provisioning.asset_routes import first_of, network_line
from service.features.provisioning.documents import ImportedAssets, RejectedAsset, RemovedAssets
from service.features.provisioning.lists import (
    AssetListError,
    AssetRows,
    JudgedList,
    WrongRow,
    judge_list,
    judge_removal,
    read_csv,
    read_json,
)
from service.features.provisioning.requests import AssetsToImport, AssetsToRemove
from service.site.configuration import TomlTable
from service.store import AuditEntry
from service.web.api.access import secured
from service.web.api.context import ServiceContext
from service.web.api.deps import Context, json_response
from service.web.api.middleware import CSV
from service.web.api.problems import Problem, line_error, pointer_problem
from service.web.api.trail import ChangeLine
from service.web.api.turns import caller_of, turns_of

router = APIRouter(tags=["provisioning"])


_importing = secured(
    ADMIN,
    audit="assets.import",
    responses={
        202: {
            "model": ImportedAssets,
            "description": "Kept, but the cell does not answer now.",
        }
    },
)
_importing["openapi_extra"]["requestBody"] = {
    "required": True,
    "content": {
        "application/json": {"schema": {"$ref": f"#/components/schemas/{AssetsToImport.__name__}"}},
        CSV: {
            "schema": {"type": "string"},
            "example": 'id,template,name,unit\naxle-1,axle,"Car 3, axle 1",11\n',
        },
    },
}


@router.post(
    "/assets:import",
    response_model=ImportedAssets,
    summary="Import assets",
    **_importing,
)
async def import_assets(
    context: Context,
    request: Request,
    line: ChangeLine,
    partial_: Annotated[
        bool, Query(alias="partial", description="Take the good rows where others are wrong.")
    ] = False,
    dry_run: Annotated[bool, Query(description="Judge the list, write nothing.")] = False,
) -> Response:
    """Take a list of assets in one transaction, JSON or CSV.

    CSV: columns `id`, `template`, `name`, `group`, `family`, `bearing`, `model`, `network`; every
    other column is a value for the holes of the template. Without `partial` one wrong row refuses
    all, and `errors` names every wrong row.
    """
    content = await request.body()
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    async with turns_of(request).imports.turn(caller_of(request)):
        judged = await to_thread.run_sync(
            partial(_import, context, content, kind == CSV, partial_, dry_run, line)
        )
        away = False
        not_running: Mapping[str, str] = {}
        if judged.changes and not dry_run:
            taken_up = await context.apply_stored_assets()
            away = taken_up is None
            not_running = {
                name: why for name, why in (taken_up or {}).items() if name in judged.changes
            }
    answer = ImportedAssets(
        created=len(judged.created),
        changed=len(judged.changed),
        unchanged=judged.unchanged,
        rejected=[_rejected(row) for row in judged.wrong],
        not_running=not_running,
    )
    return json_response(answer, 202 if away else 200)


@router.post(
    "/assets:remove",
    response_model=RemovedAssets,
    summary="Remove several assets",
    **secured(
        ADMIN,
        audit="assets.remove",
        responses={
            202: {
                "model": RemovedAssets,
                "description": "Removed, but the cell does not answer now.",
            }
        },
    ),
)
async def remove_assets(
    context: Context, request: Request, line: ChangeLine, assets: AssetsToRemove
) -> Response:
    """Stop following several assets, in one transaction; their history stays.

    One id that is not that of a provisioned asset refuses all, and `errors` names every such id.
    """
    async with turns_of(request).imports.turn(caller_of(request)):
        names = await to_thread.run_sync(partial(_remove, context, assets.ids, line))
        away = await context.apply_stored_assets() is None
    return json_response(RemovedAssets(removed=len(names)), 202 if away else 200)


def _import(
    context: ServiceContext,
    content: bytes,
    is_csv: bool,
    partial_: bool,
    dry_run: bool,
    line: AuditEntry,
) -> JudgedList:
    """Read and judge a list, and write what it changes."""
    try:
        rows = read_csv(content, CELLS_MAX) if is_csv else read_json(content)
        present = {one.id: one.table for one in context.store.assets.present()}
        _refuse_networks(context, rows, present)
        judged = judge_list(context.settings, rows, present, JUDGING_S)
    except (AssetListError, UploadTooLargeError) as error:
        raise pointer_problem("", str(error)) from error
    if judged.wrong and not partial_:
        raise _refused(judged.wrong)
    if judged.changes and not dry_run:
        context.store.assets.change(judged.changes, wall_us(), replace(line, detail=judged.summary))
    return judged


def _refuse_networks(
    context: ServiceContext, rows: AssetRows, present: Mapping[str, TomlTable | None]
) -> None:
    """Take the assets out of a list whose network is a file that callers may not name."""
    for name, one in list(rows.assets.items()):
        line = network_line(context.settings, one.table, present.get(name))
        if line is not None:
            del rows.assets[name]
            rows.wrong.append(WrongRow(one.entry, one.row, name, (line,)))


def _remove(context: ServiceContext, ids: Sequence[str], line: AuditEntry) -> list[str]:
    """Remove assets, all or none; gives each id once."""
    present = {one.id for one in context.store.assets.present()}
    wrong = judge_removal(context.settings, ids, present)
    if wrong:
        errors = [
            FieldError(pointer=f"/ids/{row.entry}", detail=f"{row.id}: {row.lines[0]}")
            for row in wrong
        ]
        raise Problem(
            422,
            f"nothing is removed; {first_of([error.detail for error in errors])}",
            errors=errors,
        )
    names = list(dict.fromkeys(ids))
    summary = f"removed: {len(names)}; assets: {listed(names)}"
    context.store.assets.change(dict.fromkeys(names), wall_us(), replace(line, detail=summary))
    return names


def _refused(wrong: Sequence[WrongRow]) -> Problem:
    rejected = [_rejected(row) for row in wrong]
    errors: list[FieldError] = [error for one in rejected for error in one.errors]
    rows = "1 row is" if len(rejected) == 1 else f"{len(rejected)} rows are"
    return Problem(422, f"{rows} wrong, nothing is changed; {errors[0].detail}", errors=errors)


def _rejected(row: WrongRow) -> RejectedAsset:
    named = "" if row.id is None else f" ({row.id})"
    below, prefix = f"/assets/{row.entry}", f"row {row.row}{named}: "
    return RejectedAsset(
        row=row.row,
        id=row.id,
        detail=first_of(row.lines),
        errors=[line_error(line, below, prefix) for line in row.lines],
    )
