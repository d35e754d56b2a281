"""Commissioning: a bench is put into service from the page; the result is the configuration file.

What asks a device runs in a process of its own (`probes.py` here). Nothing is ever written
to a device.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Annotated, Final

from anyio import to_thread
from fastapi import APIRouter, FastAPI, Path
from starlette.background import BackgroundTask
from starlette.requests import Request
from starlette.responses import Response

from adapters.configuration import ConfigurationError
from service.clock import wall_us
from service.documents.checks import CheckDocument
from service.domain.roles import ADMIN
from service.features.commissioning import probe_worker
from service.features.commissioning.configuration_file import (
    changed_text,
    file_of,
    file_to_save,
    lists_of,
    refuse_provisioned,
    source_of,
    stored_tables,
    takes_effect,
    why_not,
    why_not_saved,
)
from service.features.commissioning.dbc_files import place_dbc
from service.features.commissioning.documents import (
    CatalogueBearing,
    CommissioningDocument,
    DbcDocument,
    RegisterList,
    SavedDocument,
    SignalList,
    UnitList,
    VersionDocument,
    VersionList,
)
from service.features.commissioning.file_versions import (
    FileChangedError,
    read_file,
    revision_of,
    save,
    versions,
)
from service.features.commissioning.probes import Probes
from service.features.commissioning.requests import (
    ConfigurationChange,
    DbcUpload,
    RegisterRead,
    SignalWatch,
    SourceTable,
    UnitScan,
    VersionRestored,
)
from service.files import FileError
from service.web.api.access import actor, secured
from service.web.api.context import ServiceContext
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, Trail, json_response
from service.web.api.middleware import KIB, Upload
from service.web.api.problems import Problem, line_error, parameter_problem, pointer_problem
from twin_core.bearings import CATALOGUE

_MOST_NAMES: Final = 100
#: A check connects to each source: no scan of a network.
STRANGE_SOURCES_MAX: Final = 8
_MODBUS: Final = ("modbus-tcp", "modbus-rtu")

router = APIRouter(prefix="/commissioning", tags=["commissioning"])
UPLOADS = (
    Upload("/commissioning/dbc", 8192 * KIB),
    Upload("/commissioning/(?:check|configuration)", 1024 * KIB),
)


@asynccontextmanager
async def lifespan(app: FastAPI) -> AsyncIterator[None]:
    """End the process that asks devices with the application."""
    try:
        yield
    finally:
        close(app)


def close(app: FastAPI) -> None:
    """End the process that asks devices, if there is one."""
    if hasattr(app.state, "probes"):
        app.state.probes.close()


@router.get(
    "",
    response_model=CommissioningDocument,
    summary="Get sources and assets of the configuration file",
    **secured(ADMIN),
)
def get_commissioning(context: Context) -> Response:
    """Give sources and assets of the file as it is now, and the bearings of the catalogue."""
    file = context.settings.file
    text, reason = "", why_not(context) or why_not_saved(context)
    if file is not None:
        text = read_file(file)
    sources, assets = lists_of(text)
    return json_response(
        CommissioningDocument(
            file=None if file is None else file.name,
            why_not=reason,
            takes_effect=takes_effect(context),
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
    summary="Scan the units of a Modbus source",
    **secured(ADMIN, 409, audit=None),
)
async def post_units(context: Context, request: Request, trail: Trail, body: UnitScan) -> Response:
    """Read the first register of each unit; at most half a second is given to one."""
    source = source_of(context, body.source, *_MODBUS)
    await trail.note_repeated(actor(request), "commissioning.scan", _shown(body.source))
    probes = _probes(request)
    return json_response(await probes.run(probe_worker.units, source, body.first, body.count))


@router.post(
    "/registers",
    response_model=RegisterList,
    summary="Read Modbus registers in every type and order",
    **secured(ADMIN, 409, audit=None),
)
async def post_registers(
    context: Context, request: Request, trail: Trail, body: RegisterRead
) -> Response:
    """Read a block of registers once. A register that is not there has no values."""
    source = source_of(context, body.source, *_MODBUS)
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
    """Put a DBC file next to the configuration file, and list its signals.

    A file that is there already and holds something else stays as it is: earlier configurations
    name it. The new one then has a number behind its name.
    """
    folder = file_to_save(context).resolve().parent
    turn: asyncio.Lock = request.app.state.uploads
    async with turn:  # two of the same name take two names
        try:
            name = await to_thread.run_sync(place_dbc, folder, body.name, body.text)
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
    source = source_of(context, body.source, "can")
    await trail.note_repeated(actor(request), "commissioning.listen", _shown(body.source))
    return json_response(await _probes(request).run(probe_worker.signals, source, body.listen_s))


@router.post(
    "/check",
    response_model=CheckDocument,
    summary="Check a configuration change",
    **secured(ADMIN, 409, audit=None),
)
async def post_check(
    context: Context, request: Request, trail: Trail, body: ConfigurationChange
) -> Response:
    """Do what `bearing-twin check` does, with the file as it would be: nothing is kept.

    At most 8 sources that are not in the file as they are given; the check asks each of them.
    """
    in_file, _ = lists_of(await to_thread.run_sync(read_file, file_of(context)))
    strange = [one for one in body.sources if one.root not in in_file]
    if len(strange) > STRANGE_SOURCES_MAX:
        raise pointer_problem(
            "/sources",
            f"{len(strange)} sources that are not in the file; expected at most "
            f"{STRANGE_SOURCES_MAX} in one check: save some of them first",
        )
    shown = "; ".join(_shown(one) for one in strange) or "the sources of the file"
    await trail.note_repeated(actor(request), "commissioning.check", shown)
    file, text = await to_thread.run_sync(changed_text, context, body)
    stored = await to_thread.run_sync(stored_tables, context)
    return json_response(await _probes(request).run(probe_worker.check, file, text, stored))


@router.put(
    "/configuration",
    response_model=SavedDocument,
    summary="Save a configuration change",
    **secured(ADMIN, 409, audit=None),
)
async def put_configuration(
    context: Context, request: Request, trail: Trail, body: ConfigurationChange
) -> Response:
    """Write sources and assets into the file; comments and all other sections stay.

    409 if the file was changed since it was read. The service then follows the new configuration
    on its own, where `takes_effect` says so: it is away for some seconds.
    """
    _, text = await to_thread.run_sync(changed_text, context, body)
    names = [str(one.root.get("name")) for one in body.sources]
    ids = [str(one.root.get("id")) for one in body.assets]
    parts = (("sources", names), ("assets", ids))
    what = "; ".join(f"{key}: {', '.join(one[:_MOST_NAMES])}" for key, one in parts if one)
    return await _save(context, request, trail, text, body.revision, what)


@router.get(
    "/versions",
    response_model=VersionList,
    summary="List versions of the configuration file",
    **secured(ADMIN, 409),
)
def get_versions(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """List what was saved, by whom and when, newest first."""
    current = revision_of(read_file(file_of(context)))
    known = versions(context.settings.data_dir)
    page, following = page_of(known, limit, cursor, lambda one: str(one.number))
    items = [VersionDocument.of(one, current) for one in page]
    return json_response(
        VersionList(items=items, next=following), headers=next_link(request, following)
    )


@router.post(
    "/versions/{number}/restore",
    response_model=SavedDocument,
    summary="Restore a version of the configuration file",
    **secured(ADMIN, 404, 409, audit=None),
)
async def post_restore(
    context: Context,
    request: Request,
    trail: Trail,
    number: Annotated[int, Path(ge=1, le=10**9, description="Number of the version.")],
    body: VersionRestored,
) -> Response:
    """Save the text of an earlier version; it becomes the newest version."""
    file_to_save(context)
    known = await to_thread.run_sync(versions, context.settings.data_dir)
    version = next((one for one in known if one.number == number), None)
    if version is None:
        raise parameter_problem("number", f"there is no version {number}", 404)
    what = f"version {number} again"
    return await _save(context, request, trail, version.text, body.revision, what)


async def _save(
    context: ServiceContext, request: Request, trail: Trail, text: str, revision: str, what: str
) -> Response:
    file = file_to_save(context)
    stored = await to_thread.run_sync(stored_tables, context)
    errors, warnings = await _probes(request).run(probe_worker.problems, file, text, stored)
    if errors:
        raise Problem(422, errors[0], errors=[line_error(one) for one in errors])
    refuse_provisioned(context, text)
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
            takes_effect=takes_effect(context),
            warnings=list(warnings),
        )
    )
    if version is not None and context.apply_file is not None:
        answer.background = BackgroundTask(context.apply_file)  # once the caller has the answer
    return answer


def _probes(request: Request) -> Probes:
    state = request.app.state
    if not hasattr(state, "probes"):
        state.probes = Probes()
    probes: Probes = state.probes
    return probes


def _shown(source: SourceTable) -> str:
    table = source.root
    keys = ("driver", "host", "port", "device", "interface", "channel")
    return ", ".join(f"{key} {table[key]}" for key in keys if key in table)
