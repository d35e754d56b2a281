"""Values as a client asks for them (Part 4): a part of an array, with the times it wants."""

import re
from copy import copy
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError

from service.domain.errors import BearingTwinError

#: One for each dimension; none for the whole value.
Ranges = tuple[slice, ...]
_DIMENSION: Final = re.compile("([0-9]{1,10})(?::([0-9]{1,10}))?")
_ENCODINGS: Final = (None, "", "Default Binary")
_Stamps = ua.TimestampsToReturn
_WITH_SOURCE_TIME: Final = (_Stamps.Source, _Stamps.Both)
_WITH_SERVER_TIME: Final = (_Stamps.Server, _Stamps.Both)


class RefusedError(BearingTwinError):
    """One thing of a request cannot be done, the others can; the status says why."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status


def check_stamps(stamps: ua.TimestampsToReturn) -> None:
    """Raise `ServiceError` unless a client says which times it wants."""
    if stamps == _Stamps.Invalid:
        raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)


def ranges_asked(node: ua.ReadValueId | ua.HistoryReadValueId) -> Ranges:
    """Give the part of a value that is asked for.

    Raises `RefusedError` if it is none, or in an encoding that there is not.
    """
    if node.DataEncoding.Name not in _ENCODINGS:
        raise RefusedError(ua.StatusCodes.BadDataEncodingUnsupported)
    return ranges_of(node.IndexRange)


def ranges_of(text: str | None) -> Ranges:
    """Understand a ``NumericRange``: ``2``, ``0:3``, or one of them for each dimension.

    Raises `RefusedError` for what is none.
    """
    return tuple(_range_of(one) for one in text.split(",")) if text else ()


def _range_of(text: str) -> slice:
    found = _DIMENSION.fullmatch(text)
    first, last = (int(one) if one else None for one in found.groups()) if found else (None, None)
    if first is None or (last is not None and last <= first):
        raise RefusedError(ua.StatusCodes.BadIndexRangeInvalid)
    return slice(first, (first if last is None else last) + 1)


def part_of(value: ua.DataValue, ranges: Ranges) -> ua.DataValue:
    """Cut a part out; a value that has no such part is replaced by the status that says so."""
    if not ranges or value.StatusCode.is_bad():
        return value
    part = copy(value)
    try:
        found = _cut(None if value.Value is None else value.Value.Value, ranges)
    except RefusedError as error:
        part.Value, part.StatusCode = None, ua.StatusCode(error.status)
    else:
        part.Value = ua.Variant(found, value.Value.VariantType)
    return part


def _cut(value: Any, ranges: Ranges) -> Any:
    """Cut an array, a text or bytes; of an array each element by the ranges that follow."""
    if not ranges:
        return value
    part = value[ranges[0]] if isinstance(value, list | str | bytes) else None
    following = ranges[1:]
    if not part or (following and not isinstance(part, list)):
        raise RefusedError(ua.StatusCodes.BadIndexRangeNoData)
    return [_cut(one, following) for one in part] if following else part


def with_times(value: ua.DataValue, stamps: ua.TimestampsToReturn) -> ua.DataValue:
    """Give a value with the times that are asked for, and no others."""
    shown = copy(value)
    if stamps not in _WITH_SOURCE_TIME:
        shown.SourceTimestamp = shown.SourcePicoseconds = None
    if stamps not in _WITH_SERVER_TIME:
        shown.ServerTimestamp = shown.ServerPicoseconds = None
    elif shown.ServerTimestamp is None:  # it holds now
        shown.ServerTimestamp = datetime.now(UTC)
    return shown


def as_asked(
    value: ua.DataValue, node: ua.ReadValueId, stamps: ua.TimestampsToReturn
) -> ua.DataValue:
    """Give what a read asks for of a value, or the status that says why not."""
    try:
        return with_times(part_of(value, ranges_asked(node)), stamps)
    except RefusedError as error:
        return ua.DataValue(StatusCode=ua.StatusCode(error.status))
