"""The forecast ledger: what was forecast, what came of it, and how good it was."""

from typing import Annotated, Final

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from service.domain.roles import VIEWER
from service.domain.times import Instant
from service.features.ledger.documents import (
    ForecastPerformance,
    KeptForecastList,
    Risk,
    forecast_performance,
    kept_forecasts,
)
from service.features.ledger.tables import KeptForecasts
from service.store import Store
from service.web.api.access import secured
from service.web.api.cursors import Before, Cursor, decode_cursor, encode_cursor, next_link
from service.web.api.deps import Context, Recorded, json_response
from service.web.api.turns import caller_of, turns_of

router = APIRouter(prefix="/assets/{asset_id}", tags=["forecasts"])

_LIMIT: Final = 50
_LIMIT_MAX: Final = 500


@router.get(
    "/forecast-performance",
    response_model=ForecastPerformance,
    summary="Get forecast performance",
    **secured(VIEWER, 404),
)
async def get_performance(
    context: Context,
    asset: Recorded,
    request: Request,
    lead_time_s: Annotated[
        int | None,
        Query(ge=1, le=2**31 - 1, description="Only this lead time.", examples=[3600]),
    ] = None,
    risk: Annotated[Risk | None, Query(description="Only this risk.")] = None,
    version: Annotated[
        int | None, Query(ge=1, le=2**31 - 1, description="Only this model version.")
    ] = None,
    start: Annotated[
        Instant | None, Query(description="Only forecasts made from this process time on.")
    ] = None,
) -> Response:
    """Kept forecasts against what was measured, where the machine followed their plan."""

    def score() -> ForecastPerformance:
        stored = context.store.part(KeptForecasts).since(asset.id, start or 0, version)
        return forecast_performance(stored, lead_time_s, risk)

    return json_response(await turns_of(request).read(caller_of(request), score))


@router.get(
    "/forecasts",
    response_model=KeptForecastList,
    summary="List stored forecasts",
    **secured(VIEWER, 404),
)
async def list_forecasts(
    context: Context,
    asset: Recorded,
    request: Request,
    limit: Annotated[int, Query(ge=1, le=_LIMIT_MAX, description="Items of a page.")] = _LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Each with its quantiles and simple forecasts at a few lead times, and what came of it."""
    before = None if cursor is None else decode_cursor(cursor, Before).before
    answer = await turns_of(request).read(
        caller_of(request), _page, context.store, asset.id, limit, before
    )
    return json_response(answer, headers=next_link(request, answer.next))


def _page(store: Store, asset: str, limit: int, before: int | None) -> KeptForecastList:
    page = store.part(KeptForecasts).page(asset, limit, before)
    following = page.next_cursor
    return kept_forecasts(
        page, None if following is None else encode_cursor(Before(before=following))
    )
