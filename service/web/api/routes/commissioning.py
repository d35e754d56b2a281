"""Commissioning: a bench is put into service from the page; the result is the configuration file.

What asks a device runs in a process of its own (`service.web.probes`). Nothing is ever written to
a device.
"""

import asyncio
import tomllib
from functools import partial
from pathlib import Path as FilePath
from typing import Annotated, Any, Final

from anyio import to_thread
from fastapi import APIRouter, Path
from starlette.background import BackgroundTask
from starlette.requests import Request
from starlette.responses import Response

from adapters.configuration import ConfigurationError
from service.clock import wall_us
from service.documents.commissioning import (
    CatalogueBearing,
    CheckDocument,
    CommissioningDocument,
    DbcDocument,
    RegisterList,
    SavedDocument,
    SignalList,
    Takes,
    UnitList,
    VersionDocument,
    VersionList,
)
from service.domain.commissioning import (
    ConfigurationChange,
    DbcUpload,
    RegisterRead,
    SignalWatch,
    SourceTable,
    UnitScan,
    VersionRestored,
)
from service.domain.roles import ADMIN
from service.files import FileError, replacing
from service.site.configuration import SettingsError, TomlTable
from service.site.edited_file import with_tables
from service.site.file_versions import FileChangedError, read_file, revision_of, save, versions
from service.site.page_sources import source_from_page
from service.web import probe_worker
from service.web.api.access import actor, secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, Trail, json_response
from service.web.api.problems import Problem, line_error, parameter_problem, pointer_problem
from service.web.probes import Probes
from twin_core.bearings import CATALOGUE

_MOST_NAMES: Final = 100
_MODBUS: Final = ("modbus-tcp", "modbus-rtu")

router = APIRouter(prefix="/commissioning", tags=["commissioning"])


@router.get(
    "",
    response_model=CommissioningDocument,
    summary="The configuration file as far as the page changes it",
    **secured(ADMIN),
)
def get_commissioning(context: Context) -> Response:
    """Give sources and assets of the file as it is now, and the bearings of the catalogue."""
    file = context.settings.file
    text, why_not = "", _why_not(context)
    if file is not None:
        text = read_file(file)
    sources, assets = _lists(text)
    return json_response(
        CommissioningDocument(
            file=None if file is None else file.name,
            why_not=why_not,
            takes_effect=_takes(context),
            revision=revision_of(text),
            sources=sources,
            assets=assets,
            bearings=[
                CatalogueBearing(
                    designation=name,
                    bore_mm=one.bore_mm,
                    outer_mm=one.outer_mm,
                    width_mm=one.width_mm,
                )
                for name, one in sorted(CATALOGUE.items())
            ],
        )
    )


@router.post(
    "/units",
    response_model=UnitList,
    summary="Ask which units of a Modbus source answer",
    **secured(ADMIN, 409, audit=None),
)
async def post_units(context: Context, request: Request, trail: Trail, body: UnitScan) -> Response:
    """Read the first register of each unit; at most half a second is given to one."""
    source = _source(context, body.source, *_MODBUS)
    await trail.note_repeated(actor(request), "commissioning.scan", _shown(body.source))
    probes = _probes(request)
    return json_response(await probes.run(probe_worker.units, source, body.first, body.count))


@router.post(
    "/registers",
    response_model=RegisterList,
    summary="Read registers in every type and order",
    **secured(ADMIN, 409, audit=None),
)
async def post_registers(
    context: Context, request: Request, trail: Trail, body: RegisterRead
) -> Response:
    """Read a block of registers once. A register that is not there has no values."""
    source = _source(context, body.source, *_MODBUS)
    await trail.note_repeated(actor(request), "commissioning.read", _shown(body.source))
    work = partial(probe_worker.registers, source, body.unit, body.kind, body.first, body.count)
    return json_response(await _probes(request).run(work))


@router.post(
    "/dbc",
    status_code=201,
    response_model=DbcDocument,
    summary="Upload a DBC file",
    **secured(ADMIN, 409, audit=None),
)
async def post_dbc(context: Context, request: Request, trail: Trail, body: DbcUpload) -> Response:
    """Put a DBC file beside the configuration file, and list its signals.

    A file that is there already and holds something else stays as it is: earlier configurations
    name it. The new one then has a number behind its name.
    """
    folder = _file(context).resolve().parent
    turn: asyncio.Lock = request.app.state.uploads
    async with turn:  # two of the same name take two names
        try:
            name = await to_thread.run_sync(_place, folder, body.name, body.text)
            found = await _probes(request).run(probe_worker.dbc_signals, folder / f"{name}.part")
            await to_thread.run_sync((folder / f"{name}.part").replace, folder / name)
        except ConfigurationError as error:
            raise pointer_problem("/text", f"not {str(error).rpartition(' is not ')[2]}") from error
        except FileError as error:
            raise Problem(409, str(error)) from error
        finally:
            for part in folder.glob("*.dbc.part"):
                part.unlink(missing_ok=True)
    await trail.note(actor(request), "commissioning.dbc", name, f"{len(found)} signals")
    return json_response(DbcDocument(name=name, signals=found), 201)


@router.post(
    "/signals",
    response_model=SignalList,
    summary="Listen to a CAN bus",
    **secured(ADMIN, 409, audit=None),
)
async def post_signals(
    context: Context, request: Request, trail: Trail, body: SignalWatch
) -> Response:
    """Listen for a while, and show which signals of the DBC file really arrive."""
    source = _source(context, body.source, "can")
    await trail.note_repeated(actor(request), "commissioning.listen", _shown(body.source))
    return json_response(await _probes(request).run(probe_worker.signals, source, body.listen_s))


@router.post(
    "/check",
    response_model=CheckDocument,
    summary="Check a change before it is saved",
    **secured(ADMIN, 409, audit=None),
)
async def post_check(context: Context, request: Request, body: ConfigurationChange) -> Response:
    """Do what `bearing-twin check` does, with the file as it would be: nothing is kept."""
    file, text = await to_thread.run_sync(_changed, context, body)
    return json_response(await _probes(request).run(probe_worker.check, file, text))


@router.put(
    "/configuration",
    response_model=SavedDocument,
    summary="Save a change of the configuration file",
    **secured(ADMIN, 409, audit=None),
)
async def put_configuration(
    context: Context, request: Request, trail: Trail, body: ConfigurationChange
) -> Response:
    """Write sources and assets into the file; comments and all other sections stay.

    409 if the file was changed since it was read. The service then follows the new configuration
    by itself, where `takes_effect` says so: it is away for some seconds.
    """
    _, text = await to_thread.run_sync(_changed, context, body)
    names = [str(one.root.get("name")) for one in body.sources]
    ids = [str(one.root.get("id")) for one in body.assets]
    parts = (("sources", names), ("assets", ids))
    what = "; ".join(f"{key}: {', '.join(one[:_MOST_NAMES])}" for key, one in parts if one)
    return await _save(context, request, trail, text, body.revision, what)


@router.get(
    "/versions",
    response_model=VersionList,
    summary="Versions of the configuration file",
    **secured(ADMIN, 409),
)
def get_versions(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """List what was saved, by whom and when, newest first."""
    current = revision_of(read_file(_file(context)))
    known = versions(context.settings.data_dir)
    page, following = page_of(known, limit, cursor, lambda one: str(one.number))
    items = [VersionDocument.of(one, current) for one in page]
    return json_response(
        VersionList(items=items, next=following), headers=next_link(request, following)
    )


@router.post(
    "/versions/{number}/restore",
    response_model=SavedDocument,
    summary="Have an earlier version of the configuration file again",
    **secured(ADMIN, 404, 409, audit=None),
)
async def post_restore(
    context: Context,
    request: Request,
    trail: Trail,
    number: Annotated[int, Path(ge=1, le=10**9, description="Number of the version.")],
    body: VersionRestored,
) -> Response:
    """Save the text of an earlier version again; it becomes the newest one."""
    _file(context)
    known = await to_thread.run_sync(versions, context.settings.data_dir)
    version = next((one for one in known if one.number == number), None)
    if version is None:
        raise parameter_problem("number", f"there is no version {number}", 404)
    what = f"version {number} again"
    return await _save(context, request, trail, version.text, body.revision, what)


async def _save(
    context: ServiceContext, request: Request, trail: Trail, text: str, revision: str, what: str
) -> Response:
    file = _file(context)
    errors, warnings = await _probes(request).run(probe_worker.problems, file, text)
    if errors:
        raise Problem(422, errors[0], errors=[line_error(one) for one in errors])
    _refuse_provisioned(context, text)
    who = actor(request)
    keep = partial(
        save,
        file,
        context.settings.data_dir,
        text,
        based_on=revision,
        who=who.who,
        what=what,
        now_us=wall_us(),
    )
    try:
        version = await to_thread.run_sync(keep)
    except (FileChangedError, FileError) as error:
        raise Problem(409, str(error)) from error
    if version is not None:
        await trail.note(who, "configuration.save", file.name, what)
    answer = json_response(
        SavedDocument(
            revision=revision_of(text),
            changed=version is not None,
            takes_effect=_takes(context),
            warnings=list(warnings),
        )
    )
    if version is not None and context.apply_file is not None:
        answer.background = BackgroundTask(context.apply_file)  # once the caller has the answer
    return answer


def _changed(context: ServiceContext, body: ConfigurationChange) -> tuple[FilePath, str]:
    """Give the file, and the text that it would hold."""
    file = _file(context)
    text = read_file(file)
    if revision_of(text) != body.revision:
        raise Problem(409, "the configuration file has been changed meanwhile; read it again")
    in_file, _ = _lists(text)
    lines: list[str] = []
    for number, one in enumerate(body.sources):
        try:
            source_from_page(one.root, file.parent, f"sources[{number}]", in_file)
        except SettingsError as error:
            lines += error.lines
    if lines:
        raise Problem(422, lines[0], errors=[line_error(one) for one in lines])
    sources = [one.root for one in body.sources]
    try:
        return file, with_tables(text, sources, [one.root for one in body.assets])
    except SettingsError as error:
        raise Problem(422, error.lines[0]) from error


def _source(context: ServiceContext, table: SourceTable, *drivers: str) -> Any:
    file = _file(context)
    in_file, _ = _lists(read_file(file))
    try:
        config = source_from_page(table.root, file.parent, in_file=in_file)
    except SettingsError as error:
        lines = error.lines
        raise Problem(422, lines[0], errors=[line_error(one) for one in lines]) from error
    if config.driver not in drivers:
        raise pointer_problem(
            "/source/driver", f"{config.driver!r}: expected {' or '.join(drivers)}"
        )
    return config


def _refuse_provisioned(context: ServiceContext, text: str) -> None:
    """Refuse an asset that the store has too: the service could not tell which of them holds."""
    _, assets = _lists(text)
    stored = {one.id for one in context.store.assets.present()}
    both = [str(one.get("id")) for one in assets if one.get("id") in stored]
    if both:
        raise Problem(
            409, f"asset {both[0]!r} is provisioned already; remove it on the page Assets first"
        )


def _lists(text: str) -> tuple[list[TomlTable], list[TomlTable]]:
    """Sources and assets as the file writes them; none of a file that somebody is just editing."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return [], []
    sources, assets = document.get("sources", []), document.get("assets", [])
    return (
        [one for one in sources if isinstance(one, dict)],
        [one for one in assets if isinstance(one, dict)],
    )


def _file(context: ServiceContext) -> FilePath:
    why_not, file = _why_not(context), context.settings.file
    if why_not is not None or file is None:
        raise Problem(409, why_not or "there is no configuration file")
    return file


def _why_not(context: ServiceContext) -> str | None:
    if context.settings.file is None:
        return "the service was started without a configuration file; start it with -c FILE"
    if context.settings.is_fleet:
        return "several cells share the machines: change the configuration file on each of them"
    return None


def _takes(context: ServiceContext) -> Takes:
    return "after a restart" if context.apply_file is None else "at once"


def _place(folder: FilePath, name: str, text: str) -> str:
    """Write a file with `.part` behind its name; gives the name, with a number if it is taken."""
    stem = name.removesuffix(".dbc")
    number, free = 1, name
    while (folder / free).exists() and _differs(folder / free, text):
        number += 1
        free = f"{stem}-{number}.dbc"
    with replacing(folder / f"{free}.part") as part:
        part.write(text)
    return free


def _differs(file: FilePath, text: str) -> bool:
    return file.read_bytes() != text.encode()


def _probes(request: Request) -> Probes:
    probes: Probes = request.app.state.probes
    return probes


def _shown(source: SourceTable) -> str:
    table = source.root
    keys = ("driver", "host", "port", "device", "interface", "channel")
    return ", ".join(f"{key} {table[key]}" for key in keys if key in table)
