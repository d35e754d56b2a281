"""Puts the web side together."""

import contextlib
from collections.abc import AsyncIterator
from importlib.metadata import version
from pathlib import Path

from fastapi import FastAPI
from starlette.middleware import Middleware

import service.web.pages
from service.security import AuditTrail, Authenticator
from service.web.api.access import make_door
from service.web.api.context import ServiceContext
from service.web.api.docs import install_docs
from service.web.api.middleware import (
    AtTheDoor,
    BodyLimit,
    Gunzip,
    JsonBodies,
    LastResort,
    Packing,
    SecurityHeaders,
)
from service.web.api.page import page_route
from service.web.api.problems import install_handlers
from service.web.api.proxies import KnownProxies
from service.web.api.routes import (
    advice,
    alarm_journal,
    alarms,
    assets,
    audit,
    drift,
    envelope,
    forecasts,
    health,
    identifications,
    keys,
    measurements,
    models,
    session,
    stream,
)
from service.web.api.snapshots import SnapshotShortcut
from service.web.api.trail import Trail
from service.web.api.turns import Turns

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
            trail.settle()

    security = context.settings.security
    authenticator = Authenticator(
        context.store, security.failed_logins_per_minute, security.requests_per_minute
    )
    trail = AuditTrail(context.outbox)
    turns = Turns()
    app = FastAPI(
        title="Bearing Twin",
        version=version("bearing-twin"),
        description=_DESCRIPTION,
        lifespan=lifespan,
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
        middleware=[
            Middleware(KnownProxies, proxies=context.settings.service.trusted_proxies),
            Middleware(SecurityHeaders),
            Middleware(Packing, excluded=(measurements.PARQUET,)),
            Middleware(LastResort),
            Middleware(AtTheDoor, door=make_door(authenticator, trail)),
            Middleware(SnapshotShortcut, assets=context.assets),
            Middleware(JsonBodies),
            Middleware(BodyLimit),  # of what comes over the wire
            Middleware(Gunzip),
            Middleware(BodyLimit),
            Middleware(Trail, trail=trail),
        ],
    )
    app.state.context = context
    app.state.authenticator = authenticator
    app.state.trail = trail
    app.state.turns = turns
    install_handlers(app)
    for module in (
        assets,
        measurements,
        forecasts,
        envelope,
        advice,
        identifications,
        models,
        drift,
        alarm_journal,
        alarms,
        session,
        keys,
        audit,
        stream,
    ):
        app.include_router(module.router, prefix=API_PREFIX)
    app.include_router(health.router)
    install_docs(app)
    app.router.routes.append(page_route(_DASHBOARD / "index.html"))
    app.frontend("/", directory=_DASHBOARD, fallback=None)
    return app
