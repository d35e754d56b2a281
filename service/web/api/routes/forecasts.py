"""Forecasts: the live one, and what-if."""

from collections.abc import Sequence
from typing import Final

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from service.documents.forecasts import LiveForecast, WhatIf
from service.domain.errors import NotReadyError, RequestRefusedError
from service.domain.requests import ForecastRequest
from service.domain.roles import OPERATOR, VIEWER
from service.web.api.access import secured
from service.web.api.deps import Asset, copy_response
from service.web.api.turns import caller_of, pieces_in_turn, turns_of, while_there

_PIECE_BYTES: Final = 1 << 16

router = APIRouter(prefix="/assets/{asset_id}", tags=["forecasts"])


@router.get(
    "/forecast",
    response_model=LiveForecast,
    summary="The latest live forecast",
    **secured(VIEWER, 404),
)
async def get_forecast(asset: Asset) -> Response:
    """Follow the controller's plan where it tells one, else hold the present point."""
    await asset.refresh("forecast")
    answer = copy_response(asset, "forecast")
    if answer.body == b"null":
        raise NotReadyError("there is no forecast yet: the twin waits for its first data")
    return answer


@router.post(
    "/forecasts",
    response_model=WhatIf,
    summary="What if: forecast a profile from the present state",
    **secured(OPERATOR, 404, audit=None),
)
async def post_forecast(asset: Asset, request: Request, body: ForecastRequest) -> Response:
    """Nothing is kept and nothing is commanded.

    One is computed at a time, and four more of each key may wait; keys take turns.
    """
    for number, name in enumerate(body.nodes or ()):
        if name not in asset.temperature_names:
            raise RequestRefusedError(
                f"/nodes/{number}",
                f"{name!r} is no sensor or node of this asset, expected one of "
                f"{', '.join(asset.temperature_names)}",
            )
    turns, caller = turns_of(request), caller_of(request)

    async def compute() -> Sequence[bytes]:
        answer = await turns.what_ifs.hold(
            caller, lambda: asset.what_if(body.profile, body.step_s, body.nodes)
        )
        return await turns.read(caller, _pieces_of, answer)

    pieces = await while_there(request, compute())
    return StreamingResponse(pieces_in_turn(pieces), media_type="application/json")


def _pieces_of(answer: WhatIf) -> list[bytes]:
    text = answer.to_bytes()
    return [text[begin : begin + _PIECE_BYTES] for begin in range(0, len(text), _PIECE_BYTES)]
