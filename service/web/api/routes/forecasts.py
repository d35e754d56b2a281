"""Forecasts: the live one, and what-if."""

from collections.abc import Sequence
from typing import Final

from anyio import to_thread
from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from service.clock import rfc3339
from service.documents.forecasts import LiveForecast, WhatIf, WhatIfAnswer
from service.domain.errors import NotReadyError, RequestRefusedError
from service.domain.requests import ForecastRequest
from service.domain.roles import OPERATOR, VIEWER
from service.security.audit_trail import PATIENCE_S
from service.store import Outbox, Store
from service.store.outbox import ForecastBatch
from service.web.api.access import secured
from service.web.api.deps import Asset, Context, copy_response
from service.web.api.trail import line_of, log_line
from service.web.api.turns import caller_of, pieces_in_turn, turns_of, while_there
from twin_core.verification import LEAD_TIMES_S

_PIECE_BYTES: Final = 1 << 16
#: Kept what-ifs of an asset that may wait for their time.
MOST_ASKED: Final = 200

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
    response_model=WhatIfAnswer,
    summary="What if: forecast a profile from the present state",
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

    if body.keep:
        await turns.read(caller, _check_room, context.store, asset.id, body)

    async def compute() -> Sequence[bytes]:
        if body.keep:
            found, issued = await turns.what_ifs.hold(
                caller, lambda: asset.what_if_to_keep(body.profile, body.step_s, body.nodes)
            )
            if issued is None:
                raise RequestRefusedError("/keep", "the asset has no sensor of its model")
            line = await line_of(request, "forecast.keep")
            await _keep(context.outbox, ForecastBatch((issued,), line))
            log_line(line)
        else:
            found, issued = (
                await turns.what_ifs.hold(
                    caller, lambda: asset.what_if(body.profile, body.step_s, body.nodes)
                ),
                None,
            )
        kept_at = None if issued is None else rfc3339(issued.time_us)
        return await turns.read(caller, _pieces_of, found, kept_at)

    pieces = await while_there(request, compute())
    return StreamingResponse(pieces_in_turn(pieces), media_type="application/json")


def _check_room(store: Store, asset: str, body: ForecastRequest) -> None:
    """Refuse what cannot be compared with anything, and more than anybody can mean."""
    total_s = sum(step.duration_s for step in body.profile)
    if total_s < LEAD_TIMES_S[0]:
        raise RequestRefusedError(
            "/keep",
            f"the profile lasts {total_s:g} s, expected at least {LEAD_TIMES_S[0]} s, the shortest "
            "lead time",
        )
    if store.forecasts.count_waiting(asset, "asked") >= MOST_ASKED:
        raise RequestRefusedError(
            "/keep", f"{MOST_ASKED} kept what-ifs of this asset wait for their time already"
        )


async def _keep(outbox: Outbox, batch: ForecastBatch) -> None:
    """Have a forecast written; a store that does not answer gets it later, from the disk."""
    outbox.record(batch)
    await to_thread.run_sync(outbox.flush, PATIENCE_S, abandon_on_cancel=True)


def _pieces_of(found: WhatIf, kept_at: str | None) -> list[bytes]:
    text = WhatIfAnswer(**dict(found), kept_at=kept_at).to_bytes()
    return [text[begin : begin + _PIECE_BYTES] for begin in range(0, len(text), _PIECE_BYTES)]
