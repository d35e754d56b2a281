"""Units that an OPC UA server states of its nodes (Part 8, EngineeringUnits)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from asyncua import ua
from asyncua.ua.uaerrors import UaError

NODES_PER_REQUEST = 500
# What a server answers that states no units.
_STATES_NONE = frozenset(
    (
        ua.StatusCodes.BadServiceUnsupported,
        ua.StatusCodes.BadNotImplemented,
        ua.StatusCodes.BadNotSupported,
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
    found = StatedUnits()
    names = list(nodes)
    for begin in range(0, len(names), NODES_PER_REQUEST):
        part = {name: nodes[name] for name in names[begin : begin + NODES_PER_REQUEST]}
        await _ask(client, part, found)
    return found


async def _ask(client: Any, nodes: Mapping[str, Any], found: StatedUnits) -> None:
    names = list(nodes)
    try:
        answers = await _answers(client, nodes)
    except (TimeoutError, UaError, ValueError) as error:
        code = getattr(error, "code", None)
        if code == ua.StatusCodes.BadTooManyOperations and len(names) > 1:
            half = len(names) // 2
            await _ask(client, {name: nodes[name] for name in names[:half]}, found)
            await _ask(client, {name: nodes[name] for name in names[half:]}, found)
        elif code in _STATES_NONE:
            found.units |= dict.fromkeys(names, "")
        else:
            found.unanswered |= dict.fromkeys(names, _reason(error))
        return
    for name, (status, unit) in answers.items():
        if status is None or status.is_good():
            found.units[name] = unit
        elif status.value in _STATES_NONE:
            found.units[name] = ""
        else:
            found.unanswered[name] = str(status.name)


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
        request.NodesToRead = [_value_of(_local(one)) for one in properties.values()]
        for name, value in zip(properties, await client.read(request), strict=True):
            answers[name] = value.StatusCode, _unit(value)
    return answers


def _unit(answer: Any) -> str:
    unit = answer.Value.Value if answer.Value else None
    text = getattr(getattr(unit, "DisplayName", None), "Text", None)
    return text.strip() if isinstance(text, str) else ""


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer"
    return type(error).__name__ if isinstance(error, ua.UaStatusCodeError) else f"{error}"


def _value_of(node_id: Any) -> Any:
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
