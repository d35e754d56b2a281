"""The snapshot as it goes out: the copy of the cell's bytes, answered without the detours.

Twenty SCADA clients that poll every second, and as many dashboards, all want the same bytes. A
request for them is answered right behind the access gate.
"""

import re
from collections.abc import Mapping
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from service.bus.replica import AssetReplica
from service.domain.errors import CellUnavailableError
from service.domain.roles import VIEWER
from service.web.api.access import known_caller
from service.web.api.entity_tags import tagged_response

#: A copy that is older says so in the header ``Age``.
AGE_FROM_S: Final = 1.0
_PATH: Final = re.compile(r"/api/v1/assets/([^/]+)/snapshot")


async def snapshot_response(asset: AssetReplica, if_none_match: str | None) -> Response:
    """Answer with the snapshot, or with 304 to who has it already.

    Raises `CellUnavailableError` if the cell has never answered.
    """
    await asset.refresh("snapshot")
    text, digest = asset.text("snapshot")
    response = tagged_response(text, f'W/"{digest.hex()}"', if_none_match)
    age_s = asset.age_s("snapshot")
    if age_s >= AGE_FROM_S:
        response.headers["Age"] = str(int(age_s))
    return response


class SnapshotShortcut:
    """Answer polls of a snapshot here; all else, and all that is not in order, goes on.

    It stands behind the access gate, which knows the caller. What the route would refuse the route
    refuses.
    """

    def __init__(self, app: ASGIApp, assets: Mapping[str, AssetReplica]) -> None:
        self.app = app
        self.assets = assets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass the request on."""
        response = await self._response(scope)
        if response is None:
            await self.app(scope, receive, send)
        else:
            await response(scope, receive, send)

    async def _response(self, scope: Scope) -> Response | None:
        if scope["type"] != "http" or scope["method"] != "GET" or scope["query_string"]:
            return None
        found = _PATH.fullmatch(scope["path"])
        asset = self.assets.get(found[1]) if found else None
        caller = known_caller(scope)
        if asset is None or caller is None or caller.role not in VIEWER:
            return None
        try:
            return await snapshot_response(asset, Headers(scope=scope).get("if-none-match"))
        except CellUnavailableError:
            return None
