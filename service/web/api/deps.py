"""What the routes take from the context."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Annotated

from anyio import to_thread
from fastapi import Depends, Path, Query
from starlette.requests import HTTPConnection
from starlette.responses import Response

from adapters.configuration import listed
from adapters.words import shown
from service.bus.replica import AssetReplica
from service.documents.base import Document
from service.documents.interfaces import DocumentKind
from service.domain.errors import CellUnavailableError
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.store import JournalFilter
from service.web.api.context import ServiceContext
from service.web.api.problems import Problem, parameter_problem


async def get_context(connection: HTTPConnection) -> ServiceContext:
    """Give the context that the application was made with."""
    context: ServiceContext = connection.app.state.context
    return context


async def get_authenticator(connection: HTTPConnection) -> Authenticator:
    """Give the keeper of keys and sessions."""
    authenticator: Authenticator = connection.app.state.authenticator
    return authenticator


async def get_trail(connection: HTTPConnection) -> AuditTrail:
    """Give the audit trail."""
    trail: AuditTrail = connection.app.state.trail
    return trail


Context = Annotated[ServiceContext, Depends(get_context)]
Keys = Annotated[Authenticator, Depends(get_authenticator)]
Trail = Annotated[AuditTrail, Depends(get_trail)]


async def get_asset(
    context: Context,
    asset_id: Annotated[
        str, Path(description="The asset's id in the configuration.", examples=["bench-1"])
    ],
) -> AssetReplica:
    """Give the asset that the path names."""
    asset = context.assets.get(asset_id)
    if asset is None and context.is_known(asset_id):
        raise CellUnavailableError(f"no cell follows asset {asset_id!r} at the moment")
    if asset is None:
        raise _no_asset(context, "asset_id", asset_id, 404)
    return asset


def _no_asset(context: ServiceContext, parameter: str, name: str, status: int) -> Problem:
    known = listed(context.assets) or "none"
    return parameter_problem(parameter, f"no asset {shown(name)}; there is: {known}", status)


Asset = Annotated[AssetReplica, Depends(get_asset)]


@dataclass(frozen=True, slots=True)
class RecordedAsset:
    """An asset of which the store has a history; one that is not followed has no channels."""

    id: str
    channels: Collection[str]


async def get_recorded(
    context: Context,
    asset_id: Annotated[
        str,
        Path(description="The asset's id; also of one that was removed.", examples=["bench-1"]),
    ],
) -> RecordedAsset:
    """Give the asset that the path names, also where only its history is left."""
    if asset_id not in context.assets and not context.is_known(asset_id):
        recorded = context.store.samples.with_history
        if await to_thread.run_sync(recorded, [asset_id]):
            return RecordedAsset(asset_id, ())
    asset = await get_asset(context, asset_id)
    return RecordedAsset(asset.id, asset.channels)


Recorded = Annotated[RecordedAsset, Depends(get_recorded)]


async def get_asset_filter(
    context: Context, asset: Annotated[str | None, Query(description="Only of this asset.")] = None
) -> str | None:
    """Give the name of the only asset that is asked for; one that does not exist has no answer."""
    if asset is None or asset in context.assets:
        return asset
    if context.is_known(asset):
        raise CellUnavailableError(f"no cell follows asset {asset!r} at the moment")
    raise _no_asset(context, "asset", asset, 422)


async def get_recorded_filter(
    context: Context,
    asset: Annotated[
        str | None, Query(description="Only of this asset; also of one that was removed.")
    ] = None,
) -> str | None:
    """As `get_asset_filter`, also where only history or journal is left of the asset."""

    def is_recorded(name: str) -> bool:
        store = context.store
        lines = store.alarms.journal(JournalFilter(name), 1).items
        return bool(lines or store.samples.with_history([name]))

    if asset is None or asset in context.assets or context.is_known(asset):
        return asset
    if not await to_thread.run_sync(is_recorded, asset):
        raise _no_asset(context, "asset", asset, 422)
    return asset


AssetFilter = Annotated[str | None, Depends(get_asset_filter)]
RecordedFilter = Annotated[str | None, Depends(get_recorded_filter)]


def copy_response(asset: AssetReplica, kind: DocumentKind) -> Response:
    """Answer with a document of the cell, as it came."""
    text, _ = asset.text(kind)
    return Response(text, media_type="application/json")


def json_response(
    answer: Document, status: int = 200, headers: Mapping[str, str] | None = None
) -> Response:
    """Answer with a document."""
    return Response(answer.to_bytes(), status, headers=headers, media_type="application/json")
