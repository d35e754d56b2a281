"""Nights in which the fleet was identified."""

from fastapi import APIRouter, Request
from starlette.responses import Response

from service.clock import wall_us
from service.domain.roles import ENGINEER
from service.features.nights.documents import NightDocument, NightsPage, nights_of
from service.features.nights.tables import FleetRuns
from service.web.api.access import secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Context, json_response

router = APIRouter(prefix="/fleet", tags=["fleet"])


@router.get(
    "/nights",
    response_model=NightsPage,
    summary="List identification nights of the fleet",
    **secured(ENGINEER),
)
def list_nights(
    request: Request, context: Context, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """Give what `bearing-twin fleet identify` did in the last 400 days, and does now."""
    nights = nights_of(context.store.part(FleetRuns).all())
    # By its first run, which stays: another one may begin between two pages.
    page, following = page_of(nights, limit, cursor, lambda runs: runs[-1].id)
    now_us = wall_us()
    answer = NightsPage(items=[NightDocument.of(runs, now_us) for runs in page], next=following)
    return json_response(answer, headers=next_link(request, following))
