"""The fleet: summaries of thousands of assets, in answers of a bounded size."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from adapters.configuration import listed
from adapters.words import shown
from service.documents.fleet import STATES, FleetMap, FleetPage, FleetState
from service.domain.roles import VIEWER
from service.web.api.access import secured
from service.web.api.cursors import (
    LIMIT,
    Cursor,
    Limit,
    decode_cursor,
    encode_cursor,
    next_link,
)
from service.web.api.deps import Context, json_response
from service.web.api.entity_tags import CONDITIONAL, IfNoneMatch, conditional_response
from service.web.api.problems import parameter_problem
from service.web.overview import Fit, Place, Sort

router = APIRouter(prefix="/fleet", tags=["fleet"])


@router.get(
    "",
    response_model=FleetPage,
    summary="List asset summaries, the most urgent first",
    **secured(VIEWER),
)
async def list_fleet(
    request: Request,
    context: Context,
    group: Annotated[str | None, Query(max_length=200, description="Of this group.")] = None,
    family: Annotated[str | None, Query(max_length=200, description="Of this family.")] = None,
    search: Annotated[
        str, Query(max_length=200, description="Text in id, name, group, family or bearing.")
    ] = "",
    state: Annotated[
        list[FleetState], Query(max_length=len(STATES), description="In one of these states.")
    ] = [],  # noqa: B006
    attention: Annotated[
        bool | None, Query(description="Only what needs attention (or only the others).")
    ] = None,
    sort: Annotated[
        Sort,
        Query(
            description="`urgency`: an unacknowledged alarm by priority, over a limit, the "
            "shortest time to a limit, lost data, unknown, a model that is not trusted, not "
            "identified or drifted; then the others."
        ),
    ] = "urgency",
    limit: Limit = LIMIT,
    cursor: Cursor = None,
) -> Response:
    """Give a page of assets, with counts of all that fit.

    While this is polled, each asset is at most `age_s` old here: 1 to 2 s with hundreds of assets,
    longer with thousands. An alarm is seen at once.
    """
    place = None if cursor is None else decode_cursor(cursor, Place)
    if place is not None and place.sort != sort:
        raise parameter_problem("cursor", f"expected a cursor of the order {sort!r}")
    _require(context, "group", group)
    _require(context, "family", family)
    fit = Fit(group, family, search, frozenset(state), attention)
    page, following = context.fleet.page(fit, sort, limit, place)
    page.next = None if following is None else encode_cursor(following)
    return json_response(page, headers=next_link(request, page.next))


def _require(context: Context, parameter: Literal["group", "family"], name: str | None) -> None:
    """Refuse a group or a family that no asset has: it has no answer."""
    if name is None:
        return
    there = context.fleet.names_of(parameter, name)
    if name not in there:
        known = listed(sorted(there)) or "none"
        raise parameter_problem(parameter, f"no {parameter} {shown(name)}; there is: {known}")


@router.get(
    "/map",
    response_model=FleetMap,
    summary="Get the state of every asset, one character each",
    **secured(VIEWER, responses=CONDITIONAL),
)
async def get_fleet_map(context: Context, if_none_match: IfNoneMatch = None) -> Response:
    """Give the states in the order of the ids, as `GET /fleet?sort=id` lists the assets."""
    return conditional_response(context.fleet.map(), if_none_match)
