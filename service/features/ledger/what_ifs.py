"""What-ifs that a user has kept: `keep` of ``POST /assets/{id}/forecasts``."""

from typing import Final

from anyio import to_thread

from service.domain.errors import RequestRefusedError
from service.domain.requests import ForecastRequest
from service.features.ledger.questions import what_if_to_keep
from service.features.ledger.tables import ForecastBatch, KeptForecasts
from service.security.audit_trail import PATIENCE_S
from service.store import AuditEntry, Outbox, Store
from service.store.forecast_records import IssuedForecast
from twin_core.verification import LEAD_TIMES_S

#: Kept what-ifs of an asset that may wait for their time.
MAX_WAITING: Final = 200

#: What a worker computes; `keep` gets the second part of its answer.
question = what_if_to_keep


def check(store: Store, asset: str, body: ForecastRequest) -> None:
    """Refuse what cannot be compared with anything, and more than a user can mean."""
    total_s = sum(step.duration_s for step in body.profile)
    if total_s < LEAD_TIMES_S[0]:
        raise RequestRefusedError(
            "/keep",
            f"the profile lasts {total_s:g} s, expected at least {LEAD_TIMES_S[0]} s, the shortest "
            "lead time",
        )
    if store.part(KeptForecasts).count_waiting(asset, "asked") >= MAX_WAITING:
        raise RequestRefusedError(
            "/keep", f"{MAX_WAITING} kept what-ifs of this asset wait for their time already"
        )


async def keep(outbox: Outbox, issued: IssuedForecast | None, line: AuditEntry) -> int:
    """Have a forecast written, and give its time; a store that is offline gets it from the disk."""
    if issued is None:
        raise RequestRefusedError("/keep", "the asset has no sensor of its model")
    outbox.record(ForecastBatch((issued,), line))
    await to_thread.run_sync(outbox.flush, PATIENCE_S, abandon_on_cancel=True)
    return issued.time_us
