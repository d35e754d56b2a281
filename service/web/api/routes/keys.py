"""API keys: made, listed and revoked by an administrator."""

from typing import Annotated

from anyio import to_thread
from fastapi import APIRouter, Path
from pydantic import ConfigDict, Field
from starlette.requests import Request
from starlette.responses import Response

from service.documents.access import KeyDocument, KeyList, NewKeyDocument
from service.domain.requests import RequestBody
from service.domain.roles import ADMIN, Role
from service.domain.texts import OneLine
from service.security.keys import (
    LABEL_LENGTH,
    UnknownKeyError,
    create_key,
    list_keys,
    revoke_key,
)
from service.web.api.access import LOCATION, Caller, actor, secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, Keys, json_response
from service.web.api.problems import Problem, parameter_problem

router = APIRouter(prefix="/keys", tags=["access"])


class KeyRequest(RequestBody):
    """What the key may do, for how long, and what it is called."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"role": "operator", "expires_in_days": 90, "label": "control room"}]
        }
    )

    role: Role
    expires_in_days: float | None = Field(
        None, gt=0, le=36_500, description="Absent: valid until it is revoked."
    )
    label: OneLine = Field("", max_length=LABEL_LENGTH, description="For people.")


@router.get("", response_model=KeyList, summary="List API keys", **secured(ADMIN))
def get_keys(
    context: Context, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """All keys that were ever made, newest first; never the keys themselves."""
    newest_first = list_keys(context.store)[::-1]
    page, following = page_of(newest_first, limit, cursor, lambda key: key.id)
    body = KeyList(items=[KeyDocument.of(key) for key in page], next=following)
    return json_response(body, headers=next_link(request, following))


@router.post(
    "",
    status_code=201,
    response_model=NewKeyDocument,
    summary="Create an API key",
    **secured(ADMIN, audit=None, responses={201: {"headers": LOCATION}}),
)
async def post_key(context: Context, request: Request, body: KeyRequest) -> Response:
    """Return the key this once; only its hash is stored."""
    maker = actor(request)
    new = await to_thread.run_sync(
        lambda: create_key(context.store, body.role, body.expires_in_days, body.label, actor=maker)
    )
    headers = {"Location": f"{request.url.path}/{new.record.id}"}
    return json_response(NewKeyDocument.made(new.record, new.text), 201, headers)


@router.delete(
    "/{key_id}",
    response_model=KeyDocument,
    summary="Revoke an API key",
    **secured(ADMIN, 404, 409, audit=None),
)
async def delete_key(
    context: Context,
    request: Request,
    keys: Keys,
    who: Caller,
    key_id: Annotated[str, Path(max_length=64, description="The key's id or prefix.")],
) -> Response:
    """End the key at once, with its browser sessions and, within two seconds, its streams.

    409 for the key of the call itself.
    """
    if key_id in (who.key_id, who.prefix):
        raise Problem(409, "a key cannot revoke itself, expected another administrator's key")
    revoker = actor(request)
    try:
        key = await to_thread.run_sync(lambda: revoke_key(context.store, key_id, actor=revoker))
    except UnknownKeyError as error:
        raise parameter_problem("key_id", f"there is no key {key_id!r}", 404) from error
    keys.forget(key.id)
    return json_response(KeyDocument.of(key))
