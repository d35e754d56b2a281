"""A night, a machine that is ready for it, and how its result is stored."""

from collections.abc import Callable
from dataclasses import dataclass
from uuid import uuid4

from adapters.protocol import Clock
from service.alarms.records import event_line
from service.clock import rfc3339
from service.features.nights.batches import (
    MachineOrder,
    MachineResult,
)
from service.features.nights.results import NightModel, Nights
from service.jobs.comparison import change_line, with_drift
from service.jobs.models import identified_document
from service.site.asset_section import AssetSection
from service.store import AuditEntry, Store
from service.store.records import Job, ModelVersion


@dataclass(frozen=True, slots=True)
class Night:
    """What all machines of a run share.

    Attributes
    ----------
    name : str
        The same for all runs of one night; see `service.features.nights.identification.night_of`.
    store, clock
        Where data and models are; process time.
    who : str
        Who asked for it.
    audit : callable
        Makes a line of the audit trail from action, target and detail.
    chosen : str
        Which assets, for the audit trail.
    """

    name: str
    store: Store
    clock: Clock
    who: str
    audit: Callable[[str, str, str], AuditEntry]
    chosen: str = "all assets"


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A machine that is ready for a worker, and what its result is stored with."""

    order: MachineOrder
    settings: AssetSection
    spans_us: list[tuple[int, int]]
    active: ModelVersion | None
    began_us: int


def store_result(night: Night, prepared: Prepared, result: MachineResult) -> Job | None:
    """Store what came of a machine; None where the asset has a result of this night already."""
    found = result.found
    now_us = night.clock.now_us()
    job = Job(
        id=uuid4().hex,
        asset=result.asset,
        status="failed" if found is None else "succeeded",
        progress=0.0 if found is None else 1.0,
        best_fitness=None if found is None else found.best_fitness,
        evaluations=0 if found is None else found.evaluations,
        created_at_us=prepared.began_us,
        started_at_us=prepared.began_us,
        ended_at_us=now_us,
        error=result.error or None,
        model_version=None,
        request={
            "windows": [
                {"start": rfc3339(start), "end": rfc3339(end)} for start, end in prepared.spans_us
            ],
            "windows_us": prepared.spans_us,
            "method": result.method,
            "seed": prepared.order.seed,
            "budget": None,
            "who": night.who,
        },
        idempotency_key=None,
        attempts=1,
    )
    if found is None:
        return night.store.part(Nights).keep(night.name, job, None)
    settings, active = prepared.settings, prepared.active
    reason = with_drift(found.gates.reason, found.drift)
    model = NightModel(
        status="candidate" if found.gates.accepted else "rejected",
        reason=reason,
        document=identified_document(job, found, settings),
        activate=found.gates.accepted and settings.identification.ladder == "apply",
        instead_of=None if active is None else active.version,
        comment=reason,
        line=night.audit("model.activate", f"asset {settings.id}, version {{version}}", reason),
        event=event_line(
            settings.id,
            "model drift",
            change_line("{version}", found.drift.text),
            now_us,
            night.who,
        )
        if found.drift.changed
        else None,
    )
    return night.store.part(Nights).keep(night.name, job, model)
