"""Who may make which call: credentials at the access gate, roles at each route.

The access gate (`make_access_check`) knows only who is calling, and refuses an unknown caller
everything below ``/api``; each route says by `secured` which roles it is for. OpenAPI shows both.
"""

import base64
import binascii
import math
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Final, TypedDict
from urllib.parse import urlsplit

from fastapi import Depends, params
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute
from starlette.requests import HTTPConnection, Request
from starlette.types import Scope

from service.bus.asking import caller_role, on_behalf_of
from service.clock import wall_us
from service.domain.roles import Roles
from service.security import failed_logins
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator, Principal
from service.security.keys import Actor, key_prefix
from service.security.sites import site_of
from service.store import StoreUnavailableError
from service.web.api.problems import MEDIA_TYPE, RETRY_AFTER_S, Problem, parameter_problem

SESSION_PATH = "/api/v1/session"
KEY_HEADER = "X-API-Key"
SUBPROTOCOL_PREFIX = "bearer."
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_PRINCIPAL = "bearing_twin.principal"
_NAME_MAX = 100
#: Extension of OpenAPI that holds what the audit trail calls a change.
AUDIT = "x-audit"

SECURITY_SCHEMES: Final = {
    "key": {"type": "apiKey", "in": "header", "name": KEY_HEADER},
    "basic": {
        "type": "http",
        "scheme": "basic",
        "description": "For clients that cannot send a header: any user, the key as password.",
    },
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": "bearing_twin_PORT",
        "description": f"Browser session opened by `POST {SESSION_PATH}`; over HTTPS the name "
        "begins with `__Host-`.",
    },
}
_ANY_SCHEME: Final[list[dict[str, list[str]]]] = [{name: []} for name in SECURITY_SCHEMES]

_DESCRIPTIONS: Final = {
    400: "The request cannot be read: body, or NUL in the address.",
    401: "No key, or no valid key.",
    403: "The role of this key is not sufficient.",
    404: "Not found.",
    409: "In conflict with the present state.",
    412: "A condition in a header does not hold.",
    413: "The body is too long.",
    415: "The body is of another media type, or compressed by another method than gzip.",
    422: "A field is wrong; `errors` names it.",
    426: "This address accepts WebSocket connections only.",
    429: "Too many requests of this key, or wrong keys from this address; see `Retry-After`.",
    500: "Internal error; the log of the service has the reason.",
    503: "Temporarily unavailable; see `Retry-After`.",
}
RETRY_AFTER: Final = {
    "Retry-After": {
        "description": "Seconds to wait before the next try.",
        "schema": {"type": "integer", "minimum": 1},
    }
}
LOCATION: Final = {
    "Location": {"description": "Address of the new resource.", "schema": {"type": "string"}}
}


Responses = dict[int | str, dict[str, Any]]
"""Answers of a route by status, as FastAPI takes them."""


class RouteArguments(TypedDict):
    """What a route is declared with; see `fastapi.APIRouter.get`."""

    dependencies: list[params.Depends]
    responses: Responses
    openapi_extra: dict[str, Any]


def problems(*statuses: int) -> Responses:
    """Describe error answers for OpenAPI."""
    schema = {"$ref": "#/components/schemas/ProblemDocument"}
    return {
        status: {
            "description": _DESCRIPTIONS[status],
            "content": {MEDIA_TYPE: {"schema": schema}},
            **({"headers": RETRY_AFTER} if status in (429, 503) else {}),
        }
        for status in statuses
    }


def secured(
    roles: Roles,
    *statuses: int,
    responses: Responses | None = None,
    audit: str | None = "",
) -> RouteArguments:
    """Arguments of a route that only these roles may call.

    - ``statuses``: error statuses besides 401, 403, 422, 429 and 503 that the route answers with.
    - ``audit``: what the audit trail calls a call that may change something; by default after the
      path's last two words, None where nothing changes or the route writes its own line.
    """
    return {
        "dependencies": [Depends(require(roles))],
        "responses": {**problems(401, 403, 422, 429, 503, *statuses), **(responses or {})},
        "openapi_extra": {"security": _ANY_SCHEME, "x-roles": sorted(roles), AUDIT: audit},
    }


def public(*statuses: int, responses: Responses | None = None) -> RouteArguments:
    """Arguments of a route that needs no key."""
    return {
        "dependencies": [],
        "responses": {**problems(*statuses), **(responses or {})},
        "openapi_extra": {"security": [], AUDIT: None},
    }


def require(roles: Roles) -> Callable[[HTTPConnection], Coroutine[Any, Any, Principal]]:
    """Make a dependency that lets only these roles pass."""

    async def caller_with_role(connection: HTTPConnection) -> Principal:
        principal = await caller(connection)
        if principal.role not in roles:
            raise Problem(
                403,
                f"a key of role {principal.role} may not do this, "
                f"expected {' or '.join(sorted(roles))}",
            )
        if connection.scope["query_string"] and connection.scope["path"].startswith("/api/"):
            route = connection.scope.get("route")
            if isinstance(route, APIRoute):
                refuse_odd_query(connection, _parameters(route.dependant))
        return principal

    return caller_with_role


def known_caller(scope: Scope) -> Principal | None:
    """Who is calling, as the access gate found out; None for an unknown caller."""
    principal = scope.get(_PRINCIPAL)
    return principal if isinstance(principal, Principal) else None


def refuse_odd_query(connection: HTTPConnection, parameters: Mapping[str, bool]) -> None:
    """Refuse a query with a parameter that the call does not have, or that comes too often.

    What is not known would be ignored, and the answer be that to another question.

    Parameters
    ----------
    connection
        What was asked.
    parameters
        Those of the call, each with whether it may come several times.

    Raises
    ------
    Problem
        With status 422.
    """
    times = Counter(name for name, _ in connection.query_params.multi_items())
    for name, count in times.items():
        if name not in parameters:
            near = get_close_matches(name.lower(), parameters, 1, 0.75)
            known = ", ".join(near or sorted(parameters)) or "none"
            raise parameter_problem(name[:_NAME_MAX], f"no such parameter; expected {known}")
        if count > 1 and not parameters[name]:
            raise parameter_problem(name, "expected once")


def _parameters(dependant: Dependant) -> dict[str, bool]:
    """Give the query parameters of a route and of what it depends on; whether each is a list."""
    found = {
        field.alias: "list[" in str(field.field_info.annotation) for field in dependant.query_params
    }
    for below in dependant.dependencies:
        found |= _parameters(below)
    return found


async def caller(connection: HTTPConnection) -> Principal:
    """Who is calling, as the access gate found out."""
    principal = known_caller(connection.scope)
    if principal is None:
        raise unauthorized(connection)
    return principal


Caller = Annotated[Principal, Depends(caller)]


def actor(connection: HTTPConnection, who: str | None = None) -> Actor:
    """Who changes something, for the audit trail; `who` where the access gate does not know."""
    principal = connection.scope.get(_PRINCIPAL)
    if who is None:
        who = principal.who if isinstance(principal, Principal) else "unknown"
    return Actor(who, address_of(connection))


def address_of(connection: HTTPConnection) -> str:
    """Network address of the caller; behind a proxy on this machine, the one that it names."""
    return connection.client.host if connection.client else ""


def make_access_check(
    authenticator: Authenticator, trail: AuditTrail
) -> Callable[[Request], Coroutine[Any, Any, None]]:
    """Make the check that every request passes before anything else happens to it."""

    async def check(request: Request) -> None:
        if not request.scope["path"].startswith("/api/"):
            return
        if "\x00" in request.scope["path"] or b"%00" in request.scope["query_string"]:
            raise Problem(400, "expected an address without the character NUL")
        if request.scope["path"] == SESSION_PATH and request.method == "POST":
            if not is_same_origin(request, unknown_is=True):
                raise _cross_site()
            return
        principal = await authenticate(request, authenticator, trail)
        if principal is None:
            raise unauthorized(request)
        wait_s = authenticator.requests.wait_s(principal.key_id)
        if wait_s:
            limit = authenticator.requests.per_minute
            raise too_many(f"more than {limit:g} requests a minute with this key", wait_s)
        authenticator.requests.count(principal.key_id)
        if request.method not in SAFE_METHODS:
            refuse_other_sites(request, principal)
        request.scope[_PRINCIPAL] = principal
        # The cell checks it again.
        caller_role.set(principal.role)
        on_behalf_of.set(principal.key_id)

    return check


async def authenticate(
    connection: HTTPConnection, authenticator: Authenticator, trail: AuditTrail | None = None
) -> Principal | None:
    """Who is calling, by header, Basic password, subprotocol or session cookie; None if unknown.

    Raises `Problem` with status 429 after too many wrong keys, with 503 when the store does not
    answer.
    """
    try:
        key = offered_key(connection)
        if key is None:
            cookie = connection.cookies.get(cookie_name(connection))
            return await _by_session(connection, authenticator, cookie) if cookie else None
        if key_prefix(key) is None:  # no guess, and nothing to look up
            return None
        if authenticator.knows(key):  # also a wrong one: a client that goes on costs nothing
            return await authenticator.by_key(key)
        return await new_key(connection, authenticator, key, trail, failed_logins.REFUSED)
    except StoreUnavailableError as error:
        raise Problem(
            503,
            "the store of the keys does not answer",
            headers={"Retry-After": str(RETRY_AFTER_S)},
        ) from error


async def caller_by_now(
    connection: HTTPConnection, authenticator: Authenticator, principal: Principal
) -> Principal | None:
    """Who a caller is by now that was let in as `principal`; None when the right has ended.

    The limits of strangers are not its own: it is looked up, whatever others at its address send.
    """
    try:
        key = offered_key(connection)
        if key is not None:
            return await authenticator.by_key(key)
        cookie = connection.cookies.get(cookie_name(connection))
        return await authenticator.by_session(cookie) if cookie else None
    except StoreUnavailableError:  # a caller that was let in stays
        return None if principal.is_over(wall_us()) else principal


async def _by_session(
    connection: HTTPConnection, authenticator: Authenticator, cookie: str
) -> Principal | None:
    """Look up a session; an address has a limited number of unknown ones."""
    if authenticator.knows_session(cookie):
        return await authenticator.by_session(cookie)
    site = site_of(address_of(connection))
    wait_s = authenticator.strangers.wait_s(site)
    if wait_s:
        raise too_many("too many unknown sessions from this address", wait_s)
    principal = await authenticator.by_session(cookie)
    if principal is None:
        authenticator.strangers.count(site)
    return principal


async def new_key(
    connection: HTTPConnection,
    authenticator: Authenticator,
    key: str,
    trail: AuditTrail | None,
    action: str,
) -> Principal | None:
    """Look up a key that may be a guess: an address has a limited number of them.

    Raises `Problem` with status 429 after too many wrong keys; `StoreUnavailableError` when the
    store does not answer.
    """
    address = address_of(connection)
    wait_s = failed_logins.wait_s(authenticator, action, address)
    if wait_s:
        raise too_many("too many wrong keys from this address", wait_s)
    principal = await authenticator.by_key(key)
    if principal is None:
        failed_logins.count_wrong_key(authenticator, action, address)
        if trail is not None:
            await failed_logins.note_wrong_key(trail, action, address, key)
    return principal


def too_many(detail: str, wait_s: float) -> Problem:
    """Build the problem of a caller who must wait."""
    return Problem(429, detail, headers={"Retry-After": str(math.ceil(wait_s))})


def offered_key(connection: HTTPConnection) -> str | None:
    """Give the key that comes by header, Basic password or, on a WebSocket, as subprotocol."""
    by_protocol = subprotocol_key(connection)
    if by_protocol is not None:
        return by_protocol[0]
    return connection.headers.get(KEY_HEADER) or _basic_password(connection)


def cookie_name(connection: HTTPConnection) -> str:
    """Name of the session cookie: browsers share cookies between the ports of a host."""
    port = connection.url.port
    secure = is_secure(connection)
    if port is None:
        port = 443 if secure else 80
    # The prefix has browsers refuse it from any other host, and without encryption.
    return f"{'__Host-' if secure else ''}bearing_twin_{port}"


def is_secure(connection: HTTPConnection) -> bool:
    """Whether the caller talks HTTPS, to the service or to a proxy before it."""
    return connection.url.scheme in ("https", "wss")


def refuse_other_sites(connection: HTTPConnection, principal: Principal) -> None:
    """Refuse what another site's page has a browser send, whatever the credential is.

    Browsers keep a Basic password as they keep a cookie, and send it for any site's form. Raises
    `Problem` with status 403.
    """
    if principal.session:
        allowed = is_same_origin(connection, unknown_is=False)
    else:
        allowed = is_same_origin(connection, unknown_is=True, by_hand_is=True)
    if not allowed:
        raise _cross_site()


def is_same_origin(
    connection: HTTPConnection, *, unknown_is: bool, by_hand_is: bool = False
) -> bool:
    """Whether a browser sent this from our own page.

    ``unknown_is``: the answer for a caller that says nothing, as programs do; ``by_hand_is``: the
    answer for a request that no page has caused.
    """
    site = connection.headers.get("Sec-Fetch-Site")
    if site is not None:
        return site == "same-origin" or (site == "none" and by_hand_is)
    origin = connection.headers.get("Origin")
    if origin is None:
        return unknown_is
    try:
        return urlsplit(origin).netloc == connection.headers.get("Host")
    except ValueError:  # no address at all
        return False


def unauthorized(connection: HTTPConnection) -> Problem:
    """Build the problem of a caller without a valid key."""
    # A browser must not ask for a password: it would send it with the requests of other sites'
    # pages, too. Programs learn that Basic works.
    by_browser = "Sec-Fetch-Mode" in connection.headers or "Origin" in connection.headers
    challenge = f'{"ApiKey" if by_browser else "Basic"} realm="Bearing Twin"'
    return Problem(
        401,
        f"expected a valid key in the header {KEY_HEADER}, as HTTP Basic password, "
        "or a browser session",
        headers={"WWW-Authenticate": challenge},
    )


def subprotocol_key(connection: HTTPConnection) -> tuple[str, str] | None:
    """Key and full name of the subprotocol ``bearer.<key>``, if one is offered."""
    offered: list[str] = connection.scope.get("subprotocols", [])
    for protocol in offered:
        if protocol.startswith(SUBPROTOCOL_PREFIX):
            return protocol.removeprefix(SUBPROTOCOL_PREFIX), protocol
    return None


def _cross_site() -> Problem:
    return Problem(403, "a browser may do this from the service's own page only")


def _basic_password(connection: HTTPConnection) -> str | None:
    scheme, _, credentials = connection.headers.get("Authorization", "").partition(" ")
    if scheme.lower() != "basic":
        return None
    try:
        decoded = base64.b64decode(credentials.strip(), validate=True).decode()
    except (binascii.Error, UnicodeDecodeError):
        return ""
    return decoded.partition(":")[2]
