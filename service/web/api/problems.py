"""Every error as a problem document (RFC 9457), the framework's own ones too."""

import http.client
import re
from collections.abc import Mapping, Sequence
from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute, iter_route_contexts
from pydantic_core import ErrorDetails
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import compile_path

from service.documents.identification import JobDocument
from service.documents.problems import FieldError, ProblemDocument
from service.domain.errors import (
    ActivationRefusedError,
    CellUnavailableError,
    ChangedMeanwhileError,
    JobConflictError,
    KeyUsedBeforeError,
    NotIdentifiedError,
    NotKeptError,
    NotReadyError,
    RequestRefusedError,
    RoleRefusedError,
)
from service.domain.texts import EXPECTED, ONE_LINE
from service.store import StoreUnavailableError
from service.web.shares import BusyError

MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 5
_SHOWN_CHARACTERS = 60
_SECRET_FIELDS = frozenset({"key"})

_log = structlog.get_logger(__name__)


class Problem(HTTPException):
    """An error on its way to the caller."""

    def __init__(
        self,
        status: int,
        detail: str,
        *,
        errors: Sequence[FieldError] = (),
        headers: Mapping[str, str] | None = None,
        job: JobDocument | None = None,
    ) -> None:
        super().__init__(status, detail, headers)
        self.errors = errors
        self.job = job


def parameter_problem(name: str, detail: str, status: int = 422) -> Problem:
    """Build the problem of one wrong query, path or header parameter."""
    return Problem(status, f"{name}: {detail}", errors=[FieldError(parameter=name, detail=detail)])


def pointer_problem(pointer: str, detail: str, status: int = 422) -> Problem:
    """Build the problem of one wrong place in the body."""
    return Problem(
        status,
        f"{pointer or 'body'}: {detail}",
        errors=[FieldError(pointer=pointer, detail=detail)],
    )


_KEY = re.compile(r"([A-Za-z_][A-Za-z0-9_.-]*(?:\[\d+\][A-Za-z0-9_.-]*)*)(?: = |: )")


def line_error(line: str, below: str = "", prefix: str = "") -> FieldError:
    """Show a line of a `SettingsError` that begins with its key, as one wrong place of the body.

    ``line``: ``channels.load_n.unit_id = 300: expected …``, or without a key; ``below``: JSON
    pointer of the table that holds the key.
    """
    key = _KEY.match(line)
    parts = re.split(r"[.\[\]]+", key[1].rstrip("]")) if key else ()
    return FieldError(pointer="/".join((below, *parts)), detail=f"{prefix}{line}")


def problem_response(
    status: int,
    detail: str,
    instance: str,
    *,
    errors: Sequence[FieldError] = (),
    headers: Mapping[str, str] | None = None,
    job: JobDocument | None = None,
) -> Response:
    """Build the HTTP answer of a problem."""
    document = ProblemDocument(
        title=http.client.responses.get(status, "Error"),
        status=status,
        detail=detail,
        instance=instance,
        errors=list(errors),
        job=job,
    )
    return Response(document.to_bytes(), status, headers=headers, media_type=MEDIA_TYPE)


def install_handlers(app: FastAPI) -> None:
    """Answer every exception that a request can end in with a problem document."""

    async def on_http_exception(request: Request, error: HTTPException) -> Response:
        if isinstance(error, Problem):
            return _answer(request, error)
        detail = error.detail if isinstance(error.detail, str) else str(error.detail)
        if isinstance(error.__cause__, UnicodeDecodeError):
            return _answer(request, Problem(422, "body: expected UTF-8"))
        if error.status_code == 404 and detail == "Not Found":
            detail = f"there is nothing at {request.url.path}"
        headers = error.headers
        if error.status_code == 405:
            methods = ", ".join(_methods(app, request.url.path))
            headers = {"Allow": methods} if methods else headers
            detail = f"{request.method} is not possible here, expected {methods or 'GET'}"
        return _answer(request, Problem(error.status_code, detail, headers=headers))

    async def on_validation_error(request: Request, error: RequestValidationError) -> Response:
        errors = [_field_error(one, error.body) for one in error.errors()]
        first = errors[0]
        where = first.parameter or first.pointer or "body"
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        return _answer(request, Problem(422, f"{where}: {first.detail}{more}", errors=errors))

    async def on_conflict(request: Request, error: JobConflictError) -> Response:
        job = error.job if isinstance(error.job, JobDocument) else None
        return _answer(request, Problem(409, str(error), job=job))

    async def on_key_used_before(request: Request, error: KeyUsedBeforeError) -> Response:
        return _answer(request, parameter_problem("Idempotency-Key", str(error)))

    async def on_refusal(request: Request, error: ActivationRefusedError) -> Response:
        return _answer(request, Problem(409, str(error)))

    async def on_changed_meanwhile(request: Request, error: ChangedMeanwhileError) -> Response:
        return _answer(request, Problem(409, str(error)))

    async def on_refused_request(request: Request, error: RequestRefusedError) -> Response:
        return _answer(request, pointer_problem(error.pointer, error.detail))

    async def on_not_identified(request: Request, error: NotIdentifiedError) -> Response:
        return _answer(request, Problem(409, str(error)))

    async def on_not_ready(request: Request, error: NotReadyError) -> Response:
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        return _answer(request, Problem(503, str(error), headers=headers))

    async def on_store_away(request: Request, error: StoreUnavailableError) -> Response:
        _log.warning("store_away", path=request.url.path, error=str(error))
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        return _answer(request, Problem(503, "the store does not answer", headers=headers))

    async def on_busy(request: Request, error: BusyError) -> Response:
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        return _answer(request, Problem(503, str(error), headers=headers))

    async def on_cell_away(request: Request, error: CellUnavailableError) -> Response:
        headers = {"Retry-After": str(RETRY_AFTER_S)}
        detail = f"the cell does not answer: {error}"
        return _answer(request, Problem(503, detail, headers=headers))

    async def on_role_refused(request: Request, error: RoleRefusedError) -> Response:
        return _answer(request, Problem(403, str(error)))

    async def on_not_kept(request: Request, error: NotKeptError) -> Response:
        return _answer(request, Problem(503, str(error)))

    handlers: dict[type[Exception], Any] = {
        CellUnavailableError: on_cell_away,
        ChangedMeanwhileError: on_changed_meanwhile,
        NotKeptError: on_not_kept,
        RoleRefusedError: on_role_refused,
        BusyError: on_busy,
        HTTPException: on_http_exception,
        RequestValidationError: on_validation_error,
        JobConflictError: on_conflict,
        KeyUsedBeforeError: on_key_used_before,
        ActivationRefusedError: on_refusal,
        RequestRefusedError: on_refused_request,
        NotIdentifiedError: on_not_identified,
        NotReadyError: on_not_ready,
        StoreUnavailableError: on_store_away,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)


def _methods(app: FastAPI, path: str) -> list[str]:
    """Methods that a path answers to, over all its routes."""
    return sorted(
        {
            method
            for route in iter_route_contexts(app.routes)
            if isinstance(route.original_route, APIRoute)
            and compile_path(route.path or "")[0].match(path)
            for named in route.methods or ()
            for method in ({"GET", "HEAD"} if named == "GET" else {named})
        }
    )


def _answer(request: Request, problem: Problem) -> Response:
    return problem_response(
        problem.status_code,
        problem.detail,
        request.url.path,
        errors=problem.errors,
        headers=problem.headers,
        job=problem.job,
    )


def _field_error(error: ErrorDetails, body: Any) -> FieldError:
    location = tuple(error["loc"])
    message = str(error["msg"]).removeprefix("Value error, ")
    if error.get("ctx", {}).get("pattern") == ONE_LINE:
        message = EXPECTED
    if error["type"] == "json_invalid":
        reason = error.get("ctx", {}).get("error", "")
        detail = f"not valid JSON at character {location[-1]}: {reason}"
        return FieldError(pointer="", detail=detail)
    shown = _shown(error, location)
    if location and location[0] == "body":
        return FieldError(pointer=_pointer(location[1:], body), detail=f"{message}{shown}")
    # A list parameter carries the index of its wrong item behind the name.
    name = location[1] if len(location) > 1 else location[0]
    return FieldError(parameter=str(name), detail=f"{message}{shown}")


def _pointer(location: Sequence[int | str], body: Any) -> str:
    """JSON pointer of an error; names that pydantic adds for alternatives are left out."""
    pointer = ""
    here = body
    for number, part in enumerate(location):
        last = number == len(location) - 1
        if isinstance(here, dict):
            if part not in here and not last:
                continue
            here = here.get(part)
        elif isinstance(here, list):
            if not isinstance(part, int) or part >= len(here):
                continue
            here = here[part]
        else:
            break
        pointer += "/" + str(part).replace("~", "~0").replace("/", "~1")
    return pointer


def _shown(error: ErrorDetails, location: Sequence[int | str]) -> str:
    """Give the wrong value, unless it is missing, long or a secret."""
    value = error.get("input")
    secret = any(part in _SECRET_FIELDS for part in location)
    if secret or error["type"] == "missing" or not isinstance(value, str | int | float):
        return ""
    text = repr(value)
    if len(text) > _SHOWN_CHARACTERS:
        text = text[:_SHOWN_CHARACTERS] + "…"
    return f" (got {text})"
