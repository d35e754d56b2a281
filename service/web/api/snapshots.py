"""The snapshot as it goes out: made once for all who poll, and answered without the detours.

Twenty SCADA clients that poll every second, and as many dashboards, all want the same bytes. They
are kept until the snapshot is another one; a request for them is answered as soon as the door has
let it in.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from pydantic_core import to_json
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.domain.interfaces import AssetTwin
from service.domain.roles import VIEWER
from service.web.api.access import known_caller
from service.web.api.entity_tags import entity_tag, tagged_response

_PATH: Final = re.compile(r"/api/v1/assets/([^/]+)/snapshot")


@dataclass(frozen=True, slots=True)
class _Kept:
    snapshot: Mapping[str, Any]
    body: bytes
    tag: str


class Snapshots:
    """The present snapshot of each asset as bytes with their entity tag."""

    def __init__(self) -> None:
        self._kept: dict[str, _Kept] = {}

    def response(self, asset: AssetTwin, if_none_match: str | None) -> Response:
        """Answer with the snapshot, or with 304 to who has it already.

        Parameters
        ----------
        asset : AssetTwin
            Whose snapshot.
        if_none_match : str, optional
            The header of the request.
        """
        snapshot = asset.snapshot()
        kept = self._kept.get(asset.id)
        # An asset gives the same object as long as nothing in it has changed.
        if kept is None or kept.snapshot is not snapshot:
            body = to_json(snapshot, inf_nan_mode="null")
            kept = self._kept[asset.id] = _Kept(snapshot, body, entity_tag(body))
        return tagged_response(kept.body, kept.tag, if_none_match)


class SnapshotShortcut:
    """Answer polls of a snapshot here; all else, and all that is not in order, goes on.

    It stands behind the door, which knows the caller. What the route would refuse the route
    refuses.

    Parameters
    ----------
    app
        What lies behind.
    snapshots : Snapshots
        Shared with the route.
    assets : mapping of str to AssetTwin
        The assets by id.
    """

    def __init__(self, app: ASGIApp, snapshots: Snapshots, assets: Mapping[str, AssetTwin]) -> None:
        self.app = app
        self.snapshots = snapshots
        self.assets = assets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass the request on."""
        if scope["type"] == "http" and scope["method"] == "GET":
            found = _PATH.fullmatch(scope["path"])
            asset = self.assets.get(found[1]) if found else None
            caller = known_caller(scope)
            if asset is not None and caller is not None and caller.role in VIEWER:
                if_none_match = Headers(scope=scope).get("if-none-match")
                await self.snapshots.response(asset, if_none_match)(scope, receive, send)
                return
        await self.app(scope, receive, send)
