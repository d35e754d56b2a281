"""Puts the web side together."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from pydantic.json_schema import JsonSchemaValue
from starlette.middleware import Middleware

import service.web.pages
from service.documents.messages import asyncapi_document
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.web.api.access import make_access_check
from service.web.api.context import ServiceContext
from service.web.api.docs import STREAM_PATH, install_docs
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
from service.web.api.page import page_route
from service.web.api.problems import install_handlers
from service.web.api.proxies import KnownProxies
from service.web.api.routes import measurements, routers
from service.web.api.snapshots import SnapshotShortcut
from service.web.api.turns import Turns
from service.web.probes import Probes

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
    """Make the web application of a service.

    Parameters
    ----------
    context : ServiceContext
        What it leans on.
    """

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        try:
            yield
        finally:
            context.bus.close()
            turns.close()
            probes.close()
            trail.settle()

    security = context.settings.security
    authenticator = Authenticator(
        context.store, security.failed_logins_per_minute, security.requests_per_minute
    )
    trail = AuditTrail(context.outbox)
    turns = Turns()
    probes = Probes()
    app = _new_app(
        lifespan=lifespan,
        middleware=[
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
    app.state.probes = probes
    app.state.uploads = asyncio.Lock()
    install_handlers(app)
    _take_in_routes(app)
    app.router.routes.append(page_route(_DASHBOARD / "index.html"))
    app.frontend("/", directory=_DASHBOARD, fallback=None)
    return app


def descriptions() -> dict[str, JsonSchemaValue]:
    """Describe REST interface and stream, without a service: by the name of the file."""
    app = _new_app()
    _take_in_routes(app)
    return {
        "openapi.json": app.openapi(),
        "asyncapi.json": asyncapi_document(app.version, STREAM_PATH),
    }


def _new_app(**options: Any) -> FastAPI:
    return FastAPI(
        title="Bearing Twin",
        version=version("bearing-twin"),
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


def _take_in_routes(app: FastAPI) -> None:
    for name, router in routers().items():
        # Probes of supervisors and proxies have their usual addresses.
        app.include_router(router, prefix="" if name == "health" else API_PREFIX)
    install_docs(app)
