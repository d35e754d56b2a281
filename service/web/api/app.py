"""Puts the web side together."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import cache
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from pydantic.json_schema import JsonSchemaValue
from starlette.middleware import Middleware
from starlette.routing import BaseRoute

import service.web.pages
from service import __version__
from service.documents.messages import asyncapi_document
from service.feature_folders import modules
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.web.api.access import make_access_check
from service.web.api.context import ServiceContext
from service.web.api.docs import STREAM_PATH, install_docs
from service.web.api.http_forms import HttpForms
from service.web.api.middleware import (
    AccessGate,
    BodyLimit,
    Compression,
    Gunzip,
    JsonBodies,
    SecurityHeaders,
    UnhandledErrors,
)
from service.web.api.own_writes import OwnWrites
from service.web.api.page import packed_routes, page_route
from service.web.api.problems import install_handlers
from service.web.api.proxies import KnownProxies
from service.web.api.routes import measurements, routers
from service.web.api.snapshots import SnapshotShortcut
from service.web.api.turns import Turns
from service.web.pages.packing import packed_files

API_PREFIX = "/api/v1"
_DASHBOARD = Path(service.web.pages.__file__).parent / "static"
_DESCRIPTION = """
Digital twin of rolling bearings: measurements, estimated node temperatures, forecasts with
intervals, identification and alarms.

Times are RFC 3339 in UTC with milliseconds, in process time; with the virtual bench that may run
faster than the clock on the wall. Names end in their unit. Errors are problem documents
(RFC 9457) whose `errors` name the field. Listings are `{"items": [...], "next": cursor}`; `next`
is null on the last page, and a `Link` header points to the next one.
"""


def create_app(context: ServiceContext) -> FastAPI:
    """Make the web application of a service."""

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with contextlib.AsyncExitStack() as stack:
            for _, feature in modules("routes"):
                if hasattr(feature, "lifespan"):
                    await stack.enter_async_context(feature.lifespan(app))
            stack.callback(trail.settle)
            stack.callback(turns.close)
            stack.callback(context.bus.close)
            yield

    security = context.settings.security
    authenticator = Authenticator(
        context.store, security.failed_logins_per_minute, security.requests_per_minute
    )
    trail = AuditTrail(context.outbox)
    turns = Turns()
    app = _new_app(
        lifespan=lifespan,
        middleware=[
            Middleware(HttpForms),
            Middleware(KnownProxies, proxies=context.settings.service.trusted_proxies),
            Middleware(SecurityHeaders),
            Middleware(Compression, excluded=(measurements.PARQUET,)),
            Middleware(UnhandledErrors),
            Middleware(AccessGate, check=make_access_check(authenticator, trail)),
            Middleware(SnapshotShortcut, assets=context.assets),
            Middleware(JsonBodies),
            Middleware(BodyLimit),  # of what comes over the wire
            Middleware(Gunzip),
            Middleware(BodyLimit),
            Middleware(OwnWrites, changed=context.changed),
        ],
    )
    app.state.context = context
    app.state.authenticator = authenticator
    app.state.trail = trail
    app.state.turns = turns
    app.state.uploads = asyncio.Lock()
    install_handlers(app)
    _add_routes(app)
    app.router.routes.append(page_route(_DASHBOARD))
    app.router.routes.extend(packed_routes(packed_files(_DASHBOARD)))
    app.frontend("/", directory=_DASHBOARD, fallback=None)
    return app


def descriptions() -> dict[str, JsonSchemaValue]:
    """Describe REST interface and stream, without a service: by the name of the file."""
    app = _new_app()
    _add_routes(app)
    return {
        "openapi.json": app.openapi(),
        "asyncapi.json": asyncapi_document(app.version, STREAM_PATH),
    }


def _new_app(**options: Any) -> FastAPI:
    return FastAPI(
        title="Bearing Twin",
        version=__version__,
        description=_DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        telemetry={
            "tracing": False,
            "metrics": False,
            "logs": False,
            "operation_spans": False,
            "auto_configure": False,
        },
        **options,
    )


def _add_routes(app: FastAPI) -> None:
    app.router.routes.extend(_routes())
    install_docs(app)


@cache
def _routes() -> list[BaseRoute]:
    """Every route; what FastAPI finds out about each it finds out once in a process."""
    routes = APIRouter()
    features = {name: module.router for name, module in modules("routes")}
    for name, router in sorted((routers() | features).items()):
        # Probes of supervisors and proxies have their usual addresses.
        routes.include_router(router, prefix="" if name == "health" else API_PREFIX)
    return routes.routes
