"""What an outbox carries to the store, and how it stands in a file."""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, ClassVar, TypeVar

import msgspec
import structlog
from sqlalchemy import Connection

from service.feature_folders import declared
from service.store.alarm_records import Alarm, AlarmTransition
from service.store.deliveries import Delivery
from service.store.part import Parts
from service.store.records import AuditEntry

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class AlarmChange:
    """An alarm as it is now, and what happened to it; no alarm for lines that belong to none.

    What somebody asked for carries its line of the audit trail: both are written, or none.
    """

    alarm: Alarm | None
    lines: tuple[AlarmTransition, ...] = ()
    audit: AuditEntry | None = None


class FeatureChange(msgspec.Struct, frozen=True):
    """A change of a feature's part of the store; the feature's module `tables` lists it.

    ``kind``: names it in the file of an outbox.
    """

    kind: ClassVar[str]

    @property
    def summary(self) -> str:
        """What the list of changes that the store did not take calls it."""
        raise NotImplementedError

    def assets(self) -> Iterable[str]:
        """Name the assets that it is about."""
        raise NotImplementedError

    def save(self, parts: Parts, delivery: Delivery | None, refuse: "RefuseChange") -> None:
        """Write it into the store; ``refuse`` takes what is left of it, within the transaction."""
        raise NotImplementedError

    def repeat(self, connection: Connection) -> str:
        """Write its records after it was refused; gives what was written.

        A state comes from the owner of the asset alone, and is not written.
        """
        return f"nothing: {self.summary} follow the present owner of the asset"


RefuseChange = Callable[[Connection, FeatureChange], None]
_Record = TypeVar("_Record", Alarm, AlarmTransition)
Change = AlarmChange | AuditEntry | FeatureChange


def document_of(change: Change) -> str:
    """Write a change as a text of ASCII characters."""
    if isinstance(change, FeatureChange):
        return json.dumps({change.kind: msgspec.to_builtins(change)})
    kind = "audit" if isinstance(change, AuditEntry) else "alarm"
    return json.dumps({kind: asdict(change)}, default=float)


def change_of(document: str) -> Change | None:
    """Read a change; None, with a log line, for one of another version."""
    try:
        ((kind, given),) = json.loads(document).items()
        if kind == "audit":
            return AuditEntry(**given)
        if kind in _feature_changes():
            return msgspec.convert(given, _feature_changes()[kind])
        alarm = None if given["alarm"] is None else _read(Alarm, given["alarm"])
        lines = tuple(_read(AlarmTransition, line) for line in given["lines"])
        audit = given.get("audit")  # earlier versions kept none
        return AlarmChange(alarm, lines, audit and AuditEntry(**audit))
    except (ValueError, TypeError, KeyError, AttributeError, msgspec.MsgspecError) as error:
        _log.error("change_not_readable", change=document, error=repr(error))
        return None


def _read(kind: type[_Record], given: dict[str, Any]) -> _Record:
    """Read a record; earlier versions knew of no alarm of several assets."""
    return kind(**given | {"assets": tuple(given.get("assets", ()))})


def assets_of(change: Change | None) -> list[str]:
    """Name the assets that a change is about, in alphabetical order."""
    if isinstance(change, AlarmChange):
        alarm = () if change.alarm is None else (change.alarm.asset,)
        return sorted({*alarm, *(line.asset for line in change.lines)})
    if isinstance(change, FeatureChange):
        return sorted(set(change.assets()))
    return []


@cache
def _feature_changes() -> dict[str, type[FeatureChange]]:
    """Changes of all features, by kind."""
    return {change.kind: change for change in declared("tables", "CHANGES")}
