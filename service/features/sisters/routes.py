"""What the other machines of an asset's family can teach it."""

from fastapi import APIRouter
from starlette.responses import Response

from service.clock import rfc3339
from service.domain.roles import ENGINEER
from service.features.sisters.documents import SisterLine, SisterList
from service.web.api.access import secured
from service.web.api.deps import Asset, Context, json_response

router = APIRouter(prefix="/assets/{asset_id}", tags=["models"])


@router.get(
    "/sisters",
    response_model=SisterList,
    summary="List sister machines",
    **secured(ENGINEER, 404),
)
def get_sisters(context: Context, asset: Asset) -> Response:
    """Other machines of the family that a model may learn from, and where they have been.

    What a version has learned from them, and whom it left out, stands in its `sisters`.
    """
    family = asset.summary().family
    records = []
    if family:
        records = context.store.sisters.summaries_of_family(family, asset.id)
    items = [
        SisterLine(
            asset=record.asset,
            machine=record.bearing_or_network,
            load_n_max=record.load_n_max,
            speed_rpm_max=record.speed_rpm_max,
            minutes=record.minutes,
            until=rfc3339(record.until_us),
        )
        for record in records
    ]
    return json_response(SisterList(family=family, items=items))
