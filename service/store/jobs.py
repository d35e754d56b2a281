"""Identification jobs: rows, so that a job outlives the service that started it."""

from collections.abc import Collection
from dataclasses import fields, replace
from typing import Unpack
from uuid import uuid4

from sqlalchemy import insert, select, update

from service.domain.job_states import UNFINISHED, JobStatus
from service.store.audit import add_line
from service.store.errors import ActiveJobError
from service.store.part import StorePart
from service.store.records import AuditEntry, Job, JobChanges, JsonDocument
from service.store.tables import JobRow

_COLUMNS = tuple(getattr(JobRow, field.name) for field in fields(Job))


class Jobs(StorePart):
    """At most one job per asset is unfinished, and a job that has ended never changes again."""

    def add(
        self,
        asset: str,
        request: JsonDocument,
        created_at_us: int,
        idempotency_key: str | None = None,
        line: AuditEntry | None = None,
    ) -> tuple[Job, bool]:
        """Queue a job.

        Returns the job, new or the one that the key already stands for, and whether it is new. The
        line of the audit trail is written with a new job; its target then names the job. Raises
        `ActiveJobError` if another job of the asset is queued or running; `NotOwnerError` if
        another cell owns the asset.

        - ``request``: what was asked for; plain JSON values.
        - ``idempotency_key``: a second call for the asset with the same key gives the first job
          back.
        """
        job = Job(
            id=uuid4().hex,
            asset=asset,
            status="queued",
            progress=0.0,
            best_fitness=None,
            evaluations=0,
            created_at_us=created_at_us,
            started_at_us=None,
            ended_at_us=None,
            error=None,
            model_version=None,
            request=request,
            idempotency_key=idempotency_key,
            attempts=0,
        )
        with self._database.writing() as connection:
            self._require(connection, asset)
            if idempotency_key is not None:
                known = connection.execute(
                    select(*_COLUMNS).where(
                        JobRow.asset == asset, JobRow.idempotency_key == idempotency_key
                    )
                ).one_or_none()
                if known:
                    return Job(**known._mapping), False
            in_the_way = connection.scalar(
                select(JobRow.id).where(JobRow.asset == asset, JobRow.status.in_(UNFINISHED))
            )
            if in_the_way is not None:
                raise ActiveJobError(in_the_way)
            values = {field.name: getattr(job, field.name) for field in fields(Job)}
            connection.execute(insert(JobRow).values(values))
            if line is not None:
                add_line(connection, replace(line, target=f"{line.target}, made {job.id}"))
        return job, True

    def update(
        self,
        job_id: str,
        *,
        only_if: Collection[JobStatus] = UNFINISHED,
        line: AuditEntry | None = None,
        **changes: Unpack[JobChanges],
    ) -> Job | None:
        """Change a job, provided that its status is still one of those expected.

        The comparison and the change are one: of two that want to end a job only one does. To take
        up a job again after a restart: ``update_job(id, only_if=["running"], status="queued")``.
        Returns the changed job; None when there is no such job or its status is another.

        - ``only_if``: statuses in which the change may happen; by default the job must not have
          ended.
        - ``changes``: the fields to change, see `JobChanges`.
        """
        with self._database.writing() as connection:
            row = connection.execute(
                update(JobRow)
                .where(JobRow.id == job_id, JobRow.status.in_(only_if))
                .values(**changes)
                .returning(*_COLUMNS)
            ).one_or_none()
            if row is not None:
                self._require(connection, row.asset)
            add_line(connection, line if row else None)
        return Job(**row._mapping) if row else None

    def get(self, job_id: str) -> Job | None:
        """One job, or None when there is none of this id."""
        with self._database.reading() as connection:
            row = connection.execute(select(*_COLUMNS).where(JobRow.id == job_id)).one_or_none()
        return Job(**row._mapping) if row else None

    def of_asset(self, asset: str) -> list[Job]:
        """All jobs of an asset, newest first."""
        query = (
            select(*_COLUMNS)
            .where(JobRow.asset == asset)
            .order_by(JobRow.created_at_us.desc(), JobRow.id)
        )
        with self._database.reading() as connection:
            return [Job(**row._mapping) for row in connection.execute(query)]

    def unfinished(self) -> list[Job]:
        """All jobs that are queued or running, oldest first; after a restart: to be taken up."""
        query = (
            select(*_COLUMNS)
            .where(JobRow.status.in_(UNFINISHED))
            .order_by(JobRow.created_at_us, JobRow.id)
        )
        with self._database.reading() as connection:
            return [Job(**row._mapping) for row in connection.execute(query)]
