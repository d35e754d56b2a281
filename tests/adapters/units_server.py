"""A server of OPC UA that is asked for the units of its nodes."""

import struct
from typing import Any

from asyncua import ua
from asyncua.client.ua_client import UaClientState

NODES = {f"ns=2;i={number}": ua.NodeId(number, 2) for number in range(7)}
NODE, OTHER, *_ = NODES


class Server:
    """A client of a server that takes two paths in a request, and states K for every node.

    Parameters
    ----------
    refusal : exception, optional
        What becomes of every question.
    paths, properties : dict of int to StatusCode
        What it says of single nodes instead, by their numbers.
    """

    def __init__(
        self,
        refusal: Exception | None = None,
        paths: dict[int, int] | None = None,
        properties: dict[int, int] | None = None,
    ) -> None:
        self.refusal, self.paths, self.properties = refusal, paths or {}, properties or {}
        self.unit: Any = ua.EUInformation(DisplayName=ua.LocalizedText("K"))
        self.spoiling: set[int] = set()
        self.spoils: Exception = struct.error()
        self.most = 2
        self.asked = 0
        self.state = UaClientState.CONNECTED

    async def translate_browsepaths_to_nodeids(self, paths: list[Any]) -> list[Any]:
        self.asked += 1
        if self.refusal is not None:
            raise self.refusal
        if len(paths) > self.most:
            raise ua.uaerrors.BadTooManyOperations
        found = []
        for path in paths:
            number = path.StartingNode.Identifier
            target = ua.BrowsePathTarget(ua.ExpandedNodeId(number, 2), 0)
            status = ua.StatusCode(self.paths.get(number, 0))
            found.append(ua.BrowsePathResult(status, [target] if status.is_good() else []))
        return found

    async def read(self, request: Any) -> list[Any]:
        if self.spoiling & {item.NodeId.Identifier for item in request.NodesToRead}:
            raise self.spoils
        found = []
        for item in request.NodesToRead:
            status = ua.StatusCode(self.properties.get(item.NodeId.Identifier, 0))
            value = ua.Variant(self.unit) if status.is_good() else None
            found.append(ua.DataValue(value, StatusCode=status))
        return found
