"""Forecasts: the live one, and what-if."""

from collections.abc import Sequence
from types import ModuleType
from typing import Final

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from service.clock import rfc3339
from service.documents.forecasts import LiveForecast, WhatIf, WhatIfAnswer
from service.domain.errors import NotReadyError, RequestRefusedError
from service.domain.requests import ForecastRequest
from service.domain.roles import OPERATOR, VIEWER
from service.feature_folders import modules
from service.web import worker
from service.web.api.access import secured
from service.web.api.deps import Asset, Context, copy_response
from service.web.api.trail import line_of, log_line
from service.web.api.turns import caller_of, pieces_in_turn, turns_of, while_there

_PIECE_BYTES: Final = 1 << 16

router = APIRouter(prefix="/assets/{asset_id}", tags=["forecasts"])


@router.get(
    "/forecast",
    response_model=LiveForecast,
    summary="Get the latest live forecast",
    **secured(VIEWER, 404),
)
async def get_forecast(asset: Asset) -> Response:
    """Use the controller's plan if present, otherwise the current operating point."""
    await asset.refresh("forecast")
    answer = copy_response(asset, "forecast")
    if answer.body == b"null":
        raise NotReadyError("there is no forecast yet: the twin waits for its first data")
    return answer


@router.post(
    "/forecasts",
    response_model=WhatIfAnswer,
    summary="Forecast a profile from the current state",
    **secured(OPERATOR, 404, audit=None),
)
async def post_forecast(
    context: Context, asset: Asset, request: Request, body: ForecastRequest
) -> Response:
    """Nothing is commanded, and nothing is kept unless `keep` asks for it.

    What is kept is compared with what comes, if the machine follows the profile from now on; see
    `GET …/forecasts`.

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

    keeper = _keeper() if body.keep else None
    if keeper is not None:
        await turns.read(caller, keeper.check, context.store, asset.id, body)

    asked = body.profile, body.step_s, body.nodes

    async def compute() -> Sequence[bytes]:
        kept_at: str | None = None
        if keeper is None:
            found = await turns.what_ifs.hold(caller, lambda: asset.compute(worker.what_if, *asked))
        else:
            found, issued = await turns.what_ifs.hold(
                caller, lambda: asset.compute(keeper.question, *asked)
            )
            line = await line_of(request, "forecast.keep")
            kept_at = rfc3339(await keeper.keep(context.outbox, issued, line))
            log_line(line)
        return await turns.read(caller, _pieces_of, found, kept_at)

    pieces = await while_there(request, compute())
    return StreamingResponse(pieces_in_turn(pieces), media_type="application/json")


def _keeper() -> ModuleType:
    """The module of a feature that keeps what-ifs."""
    for _, keeper in modules("what_ifs"):
        return keeper
    raise RequestRefusedError("/keep", "no feature of this service keeps forecasts")


def _pieces_of(found: WhatIf, kept_at: str | None) -> list[bytes]:
    text = WhatIfAnswer(**dict(found), kept_at=kept_at).to_bytes()
    return [text[begin : begin + _PIECE_BYTES] for begin in range(0, len(text), _PIECE_BYTES)]
