"""Errors of the domain on their way from the cell to who asked."""

from collections.abc import Callable
from typing import Any, Final

import msgspec
import structlog

from service.alarms import NotAllowedError, UnknownAlarmError
from service.bus.messages import encode
from service.documents.identification import JobDocument
from service.domain.errors import (
    ActivationRefusedError,
    BearingTwinError,
    CellUnavailableError,
    JobConflictError,
    KeyUsedBeforeError,
    NotIdentifiedError,
    NotKeptError,
    NotReadyError,
    PushRefusedError,
    RequestRefusedError,
    RoleRefusedError,
)
from service.store import StoreUnavailableError

_log = structlog.get_logger(__name__)


def _text(error: Exception) -> tuple[Any, ...]:
    return (str(error.args[0]) if error.args else str(error),)


def _conflict(text: str, job: bytes) -> JobConflictError:
    return JobConflictError(text, JobDocument.model_validate_json(job))


#: Each kind of error with what it is made of again on the other side.
_KINDS: Final[dict[type[Exception], Callable[[Any], tuple[Any, ...]]]] = {
    ActivationRefusedError: _text,
    CellUnavailableError: _text,
    JobConflictError: lambda error: (str(error), error.job.to_bytes()),
    KeyError: lambda error: error.args[:1],
    KeyUsedBeforeError: _text,
    NotAllowedError: _text,
    NotIdentifiedError: _text,
    NotKeptError: _text,
    NotReadyError: _text,
    PushRefusedError: lambda error: (error.detail, error.retry_after_s),
    RequestRefusedError: lambda error: (error.pointer, error.detail),
    RoleRefusedError: _text,
    StoreUnavailableError: _text,
    UnknownAlarmError: _text,
}
_BY_NAME: Final[dict[str, Callable[..., Exception]]] = {kind.__name__: kind for kind in _KINDS} | {
    JobConflictError.__name__: _conflict
}


class CellFaultError(BearingTwinError, RuntimeError):
    """A command met an error that no one had thought of; the cell's log says more."""


def dump_error(error: Exception) -> tuple[str, bytes]:
    """Name of an error, and what it is made of; of one that is not known only its kind."""
    kind = next((one for one in type(error).__mro__ if one in _KINDS), None)
    if kind is None:
        return CellFaultError.__name__, encode((type(error).__name__,))
    return kind.__name__, encode(_KINDS[kind](error))


def load_error(name: str, body: bytes) -> Exception:
    """Make an error again."""
    arguments = msgspec.msgpack.decode(body)
    kind = _BY_NAME.get(name)
    if kind is None:
        return CellFaultError(f"the cell met an error that it does not know ({arguments[0]})")
    return kind(*arguments)
