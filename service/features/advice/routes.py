"""Excitation advice: what to run next to learn about a high-risk point."""

from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from service.domain.requests import MAX_PROFILE_HOURS
from service.domain.roles import ENGINEER
from service.features.advice import questions
from service.features.advice.documents import AdviceDocument
from service.web.api.access import secured
from service.web.api.deps import Asset, json_response
from service.web.api.turns import study

router = APIRouter(prefix="/assets/{asset_id}", tags=["planning"])


@router.get(
    "/advice",
    response_model=AdviceDocument,
    summary="Get advice on the next low-risk step",
    **secured(ENGINEER, 404, 409),
)
async def get_advice(
    asset: Asset,
    request: Request,
    speed_rpm: Annotated[
        float,
        Query(
            gt=0,
            le=20_000,
            allow_inf_nan=False,
            description="Speed of the point in revolutions per minute.",
            examples=[6200],
        ),
    ],
    load_n: Annotated[
        float,
        Query(
            ge=0,
            le=200_000,
            allow_inf_nan=False,
            description="Radial load of the point in newtons.",
            examples=[5500],
        ),
    ],
    duration_s: Annotated[
        float,
        Query(
            gt=0,
            le=MAX_PROFILE_HOURS * 3600,
            allow_inf_nan=False,
            description="How long the point is to be held, in seconds.",
            examples=[7200],
        ),
    ] = 7200.0,
    half_width_k: Annotated[
        float | None,
        Query(
            gt=0,
            le=1000,
            allow_inf_nan=False,
            description="How narrow the forecast is to become: half the width of its 95 % interval "
            "at the end of the point, in kelvins. No step is proposed once that is reached.",
            examples=[5],
        ),
    ] = None,
) -> Response:
    """Name the next step, rank all, say which are refused and why, and give the stop rule.

    409 before the first identification: there is nothing yet that a step could improve.
    """
    point = speed_rpm, load_n, duration_s, half_width_k
    what = "advice", await asset.model_version(), point
    return json_response(await study(request, asset, what, questions.advice, *point))
