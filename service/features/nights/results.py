"""What came of identifying a fleet: each asset once a night, kept as a job that has ended."""

from collections.abc import Collection
from dataclasses import asdict, dataclass, fields, replace

from sqlalchemy import Connection, func, insert, select

from service.domain.job_states import UNFINISHED
from service.store.alarm_records import AlarmTransition
from service.store.audit import add_line
from service.store.model_versions import activate_version, add_version
from service.store.part import StorePart, rows_of
from service.store.records import AuditEntry, Job, JsonDocument, ModelStatus
from service.store.tables import AlarmTransitionRow, JobRow, ModelVersionRow

_COLUMNS = tuple(getattr(JobRow, field.name) for field in fields(Job))


@dataclass(frozen=True, slots=True)
class NightModel:
    """A model version that a night's identification brought.

    It becomes active if `activate` says so and `instead_of`, the version that it was compared
    with, is still the active one (None: none is). ``{version}`` in the target of `line` and in the
    message of `event` stands for its number.
    """

    status: ModelStatus
    reason: str
    document: JsonDocument
    activate: bool = False
    instead_of: int | None = None
    comment: str = ""
    line: AuditEntry | None = None
    event: AlarmTransition | None = None


class Nights(StorePart):
    """Results of a night: one per asset at most, however often it is computed."""

    def done(self, night: str, assets: Collection[str]) -> dict[str, Job]:
        """Give the results of these assets that there are for a night."""
        query = select(*_COLUMNS).where(JobRow.idempotency_key == key_of(night))
        with self._database.reading() as connection:
            rows = rows_of(connection, JobRow.asset, query, assets)
        return {row.asset: Job(**row._mapping) for row in rows}

    def latest(self, assets: Collection[str]) -> dict[str, Job]:
        """Give the results of the last night that each of these assets has one of."""
        key, asset = JobRow.idempotency_key, JobRow.asset
        # A night is a date: the greatest is the last one. "!" comes right after the space.
        newest = (
            select(asset, func.max(key).label("key"))
            .where(key >= key_of(""), key < "fleet!")
            .group_by(asset)
            .subquery()
        )
        of_assets = select(newest.c.asset, newest.c.key)
        with self._database.reading() as connection:
            keys = rows_of(connection, newest.c.asset, of_assets, assets)
            query = select(*_COLUMNS).where(key.in_({row.key for row in keys}))
            rows = rows_of(connection, asset, query, [row.asset for row in keys])
        last = {row.asset: row.key for row in keys}
        found = (Job(**row._mapping) for row in rows)
        return {job.asset: job for job in found if job.idempotency_key == last[job.asset]}

    def busy(self, assets: Collection[str]) -> dict[str, Job]:
        """Give the jobs of these assets that are queued or running in a service."""
        query = select(*_COLUMNS).where(JobRow.status.in_(UNFINISHED))
        with self._database.reading() as connection:
            rows = rows_of(connection, JobRow.asset, query, assets)
        return {row.asset: Job(**row._mapping) for row in rows}

    def keep(self, night: str, job: Job, model: NightModel | None) -> Job | None:
        """Store a result with its model version, unless the asset has one of this night.

        All in one transaction: a process that is killed leaves all of it or nothing. Returns the
        job as it is in the store; None, and nothing is written, when there is a result already.

        - ``job``: that has ended; the number of the model version is put in.
        - ``model``: what came of it; None of a job that failed.
        """
        key = key_of(night)
        with self._database.writing() as connection:
            # One writer at a time, on every database: no other writes between look and insert.
            known = connection.scalar(
                select(JobRow.id).where(JobRow.asset == job.asset, JobRow.idempotency_key == key)
            )
            if known is not None:
                return None
            if model is not None:
                job = replace(job, model_version=_add_model(connection, job, model))
            job = replace(job, idempotency_key=key)
            values = {field.name: getattr(job, field.name) for field in fields(Job)}
            connection.execute(insert(JobRow).values(values))
        return job


def _add_model(connection: Connection, job: Job, model: NightModel) -> int:
    """Store the version of a job; returns its number."""
    asset, at_us = job.asset, job.ended_at_us or job.created_at_us
    number = add_version(connection, asset, model.status, model.reason, model.document, at_us)
    present = connection.scalar(
        select(ModelVersionRow.version).where(
            ModelVersionRow.asset == asset, ModelVersionRow.status == "active"
        )
    )
    # What became active meanwhile is not what the gates have compared with.
    if model.activate and model.instead_of == present:
        who = str(job.request["who"])
        activate_version(connection, asset, number, who, model.comment, at_us)
        if model.line is not None:
            target = model.line.target.replace("{version}", str(number))
            add_line(connection, replace(model.line, target=target))
    if model.event is not None:
        message = model.event.message.replace("{version}", str(number))
        event = asdict(replace(model.event, message=message))
        connection.execute(insert(AlarmTransitionRow).values(event))
    return number


def key_of(night: str) -> str:
    """Idempotency key of the jobs of a night."""
    return f"fleet {night}"
