"""Forecasts: the live one, and what-if."""

from fastapi import APIRouter
from starlette.responses import Response

from service.api.access import secured
from service.api.bodies import LiveForecast, WhatIf
from service.api.context import ForecastRequest, NotReadyError, RequestRefusedError
from service.api.deps import Asset, json_response
from service.security.roles import OPERATOR, VIEWER

router = APIRouter(prefix="/assets/{asset_id}", tags=["forecasts"])


@router.get(
    "/forecast",
    response_model=LiveForecast,
    summary="The latest live forecast",
    **secured(VIEWER, 404),
)
async def get_forecast(asset: Asset) -> Response:
    """Follow the controller's plan where it tells one, else hold the present point."""
    forecast = asset.forecast()
    if forecast is None:
        raise NotReadyError("there is no forecast yet: the twin waits for its first data")
    return json_response(forecast)


@router.post(
    "/forecasts",
    response_model=WhatIf,
    summary="What if: forecast a profile from the present state",
    **secured(OPERATOR, 404, audit=None),
)
async def post_forecast(asset: Asset, request: ForecastRequest) -> Response:
    """Answer at once; nothing is kept and nothing is commanded."""
    for number, name in enumerate(request.nodes or ()):
        if name not in asset.temperature_names:
            raise RequestRefusedError(
                f"/nodes/{number}",
                f"{name!r} is no sensor or node of this asset, expected one of "
                f"{', '.join(asset.temperature_names)}",
            )
    answer = await asset.what_if(request.profile, request.step_s, request.nodes)
    return json_response(answer)
