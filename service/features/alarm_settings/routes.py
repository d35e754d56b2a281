"""Alarm settings as data: the rationalisation sheet, its changes, and its import."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Final

from anyio import to_thread
from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from adapters.samples import is_good
from service.documents.problems import FieldError
from service.documents.tags import Tag
from service.domain.errors import CellUnavailableError
from service.domain.roles import ENGINEER, VIEWER
from service.domain.texts import OneLine
from service.domain.upload_limits import CELLS_MAX, JUDGING_S, UploadTooLargeError
from service.features.alarm_settings.documents import (
    AlarmSettingHistory,
    AlarmSettingList,
    ImportedAlarmSettings,
    alarm_setting,
    change_document,
    imported,
    sheet_of,
    silenced,
)
from service.features.alarm_settings.requests import AlarmSettingPatch, AlarmSettingsToImport
from service.features.alarm_settings.settings_changes import (
    JudgedSettings,
    Mistake,
    WantedRow,
    judge_settings,
)
from service.features.alarm_settings.sheets import (
    NAMES,
    OF_THE_TWIN,
    AlarmSheetError,
    as_csv,
    read_csv,
    read_json,
)
from service.site.alarm_overlay import FORECAST, AlarmedAsset
from service.site.alarmed_assets import alarmed_assets
from service.store import Alarm, AuditEntry
from service.web.api.access import secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import (
    LIMIT,
    After,
    Before,
    Cursor,
    Limit,
    decode_cursor,
    encode_cursor,
    next_link,
)
from service.web.api.deps import Context, json_response
from service.web.api.middleware import CSV, KIB, Upload
from service.web.api.problems import Problem, parameter_problem, pointer_problem
from service.web.api.trail import ChangeLine
from service.web.api.turns import caller_of, turns_of

_NAMED: Final = 5

router = APIRouter(prefix="/alarm-settings", tags=["alarms"])
#: Bodies that the routes read themselves.
BODIES = (AlarmSettingsToImport,)
UPLOADS = (Upload("/alarm-settings/import", 8192 * KIB, (CSV,)),)

OfAsset = Annotated[str | None, Query(max_length=200, description="Only of this asset.")]
Comment = Annotated[
    OneLine | None, Query(max_length=500, description="Why; of CSV, which has no place for it.")
]
DryRun = Annotated[bool, Query(description="Say what would change, and write nothing.")]


@router.get(
    "",
    response_model=AlarmSettingList,
    summary="List alarm settings",
    **secured(
        VIEWER,
        responses={200: {"content": {CSV: {"schema": {"type": "string"}}}}},
    ),
)
async def list_alarm_settings(
    context: Context,
    request: Request,
    asset: OfAsset = None,
    format_: Annotated[
        str, Query(alias="format", pattern="^(json|csv)$", description="`json` or `csv`.")
    ] = "json",
    limit: Limit = LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Give the rationalisation sheet: settings in effect, texts, and the time to respond.

    The time to respond is read from the newest 500 kept forecasts of each asset. CSV is the whole
    sheet at once, in UTF-8 with a byte order mark for spreadsheets.
    """
    after = None if cursor is None else decode_cursor(cursor, After).after
    read = partial(_sheet, context, asset, None if format_ == "csv" else limit, after)
    rows, following, revision = await turns_of(request).read(caller_of(request), read)
    await _add_present_forecasts(context, rows)
    if format_ == "csv":
        headers = {"Content-Disposition": 'attachment; filename="alarm-settings.csv"'}
        return Response(as_csv(rows).encode(), headers=headers, media_type=CSV)
    items = [alarm_setting(cells) for cells in rows]
    answer = AlarmSettingList(items=items, next=following, revision=revision)
    return json_response(answer, headers=next_link(request, following))


@router.patch(
    "",
    response_model=ImportedAlarmSettings,
    summary="Update the settings of an alarm",
    **secured(ENGINEER, 409, audit="alarm_settings.patch"),
)
async def patch_alarm_setting(
    context: Context,
    request: Request,
    line: ChangeLine,
    patch: AlarmSettingPatch,
    dry_run: DryRun = False,
) -> Response:
    """Change what is given; null brings back what the configuration has.

    In effect at once: the next sample is judged by it, and an alarm that is there keeps its id.
    """
    cells = patch.model_dump(by_alias=True, exclude_unset=True)
    comment = cells.pop("comment")
    names = {name: cells.pop(name, "") for name in NAMES}
    row = WantedRow(1, names["asset"], (names["kind"], names["tag"], names["level"]), cells)
    return await _answer(context, request, line, [row], [], comment, dry_run)


_importing = secured(ENGINEER, 409, audit="alarm_settings.import")
_importing["openapi_extra"]["requestBody"] = {
    "required": True,
    "content": {
        "application/json": {
            "schema": {"$ref": f"#/components/schemas/{AlarmSettingsToImport.__name__}"}
        },
        CSV: {
            "schema": {"type": "string"},
            "example": "asset,tag,kind,level,setpoint,unit\n"
            "bench-1,t_inner_ring_c,measured limit,warning,65,°C\n",
        },
    },
}


@router.post(
    "/import",
    response_model=ImportedAlarmSettings,
    summary="Import alarm settings",
    **_importing,
)
async def import_alarm_settings(
    context: Context,
    request: Request,
    line: ChangeLine,
    dry_run: DryRun = False,
    comment: Comment = None,
) -> Response:
    """Take a sheet as CSV, or rows as JSON, in one transaction: all or nothing.

    With `dry_run` the answer lists every difference and every mistake. Without it one mistake
    refuses all (422), and `errors` names each. An empty cell, or null, brings back what the
    configuration has; columns that are not there change nothing.
    """
    content = await request.body()
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    try:
        rows, mistakes, said = await to_thread.run_sync(partial(_read, content, kind == CSV))
    except AlarmSheetError as error:
        raise pointer_problem("", str(error)) from error
    comment = (comment or said).strip()
    if not comment and not dry_run:
        raise parameter_problem("comment", "missing; expected why the settings change")
    return await _answer(context, request, line, rows, mistakes, comment, dry_run)


@router.get(
    "/history",
    response_model=AlarmSettingHistory,
    summary="List changes of alarm settings",
    **secured(VIEWER),
)
async def list_changes(
    context: Context,
    request: Request,
    asset: OfAsset = None,
    limit: Limit = LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Newest first. To undo a change, import its rows with the fields of `before`."""
    before = None if cursor is None else decode_cursor(cursor, Before).before
    page = await to_thread.run_sync(context.store.alarm_overlays.history, limit, before, asset)
    following = None
    if page.next_cursor is not None:
        following = encode_cursor(Before(before=page.next_cursor))
    answer = AlarmSettingHistory(items=[change_document(one) for one in page.items], next=following)
    return json_response(answer, headers=next_link(request, following))


# ---------------------------------------------------------------------------------- what it does
def _assets(
    context: ServiceContext, wanted: Collection[str] | None, seconds: float | None = None
) -> dict[str, AlarmedAsset]:
    tables = {one.id: one.table or {} for one in context.store.assets.present()}
    return alarmed_assets(context.settings, tables, wanted, seconds)


def _sheet(
    context: ServiceContext, asset: str | None, limit: int | None, after: str | None
) -> tuple[list[dict[str, Any]], str | None, int]:
    """Give the rows of a page, the cursor of the next, and the revision."""
    store = context.store
    revision = store.alarm_overlays.revision()
    assets = _assets(context, None if asset is None else [asset])
    if asset is not None and asset not in assets:
        raise parameter_problem("asset", f"no asset {asset!r}")
    overlays = store.alarm_overlays.present(None if asset is None else {asset})
    begin, offset = _place(after)
    rows: list[dict[str, Any]] = []
    for name in sorted(assets):
        if name < begin:
            continue
        first = offset if name == begin else 0
        of_asset = sheet_of(store, assets[name], overlays.get(name, {}))
        for number, cells in enumerate(of_asset[first:], first):
            if limit is not None and len(rows) == limit:
                return rows, encode_cursor(After(after=f"{number} {name}")), revision
            rows.append(cells)
    return rows, None, revision


async def _add_present_forecasts(context: ServiceContext, rows: Sequence[dict[str, Any]]) -> None:
    """Say what the live forecasts say of the limits now; nothing while the cell is away."""
    snapshots: dict[str, Mapping[str, Tag]] = {}
    for cells in rows:
        if cells["kind"] != FORECAST:
            continue
        name = cells["asset"]
        if name not in snapshots:
            snapshots[name] = await _tags(context, name)
        tag = snapshots[name].get(f"{cells['tag']}.time_to_{cells['level']}_s")
        if tag is not None and is_good(tag["quality"]):
            time_s = tag["value"]
            said = "not within the horizon" if time_s is None else f"in {time_s:.0f} s (median)"
            cells[OF_THE_TWIN[-1]] += f"; present forecast: {said}"


async def _tags(context: ServiceContext, name: str) -> Mapping[str, Tag]:
    asset = context.assets.get(name)
    if asset is None:
        return {}
    try:
        await asset.refresh("snapshot")
        return asset.snapshot()["tags"]
    except CellUnavailableError:
        return {}


def _place(after: str | None) -> tuple[str, int]:
    """Asset and row from which a page begins."""
    if after is None:
        return "", 0
    number, _, name = after.partition(" ")
    if not number.isdecimal() or len(number) > 6:
        raise parameter_problem("cursor", "expected the `next` of the page before")
    return name, int(number)


def _read(content: bytes, is_csv: bool) -> tuple[list[WantedRow], list[Mistake], str]:
    """Give the rows of a body, what is wrong with the others, and its comment."""
    if is_csv:
        return *read_csv(content, CELLS_MAX), ""
    return read_json(content)


async def _answer(
    context: ServiceContext,
    request: Request,
    line: AuditEntry,
    rows: Sequence[WantedRow],
    mistakes: Sequence[Mistake],
    comment: str,
    dry_run: bool,
) -> Response:
    async with turns_of(request).imports.turn(caller_of(request)):
        revision, judged = await to_thread.run_sync(partial(_judge, context, rows))
        judged.mistakes = sorted([*mistakes, *judged.mistakes], key=lambda one: one.place)
        if judged.mistakes:
            judged.changes.clear()
            if not dry_run:
                raise _refused(judged.mistakes)
        silences = silenced(judged.differences, await _active(context, judged))
        taken_up: Mapping[str, str] | None = {}
        if judged.changes and not dry_run:
            detail = "; ".join([comment, judged.summary, *_silences_line(silences)])
            change = partial(
                context.store.alarm_overlays.change,
                judged.changes,
                replace(line, detail=detail),
                comment,
                revision,
            )
            revision = await to_thread.run_sync(change)
            taken_up = await context.apply_stored_assets()
            context.changed(None)
    answer = imported(
        judged, silences, revision, dry_run=dry_run, in_effect=not dry_run and taken_up is not None
    )
    return json_response(answer)


def _judge(context: ServiceContext, rows: Sequence[WantedRow]) -> tuple[int, JudgedSettings]:
    settings = context.store.alarm_overlays
    revision = settings.revision()
    names = {row.asset for row in rows}
    try:
        assets = _assets(context, names, JUDGING_S)
        judged = judge_settings(assets, settings.present(names), rows, JUDGING_S)
    except UploadTooLargeError as error:
        raise pointer_problem("", str(error)) from error
    return revision, judged


async def _active(context: ServiceContext, judged: JudgedSettings) -> list[Alarm]:
    """Alarms of the assets that change; none while the cell is away."""
    found: list[Alarm] = []
    try:
        for asset in {one.asset for one in judged.differences}:
            found += await context.cell.open_alarms(asset)
    except CellUnavailableError:
        return []
    return found


def _silences_line(silences: Sequence[Alarm]) -> Iterator[str]:
    """Say in the audit trail which alarms that are there a change ends or makes less urgent."""
    if silences:
        shown = [
            f"{one.asset} {one.kind} {one.channel} {one.level} (priority {one.priority})"
            for one in sorted(silences, key=lambda one: one.priority)[:_NAMED]
        ]
        more = "" if len(silences) <= _NAMED else f" and {len(silences) - _NAMED} more"
        yield f"silences active alarms: {', '.join(shown)}{more}"


def _refused(mistakes: Sequence[Mistake]) -> Problem:
    errors = [
        FieldError(pointer=f"/rows/{one.place}/{one.column}", detail=str(one)) for one in mistakes
    ]
    count = "1 mistake" if len(errors) == 1 else f"{len(errors)} mistakes"
    return Problem(422, f"{count}, nothing is changed; {errors[0].detail}", errors=errors)
