"""Model versions of each asset, and the journal of which one was active when."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, func, insert, select, update

from service.store.audit import add_line
from service.store.part import StorePart, rows_of
from service.store.records import (
    Activation,
    AuditEntry,
    FirstModel,
    JsonDocument,
    ModelStatus,
    ModelVersion,
)
from service.store.tables import ActivationRow, ModelVersionRow

_VERSION_COLUMNS = (
    ModelVersionRow.asset,
    ModelVersionRow.version,
    ModelVersionRow.status,
    ModelVersionRow.reason,
    ModelVersionRow.created_at_us,
    ModelVersionRow.document,
)


class ModelVersions(StorePart):
    """Models are only ever added; exactly one per asset may be active."""

    def add(
        self,
        asset: str,
        status: ModelStatus,
        reason: str,
        document: JsonDocument,
        created_at_us: int,
    ) -> int:
        """Store a new model and return its version, counted from 1 per asset.

        ``status``: "candidate" or "rejected"; a model becomes active through `activate` alone.
        Raises `ValueError` if the status is "active" or "retired"; `NotOwnerError` if another cell
        owns the asset.
        """
        with self._database.writing() as connection:
            self._require(connection, asset)
            return add_version(connection, asset, status, reason, document, created_at_us)

    def versions(self, asset: str) -> list[ModelVersion]:
        """All models of an asset, oldest first."""
        query = (
            select(*_VERSION_COLUMNS)
            .where(ModelVersionRow.asset == asset)
            .order_by(ModelVersionRow.version)
        )
        with self._database.reading() as connection:
            return [ModelVersion(**row._mapping) for row in connection.execute(query)]

    def parts(
        self, asset: str, paths: Sequence[tuple[str, ...]], newest: int
    ) -> list[ModelVersion]:
        """Give so many of the newest models of an asset, oldest first, with parts of documents.

        ``paths``: keys from the outside in; what a document does not have there is left out.
        """
        columns = [
            ModelVersionRow.document[path].label(f"part_{k}") for k, path in enumerate(paths)
        ]
        query = (
            select(*_VERSION_COLUMNS[:-1], *columns)
            .where(ModelVersionRow.asset == asset)
            .order_by(ModelVersionRow.version.desc())
            .limit(newest)
        )
        with self._database.reading() as connection:
            rows = connection.execute(query).all()
        known = len(_VERSION_COLUMNS) - 1
        return [
            ModelVersion(
                asset=row.asset,
                version=row.version,
                status=row.status,
                reason=row.reason,
                created_at_us=row.created_at_us,
                document=_nested(paths, row[known:]),
            )
            for row in rows[::-1]
        ]

    def version(self, asset: str, version: int) -> ModelVersion | None:
        """One model, or None when there is none of this version."""
        with self._database.reading() as connection:
            return _one(connection, asset, version)

    def active(self, asset: str) -> ModelVersion | None:
        """Give the active model of an asset, or None before the first activation."""
        query = select(*_VERSION_COLUMNS).where(
            ModelVersionRow.asset == asset, ModelVersionRow.status == "active"
        )
        with self._database.reading() as connection:
            row = connection.execute(query).one_or_none()
        return ModelVersion(**row._mapping) if row else None

    def active_of(self, assets: Collection[str]) -> dict[str, ModelVersion]:
        """Give the active models of some assets, as far as there are any."""
        query = select(*_VERSION_COLUMNS).where(ModelVersionRow.status == "active")
        with self._database.reading() as connection:
            rows = rows_of(connection, ModelVersionRow.asset, query, assets)
        return {row.asset: ModelVersion(**row._mapping) for row in rows}

    def active_numbers(self) -> dict[str, int]:
        """Give the number of the active version of every asset."""
        query = select(ModelVersionRow.asset, ModelVersionRow.version).where(
            ModelVersionRow.status == "active"
        )
        with self._database.reading() as connection:
            return {row.asset: row.version for row in connection.execute(query)}

    def begin(
        self, models: Mapping[str, FirstModel], who: str, at_us: int
    ) -> dict[str, ModelVersion]:
        """Store a model of each of these assets and make it the active one, all at once."""
        with self._database.writing() as connection:
            for asset in models if self._database.fence is not None else ():
                self._require(connection, asset)
            newest = select(
                ModelVersionRow.asset, func.max(ModelVersionRow.version).label("version")
            ).group_by(ModelVersionRow.asset)
            rows = rows_of(connection, ModelVersionRow.asset, newest, models)
            last = {row.asset: row.version for row in rows}
            made = {
                asset: ModelVersion(
                    asset, last.get(asset, 0) + 1, "active", model.comment, at_us, model.document
                )
                for asset, model in models.items()
            }
            for asset in last:
                connection.execute(
                    update(ModelVersionRow)
                    .where(ModelVersionRow.asset == asset, ModelVersionRow.status == "active")
                    .values(status="retired", reason=f"replaced by version {made[asset].version}")
                )
            connection.execute(
                insert(ModelVersionRow),
                [
                    {column.key: getattr(one, column.key) for column in _VERSION_COLUMNS}
                    for one in made.values()
                ],
            )
            connection.execute(
                insert(ActivationRow),
                [
                    {
                        "asset": asset,
                        "version": one.version,
                        "at_us": at_us,
                        "who": who,
                        "comment": one.reason,
                    }
                    for asset, one in made.items()
                ],
            )
        return made

    def activate(
        self,
        asset: str,
        version: int,
        who: str,
        comment: str,
        at_us: int,
        line: AuditEntry | None = None,
    ) -> ModelVersion:
        """Make a version the active one; the one before it is retired. Also rolls back.

        Whether a rejected model may be activated is for the caller to decide. Activating the active
        version again changes nothing and leaves no line in the journal. The line of the audit trail
        is written in the same transaction, also for a version that is active already. Raises
        `KeyError` if there is no such version; `NotOwnerError` if another cell owns the asset.
        """
        with self._database.writing() as connection:
            self._require(connection, asset)
            add_line(connection, line)
            activate_version(connection, asset, version, who, comment, at_us)
            active = _one(connection, asset, version)
        assert active is not None  # noqa: S101 - it was there two lines above
        return active

    def activations(self, asset: str) -> list[Activation]:
        """Read the journal of activations of an asset, oldest first."""
        query = (
            select(
                ActivationRow.asset,
                ActivationRow.version,
                ActivationRow.at_us,
                ActivationRow.who,
                ActivationRow.comment,
            )
            .where(ActivationRow.asset == asset)
            .order_by(ActivationRow.id)
        )
        with self._database.reading() as connection:
            return [Activation(**row._mapping) for row in connection.execute(query)]


def _nested(paths: Sequence[tuple[str, ...]], values: Sequence[Any]) -> JsonDocument:
    """A document of values at their paths, without those that are None."""
    document: JsonDocument = {}
    for (*outer, last), value in zip(paths, values, strict=True):
        if value is not None:
            within = document
            for key in outer:
                within = within.setdefault(key, {})
            within[last] = value
    return document


def add_version(
    connection: Connection,
    asset: str,
    status: ModelStatus,
    reason: str,
    document: JsonDocument,
    created_at_us: int,
) -> int:
    """Store a new model within a transaction; see `ModelVersions.add`."""
    if status not in ("candidate", "rejected"):
        raise ValueError(f"status {status!r}: a new model is 'candidate' or 'rejected'")
    last = connection.scalar(
        select(func.max(ModelVersionRow.version)).where(ModelVersionRow.asset == asset)
    )
    version = (last or 0) + 1
    connection.execute(
        insert(ModelVersionRow).values(
            asset=asset,
            version=version,
            status=status,
            reason=reason,
            created_at_us=created_at_us,
            document=document,
        )
    )
    return version


def activate_version(
    connection: Connection, asset: str, version: int, who: str, comment: str, at_us: int
) -> None:
    """Make a version the active one within a transaction; see `ModelVersions.activate`."""
    status = connection.scalar(
        select(ModelVersionRow.status).where(
            ModelVersionRow.asset == asset, ModelVersionRow.version == version
        )
    )
    if status is None:
        raise KeyError(f"asset {asset!r} has no model version {version}")
    if status == "active":
        return
    connection.execute(
        update(ModelVersionRow)
        .where(ModelVersionRow.asset == asset, ModelVersionRow.status == "active")
        .values(status="retired", reason=f"replaced by version {version}")
    )
    connection.execute(
        update(ModelVersionRow)
        .where(ModelVersionRow.asset == asset, ModelVersionRow.version == version)
        .values(status="active", reason=comment)
    )
    connection.execute(
        insert(ActivationRow).values(
            asset=asset, version=version, at_us=at_us, who=who, comment=comment
        )
    )


def _one(connection: Connection, asset: str, version: int) -> ModelVersion | None:
    row = connection.execute(
        select(*_VERSION_COLUMNS).where(
            ModelVersionRow.asset == asset, ModelVersionRow.version == version
        )
    ).one_or_none()
    return ModelVersion(**row._mapping) if row else None
