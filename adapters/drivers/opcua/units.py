"""Units that an OPC UA server states of its nodes (Part 8, EngineeringUnits)."""

import struct
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from asyncua import ua
from asyncua.ua.uaerrors import UaError

NODES_PER_REQUEST = 500
# Questions that may fail before no further one is asked.
_MOST_FAILURES = 40
# Nodes that are refused one by one before the same is taken to hold for all.
_ALL_REFUSED = 3
# What a server answers that knows no such question.
_NO_SERVICE = frozenset(
    (
        ua.StatusCodes.BadServiceUnsupported,
        ua.StatusCodes.BadNotImplemented,
        ua.StatusCodes.BadNotSupported,
    )
)
# What it answers to a question that is too long.
_TOO_MUCH = frozenset(
    (
        ua.StatusCodes.BadTooManyOperations,
        ua.StatusCodes.BadRequestTooLarge,
        ua.StatusCodes.BadResponseTooLarge,
        ua.StatusCodes.BadEncodingLimitsExceeded,
    )
)
# What it answers of a node that has no unit, or none for us.
_STATES_NONE = _NO_SERVICE | frozenset(
    (
        ua.StatusCodes.BadUserAccessDenied,
        ua.StatusCodes.BadNotReadable,
        ua.StatusCodes.BadNoMatch,
        ua.StatusCodes.BadNotFound,
        ua.StatusCodes.BadBrowseNameInvalid,
        ua.StatusCodes.BadNodeIdInvalid,
        ua.StatusCodes.BadNodeIdUnknown,
        ua.StatusCodes.BadNothingToDo,
    )
)
# Common codes of UNECE Recommendation 20, which a unit without a name has as its number.
_UNECE = {"CEL": "°C", "KEL": "K", "FAH": "°F", "NEW": "N", "B47": "kN", "RPM": "rpm", "RPS": "1/s"}


@dataclass
class StatedUnits:
    """What a server says of the units of nodes.

    Attributes
    ----------
    units : dict of str to str
        By node; empty where the server states none.
    unanswered : dict of str to str
        Nodes of which it does not say now whether they have one, and why.
    """

    units: dict[str, str] = field(default_factory=dict)
    unanswered: dict[str, str] = field(default_factory=dict)


async def stated_units(client: Any, nodes: Mapping[str, Any]) -> StatedUnits:
    """Ask a server for the units of nodes; what it cannot say is no reason to lose its values.

    Parameters
    ----------
    client : asyncua.client.ua_client.UaClient
        A connection to the server.
    nodes : mapping of str to NodeId
        Nodes by name.

    Raises
    ------
    OSError
        If the connection is lost.
    """
    names = list(nodes)
    found, failures, refused = StatedUnits(), 0, 0
    waiting = _parts(names, NODES_PER_REQUEST)
    while waiting:
        part = waiting.popleft()
        try:
            answers = await _answers(client, {name: nodes[name] for name in part})
        except (UaError, TimeoutError, ValueError, struct.error) as error:
            code, reason = getattr(error, "code", None), _reason(error)
            left = [*part, *(name for one in waiting for name in one)]
            if code in _TOO_MUCH and len(part) > 1:
                waiting = _parts(left, len(part) // 2)
                continue
            failures += 1
            refused += code in _STATES_NONE and len(part) == 1
            if code in _NO_SERVICE or (refused >= _ALL_REFUSED and len(found.units) < refused):
                found.units |= dict.fromkeys(left, "")
                break
            if isinstance(error, TimeoutError) or failures > _MOST_FAILURES:
                # Each further question would take as long. Those that were not reached come first
                # the next time.
                found.unanswered = dict.fromkeys(left, reason) | found.unanswered
                break
            if len(part) > 1 and code in _STATES_NONE and not found.units:
                # None of them is for us, or one spoils the answer for all: some are asked alone.
                alone = {part[0], part[len(part) // 2], part[-1]}
                rest = [name for name in part if name not in alone]
                waiting.extendleft([rest] if rest else [])
                waiting.extendleft([name] for name in alone)
            elif len(part) > 1:
                half = len(part) // 2
                waiting.extendleft([part[half:], part[:half]])
            elif code in _STATES_NONE:
                found.units[part[0]] = ""
            else:
                found.unanswered[part[0]] = reason
            continue
        for name, (status, unit) in answers.items():
            if status is None or status.is_good():
                found.units[name] = unit
            elif status.value in _STATES_NONE:
                found.units[name] = ""
            else:
                found.unanswered[name] = str(status.name)
    return found


def _parts(names: Sequence[str], size: int) -> deque[Sequence[str]]:
    return deque(names[at : at + size] for at in range(0, len(names), size))


async def _answers(client: Any, nodes: Mapping[str, Any]) -> dict[str, tuple[Any, str]]:
    """Status and unit by node: of its property, or of the path to it where that leads nowhere."""
    paths = [_unit_path(node) for node in nodes.values()]
    results = await client.translate_browsepaths_to_nodeids(paths)
    answers = {name: (result.StatusCode, "") for name, result in zip(nodes, results, strict=True)}
    properties = {
        name: result.Targets[0].TargetId
        for name, result in zip(nodes, results, strict=True)
        if result.StatusCode.is_good() and result.Targets
    }
    if properties:
        request = ua.ReadParameters()
        request.NodesToRead = [value_of(_local(one)) for one in properties.values()]
        for name, value in zip(properties, await client.read(request), strict=True):
            answers[name] = value.StatusCode, _unit(value)
    return answers


def _unit(answer: Any) -> str:
    """Name of a unit; empty where the property is there without one."""
    unit = answer.Value.Value if answer.Value else None
    name = getattr(getattr(unit, "DisplayName", None), "Text", None)
    if isinstance(name, str) and name.strip():
        return name.strip()
    number = getattr(unit, "UnitId", None)
    if not isinstance(number, int) or number <= 0:
        return ""
    code = number.to_bytes(4, "big").lstrip(b"\0").decode("ascii", errors="replace")
    return _UNECE.get(code, f"unit {number}")


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer"
    return type(error).__name__ if isinstance(error, ua.UaStatusCodeError) else f"{error}"


def value_of(node_id: Any) -> Any:
    """Make the item of a request that reads the value of a node."""
    item = ua.ReadValueId()
    item.NodeId = node_id
    item.AttributeId = ua.AttributeIds.Value
    return item


def _local(node_id: Any) -> Any:
    """The same node as one of this server: a target of a path has a longer form."""
    return ua.NodeId(node_id.Identifier, node_id.NamespaceIndex, node_id.NodeIdType)


def _unit_path(node_id: Any) -> Any:
    step = ua.RelativePathElement()
    step.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasProperty)
    step.IsInverse, step.IncludeSubtypes = False, True
    step.TargetName = ua.QualifiedName("EngineeringUnits", 0)
    path = ua.BrowsePath()
    path.StartingNode = node_id
    path.RelativePath.Elements = [step]
    return path
