"""The live stream: numbered messages over WebSocket, resumed after a break."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Coroutine
from typing import Annotated, Any

import structlog
from fastapi import APIRouter, Query
from pydantic_core import to_json
from starlette.responses import Response
from starlette.websockets import WebSocket, WebSocketDisconnect

from service.bus.subscription import Subscription, SubscriptionClosedError
from service.documents.messages import LIVE
from service.documents.tags import Snapshot
from service.domain.errors import CellUnavailableError
from service.domain.roles import VIEWER
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator, Principal
from service.web.api.access import (
    authenticate,
    caller_by_now,
    refuse_odd_query,
    refuse_other_sites,
    secured,
    subprotocol_key,
    too_many,
)
from service.web.api.context import ServiceContext
from service.web.api.deps import Context, Keys, Trail
from service.web.api.problems import RETRY_AFTER_S, Problem, parameter_problem, problem_response
from service.web.shares import BusyError, Shares

SEND_PATIENCE_S = 20.0
WATCH_EVERY_S = 0.9
_MESSAGES_AT_ONCE = 10
_GOING_AWAY, _POLICY, _TRY_AGAIN = 1001, 1008, 1013
_PATH = "/stream"

#: Of the address, each once.
PARAMETERS = ("assets", "live", "resume", "epoch")
router = APIRouter(tags=["stream"])
_log = structlog.get_logger(__name__)


@router.get(
    _PATH,
    summary="Stream live messages (WebSocket)",
    response_class=Response,
    **secured(
        VIEWER,
        426,
        responses={
            101: {"description": "Switched to WebSocket: JSON messages follow."},
        },
    ),
)
async def stream_by_http(
    assets: Annotated[str | None, Query(description="Asset ids, comma-separated; all.")] = None,
    live: Annotated[str | None, Query(description=LIVE)] = None,
    resume: Annotated[int | None, Query(description="Number of the last message seen.")] = None,
    epoch: Annotated[str | None, Query(description="Epoch of that message.")] = None,
) -> Response:
    """Open a WebSocket here; the key comes by header, session cookie or subprotocol.

    Browsers use the subprotocol `bearer.<key>` or the session cookie; the key is never part of
    the address. Without a key the upgrade is refused with status 403.

    Messages are `{"type", "seq", "epoch", "asset", "time", "sent_at", "data"}`; `time` is process
    time, `sent_at` wall time. First comes `hello` for each asset (its data are the snapshot, and
    `gap` says whether messages after `resume` are gone), then what was missed, then `measurement`,
    `state`, `verdict` (as `GET …/verdict`, at each change and at least every 5 s), `forecast`,
    `alarm`, `job`, `health`, and a `heartbeat` every 15 s. A client that reads
    slowly loses old measurements, never alarms or jobs. Of an asset that no client has
    followed for ten minutes, only `alarm` and `job` are sent: a `resume` from before that has
    a `gap`. `live` names the assets to follow, and `alarm` and `job` come of all `assets` still:
    with many assets, follow those that you show.
    """
    raise Problem(
        426,
        "expected a WebSocket upgrade",
        headers={"Upgrade": "websocket", "Connection": "Upgrade"},
    )


@router.websocket(_PATH)
async def stream(websocket: WebSocket, context: Context, keys: Keys, trail: Trail) -> None:
    """Let a subscriber in and send until one side ends it."""
    try:
        principal, subprotocol = await _admit(websocket, keys, trail)
        _count(principal, keys)
        refuse_odd_query(websocket, dict.fromkeys(PARAMETERS, False))
        async with _place(websocket, principal), contextlib.AsyncExitStack() as turn:
            if websocket.query_params.get("resume"):
                # Hundreds that come back at once want megabytes each: a few at a time.
                catching_up: Shares = websocket.app.state.turns.catching_up
                await turn.enter_async_context(catching_up.turn(principal.key_id))
            await _stay(websocket, context, keys, principal, subprotocol, turn)
    except Problem as problem:
        await _refuse(websocket, problem)


def _count(principal: Principal, keys: Authenticator) -> None:
    """Count a stream as a request: one that is opened again and again is none the cheaper."""
    wait_s = keys.requests.wait_s(principal.key_id)
    if wait_s:
        raise too_many(f"more than {keys.requests.per_minute:g} requests a minute", wait_s)
    keys.requests.count(principal.key_id)


@contextlib.asynccontextmanager
async def _place(websocket: WebSocket, principal: Principal) -> AsyncIterator[None]:
    """Have one of the places for streams."""
    streams: Shares = websocket.app.state.turns.streams
    try:
        await streams.enter(principal.key_id)
    except BusyError as error:
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(503, str(error), headers=headers) from error
    try:
        yield
    finally:
        streams.leave(principal.key_id)


async def _stay(
    websocket: WebSocket,
    context: ServiceContext,
    keys: Authenticator,
    principal: Principal,
    subprotocol: str | None,
    turn: contextlib.AsyncExitStack,
) -> None:
    subscription, wanted = await _subscribe(websocket, context)
    try:
        await websocket.accept(subprotocol)
        _log.info("stream_opened", who=principal.who, assets=wanted)
        sender = _Sender(websocket)
        watching = _watch(sender, keys, principal)
        code, reason = await _serve(sender, context, subscription, wanted, watching, turn)
    finally:
        subscription.close()
    _log.info(
        "stream_closed",
        who=principal.who,
        code=code,
        reason=reason,
        dropped=subscription.dropped,
    )


async def _admit(
    websocket: WebSocket, keys: Authenticator, trail: AuditTrail
) -> tuple[Principal, str | None]:
    """Find who wants the stream, and the full name of the subprotocol with the key."""
    offered = subprotocol_key(websocket)
    principal = await authenticate(websocket, keys, trail)
    if principal is None:
        raise Problem(403, "expected a valid key by header, session cookie or bearer subprotocol")
    if principal.role not in VIEWER:
        raise Problem(403, f"a key of role {principal.role} may not read the stream")
    refuse_other_sites(websocket, principal)
    return principal, offered and offered[1]


async def _subscribe(
    websocket: WebSocket, context: ServiceContext
) -> tuple[Subscription, list[str]]:
    assets = _named(websocket, context, "assets") or None
    live = _named(websocket, context, "live")
    resume_text = websocket.query_params.get("resume")
    resume: int | None = None
    if resume_text:
        if not resume_text.isdecimal() or len(resume_text) > 18:
            raise parameter_problem("resume", f"expected a message number (got {resume_text!r})")
        resume = int(resume_text)
    followed = assets if live is None else live
    try:
        # Who follows no asset need not inform the cell.
        complete_after = 0 if followed == [] else await context.follow(followed)
    except CellUnavailableError:
        complete_after = None  # unknown whether there are all messages
    epoch = websocket.query_params.get("epoch")
    is_another = bool(epoch) and epoch != context.bus.epoch  # what came in the earlier one is gone
    if resume is not None and (is_another or complete_after is None):
        resume = -1
    subscription = context.bus.subscribe(
        assets, resume, complete_after=complete_after or 0, live=live
    )
    return subscription, list(context.assets) if followed is None else followed


def _named(websocket: WebSocket, context: ServiceContext, parameter: str) -> list[str] | None:
    """Assets that a parameter names, each once; None where it is not given."""
    text = websocket.query_params.get(parameter)
    if text is None:
        return None
    names = list(dict.fromkeys(name for name in text.split(",") if name))
    for name in names:
        if name not in context.assets and context.is_known(name):
            headers = {"Retry-After": str(RETRY_AFTER_S)}
            raise Problem(503, f"no cell follows asset {name!r} at the moment", headers=headers)
        if name not in context.assets:
            raise parameter_problem(parameter, f"no asset {name!r}", 404)
    return names


async def _refuse(websocket: WebSocket, problem: Problem) -> None:
    """Answer the upgrade request with a problem instead of an upgrade."""
    await websocket.receive()  # the connect message
    await websocket.send_denial_response(
        problem_response(
            problem.status_code,
            problem.detail,
            websocket.url.path,
            errors=problem.errors,
            headers=problem.headers,
        )
    )


async def _serve(
    sender: "_Sender",
    context: ServiceContext,
    subscription: Subscription,
    wanted: list[str],
    watching: "Coroutine[Any, Any, Ending]",
    turn: contextlib.AsyncExitStack,
) -> tuple[int, str]:
    """Send until the client leaves, is too slow, loses its right, or the service stops."""
    websocket = sender.websocket
    tasks = {
        asyncio.create_task(_send(sender, context, subscription, wanted, turn)),
        asyncio.create_task(_listen(websocket)),
        asyncio.create_task(watching),
    }
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        code, reason = done.pop().result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if code is not None:
        with contextlib.suppress(TimeoutError, WebSocketDisconnect, RuntimeError):
            async with asyncio.timeout(1.0):
                await websocket.close(code, reason)
    return code or 1000, reason


Ending = tuple[int | None, str]
"""Close code (None when the client is gone already) and the reason."""


class _Sender:
    """Sends texts and knows how long the present one has been waiting for the client.

    A time-out around each of thousands of messages a second would cost more than the sending.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self.websocket = websocket
        self._since_s: float | None = None

    @property
    def waiting_s(self) -> float:
        """Seconds for which the client has not taken what is being sent."""
        return 0.0 if self._since_s is None else time.monotonic() - self._since_s

    async def send(self, text: str) -> None:
        """Send a text, however long the client takes."""
        self._since_s = time.monotonic()
        await self.websocket.send_text(text)
        self._since_s = None


async def _send(
    sender: _Sender,
    context: ServiceContext,
    subscription: Subscription,
    wanted: list[str],
    turn: contextlib.AsyncExitStack,
) -> Ending:
    bus = context.bus
    try:
        # Also where no asset is followed, or there is none.
        for asset_id in wanted or (None,):
            tags: Snapshot = {"tags": {}}
            if asset_id is not None:
                asset = context.assets.get(asset_id)
                if asset is None:  # removed a moment ago
                    continue
                await asset.refresh("snapshot")
                tags = asset.snapshot()
            body = to_json(tags, inf_nan_mode="null").decode()
            hello = bus.envelope(
                "hello",
                subscription.start_seq,
                asset_id,
                body,
                extra={"gap": subscription.gap},
            )
            await sender.send(hello)
        for number in range(subscription.missed):
            await sender.send((await subscription.get()).text)
            if number % _MESSAGES_AT_ONCE == 0:
                await asyncio.sleep(0)  # a poll that is due comes between
        await turn.aclose()
        while True:
            message = await subscription.get()
            await sender.send(message.text)
    except CellUnavailableError as error:
        return _TRY_AGAIN, str(error)
    except SubscriptionClosedError as error:
        overflow = "overflow" in str(error)
        return (_TRY_AGAIN if overflow else _GOING_AWAY), str(error)
    except WebSocketDisconnect:
        return None, "the client disconnected"


async def _listen(websocket: WebSocket) -> Ending:
    """Wait until the client leaves; what it says meanwhile is not asked for."""
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            return None, "the client disconnected"


async def _watch(sender: _Sender, keys: Authenticator, principal: Principal) -> Ending:
    """End the stream when its key is revoked, its session is over, or the client reads nothing."""
    while True:
        await asyncio.sleep(WATCH_EVERY_S)
        if sender.waiting_s > SEND_PATIENCE_S:
            return _TRY_AGAIN, f"nothing was read for {SEND_PATIENCE_S:g} s"
        found = await caller_by_now(sender.websocket, keys, principal)
        if found is None or found.role not in VIEWER:
            return _POLICY, "the key is no longer valid"
        principal = found
