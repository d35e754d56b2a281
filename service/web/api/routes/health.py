"""Is it alive, is it ready, and the metrics."""

import socket
from typing import Literal

import structlog
from anyio import to_thread
from fastapi import APIRouter
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from starlette.requests import Request
from starlette.responses import Response

from service.documents.health import Alive, Ready, ReadyCheck
from service.domain.roles import VIEWER
from service.security.loopback import is_address, is_loopback
from service.web.api.access import authenticate, problems, public, unauthorized
from service.web.api.deps import Context, Keys, json_response
from service.web.api.problems import RETRY_AFTER_S, Problem

router = APIRouter(tags=["health"])

_log = structlog.get_logger(__name__)


@router.get("/livez", response_model=Alive, summary="Liveness: the process answers", **public())
async def livez() -> Response:
    """Answer 200 while the process runs."""
    return json_response(Alive())


@router.get(
    "/readyz",
    response_model=Ready,
    summary="Readiness: the service works",
    **public(responses={503: {"model": Ready, "description": "The store or a twin is down."}}),
)
async def readyz(context: Context, request: Request, keys: Keys) -> Response:
    """List the checks; without a key they carry no details.

    A broken sensor or source degrades the service, it does not fail it.
    """
    checks = context.health.checks()
    statuses = {check.status for check in checks}
    ready = "failed" not in statuses
    overall: Literal["ready", "degraded", "not ready"] = (
        ("degraded" if "degraded" in statuses else "ready") if ready else "not ready"
    )
    detailed = await _may_see_details(request, keys)
    shown = [
        ReadyCheck(name=check.name, status=check.status, detail=check.detail if detailed else None)
        for check in checks
    ]
    retry = {} if ready else {"Retry-After": str(RETRY_AFTER_S)}
    return json_response(Ready(status=overall, checks=shown), 200 if ready else 503, retry)


# Many probes only ask for the head.
for _path, _probe in (("/livez", livez), ("/readyz", readyz)):
    router.add_api_route(_path, _probe, methods=["HEAD"], include_in_schema=False)


@router.get(
    "/metrics",
    response_class=Response,
    summary="Metrics for Prometheus",
    responses={
        200: {"content": {CONTENT_TYPE_LATEST: {"schema": {"type": "string"}}}},
        **problems(401, 403, 429, 503),
    },
    openapi_extra={
        "security": [{}, {"key": []}, {"basic": []}, {"session": []}],
        "x-roles": sorted(VIEWER),
    },
)
async def metrics(context: Context, request: Request, keys: Keys) -> Response:
    """Give all metrics; on loopback, or where the configuration allows it, without a key."""
    allowed = context.settings.security.allow_unauthenticated_metrics or _is_local(request)
    if not allowed:
        principal = await authenticate(request, keys)
        if principal is None:
            raise unauthorized(request)
        if principal.role not in VIEWER:
            raise Problem(403, f"a key of role {principal.role} may not read the metrics")
    cells = await to_thread.run_sync(context.health.metrics)
    own = await to_thread.run_sync(generate_latest, context.registry)
    return Response(cells + own, media_type=CONTENT_TYPE_LATEST)


async def _may_see_details(request: Request, keys: Keys) -> bool:
    try:
        principal = await authenticate(request, keys)
    except Problem:
        return False
    return principal is not None and principal.role in VIEWER


_OF_A_PROXY = (
    "Forwarded",
    "Via",
    "X-Forwarded-For",
    "X-Forwarded-Host",
    "X-Forwarded-Proto",
    "X-Real-IP",
)


def _is_local(request: Request) -> bool:
    """Whether the caller sits on this machine, and not only a proxy on its behalf.

    A page of another site can have its name lead here (DNS rebinding): the name that was asked for
    is this machine's own, or an address.
    """
    if request.client is None or any(name in request.headers for name in _OF_A_PROXY):
        return False
    name = (request.url.hostname or "").lower().removesuffix(".")
    own = name in ("localhost", socket.gethostname().lower()) or is_address(name)
    return own and is_loopback(request.client.host)
