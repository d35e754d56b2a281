"""Logging a browser in and out."""

from fastapi import APIRouter
from pydantic import ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from service.documents.access import SessionDocument
from service.domain.requests import RequestBody
from service.domain.roles import VIEWER
from service.security.authenticator import LONGEST_SESSION_S, Authenticator
from service.store import StoreUnavailableError
from service.web.api.access import (
    Caller,
    actor,
    cookie_name,
    is_secure,
    new_key,
    public,
    secured,
    too_many,
    unauthorized,
)
from service.web.api.deps import Keys, Trail, json_response
from service.web.api.problems import RETRY_AFTER_S, Problem
from service.web.api.trail import ChangeLine

# The service forgets a session 12 h after its last use; the browser may keep the cookie longer.
_COOKIE_AGE_S = LONGEST_SESSION_S

router = APIRouter(prefix="/session", tags=["session"])


class LogIn(RequestBody):
    """The key that opens the session."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"key": "bt_1a2b3c4d_…"}]})

    key: str = Field(max_length=200, description="An API key.")


@router.post(
    "", response_model=SessionDocument, summary="Log in", **public(401, 403, 422, 429, 503)
)
async def log_in(request: Request, body: LogIn, keys: Keys, trail: Trail) -> Response:
    """Open a browser session; it ends 12 h after its last use, after a week, or with its key."""
    try:
        if keys.is_in_use(body.key):  # others' wrong log-ins from the same address do not count
            principal = await keys.by_key(body.key)
        else:
            principal = await new_key(request, keys, body.key, trail, "session.refuse")
        if principal is None:
            raise unauthorized(request)
        _take_turn(keys, principal.key_id)
        if principal.role not in VIEWER:
            who = actor(request, principal.who)
            await trail.note_repeated(who, "session.refuse", "its role opens no browser session")
            raise Problem(403, f"a key of role {principal.role} opens no browser session")
        cookie, principal = await keys.log_in(principal)
    except StoreUnavailableError as error:
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(503, "the store of the keys does not answer", headers=headers) from (error)
    await trail.note_repeated(actor(request, principal.who), "session.begin")
    response = json_response(SessionDocument.of(principal))
    response.set_cookie(
        cookie_name(request),
        cookie,
        max_age=_COOKIE_AGE_S,
        path="/",
        secure=is_secure(request),
        httponly=True,
        samesite="strict",
    )
    return response


@router.get(
    "", response_model=SessionDocument, summary="Get the current session", **secured(VIEWER)
)
async def get_session(who: Caller) -> Response:
    """Role and expiry of the session, or of the key that came instead."""
    return json_response(SessionDocument.of(who))


@router.delete("", status_code=204, summary="Log out", **secured(VIEWER, audit="session.end"))
async def log_out(request: Request, keys: Keys, line: ChangeLine) -> Response:
    """End the session of the cookie, here and now."""
    name = cookie_name(request)
    cookie = request.cookies.get(name)
    if cookie:
        await keys.log_out(cookie, line)
    response = Response(status_code=204)
    response.delete_cookie(
        name, path="/", secure=is_secure(request), httponly=True, samesite="strict"
    )
    return response


def _take_turn(keys: Authenticator, key_id: str) -> None:
    """Count a log-in with a key; each writes to the store."""
    wait_s = keys.logins.wait_s(key_id)
    if wait_s:
        raise too_many("too many log-ins with this key", wait_s)
    keys.logins.count(key_id)
