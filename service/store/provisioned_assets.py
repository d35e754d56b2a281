"""Assets that are not in the configuration file: made by REST or by command while it runs."""

import json
from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy import Connection, Row, Select, bindparam, func, insert, select, text, update

from service.domain.errors import ChangedMeanwhileError
from service.store.audit import add_line
from service.store.part import StorePart, rows_of
from service.store.records import AuditEntry, ProvisionedAsset
from service.store.tables import ProvisionedAssetRow

_COLUMNS = (
    ProvisionedAssetRow.id,
    ProvisionedAssetRow.document,
    ProvisionedAssetRow.revision,
    ProvisionedAssetRow.changed_us,
    ProvisionedAssetRow.removed_us,
    ProvisionedAssetRow.added_us,
)


class ProvisionedAssets(StorePart):
    """Tables of assets as a configuration file would hold them, unchecked.

    Each change gets a revision, greater than all before: who knows one asks for what is newer.
    """

    def present(self) -> list[ProvisionedAsset]:
        """All that there are, by id."""
        return self._found(
            select(*_COLUMNS)
            .where(ProvisionedAssetRow.document.is_not(None))
            .order_by(ProvisionedAssetRow.id)
        )

    def get(self, asset_id: str) -> ProvisionedAsset | None:
        """One of them; None when there is none of this id."""
        found = self._found(
            select(*_COLUMNS).where(
                ProvisionedAssetRow.id == asset_id, ProvisionedAssetRow.document.is_not(None)
            )
        )
        return found[0] if found else None

    def once_removed(self, ids: Collection[str] | None = None) -> list[ProvisionedAsset]:
        """Those that were removed, also where they were added again, by id; of some ids or all."""
        query = (
            select(*_COLUMNS)
            .where(ProvisionedAssetRow.removed_us.is_not(None))
            .order_by(ProvisionedAssetRow.id)
        )
        if ids is None:
            return self._found(query)
        with self._database.reading() as connection:
            rows = rows_of(connection, ProvisionedAssetRow.id, query, ids)
            return [_asset(row) for row in rows]

    def changed_since(self, revision: int) -> list[ProvisionedAsset]:
        """What has a greater revision, oldest first; the table of a removed one is None."""
        return self._found(
            select(*_COLUMNS)
            .where(ProvisionedAssetRow.revision > revision)
            .order_by(ProvisionedAssetRow.revision, ProvisionedAssetRow.id)
        )

    def change(
        self,
        changes: Mapping[str, Mapping[str, Any] | None],
        at_us: int,
        line: AuditEntry | None = None,
        based_on: Mapping[str, int | None] | None = None,
    ) -> int:
        """Write all changes and the line of the audit trail in one transaction.

        Returns the new revision. Raises `ChangedMeanwhileError` if one of `based_on` has another
        revision now; nothing is written.

        - ``changes``: tables by id; None removes an asset.
        - ``based_on``: revisions, by id, of the tables that the changes were made of; None for one
          that there must not be.
        """
        with self._database.writing() as connection:
            if connection.dialect.name == "postgresql":
                # Revisions are seen in their order: no reader knows the later of two first.
                connection.execute(text("LOCK TABLE provisioned_assets IN EXCLUSIVE MODE"))
            _compare(connection, based_on or {})
            newest = connection.scalar(select(func.max(ProvisionedAssetRow.revision))) or 0
            key = ProvisionedAssetRow.id
            known = {
                row.id: _asset(row) for row in rows_of(connection, key, select(*_COLUMNS), changes)
            }
            rows = [
                {
                    "id": asset_id,
                    "document": None if table is None else json.dumps(table),
                    "revision": newest + 1,
                    "changed_us": at_us,
                }
                | _absence(known.get(asset_id), table is None, at_us)
                for asset_id, table in changes.items()
                if table is not None or asset_id in known
            ]
            added = [row for row in rows if row["id"] not in known]
            if added:
                connection.execute(insert(ProvisionedAssetRow), added)
            changed = [row | {"known_id": row["id"]} for row in rows if row["id"] in known]
            if changed:
                of_one = update(ProvisionedAssetRow).where(
                    ProvisionedAssetRow.id == bindparam("known_id")
                )
                connection.execute(of_one, changed)
            add_line(connection, line)
        return newest + 1

    def _found(self, query: Select[*tuple[Any, ...]]) -> list[ProvisionedAsset]:
        with self._database.reading() as connection:
            return [_asset(row) for row in connection.execute(query)]


def _compare(connection: Connection, based_on: Mapping[str, int | None]) -> None:
    for asset_id, revision in based_on.items():
        query = select(ProvisionedAssetRow.revision).where(
            ProvisionedAssetRow.id == asset_id, ProvisionedAssetRow.document.is_not(None)
        )
        if connection.scalar(query) != revision:
            raise ChangedMeanwhileError(
                f"asset {asset_id!r} was changed meanwhile; read it again, then change it"
            )


def _absence(
    before: ProvisionedAsset | None, is_removed: bool, at_us: int
) -> dict[str, int | None]:
    """Since when and until when the asset was away the last time."""
    if before is None:
        return {"removed_us": None, "added_us": None}
    removed_us, added_us = before.removed_us, before.added_us
    if is_removed and before.table is not None:
        removed_us, added_us = at_us, None
    elif not is_removed and before.table is None:
        added_us = at_us
    return {"removed_us": removed_us, "added_us": added_us}


def _asset(row: Row[*tuple[Any, ...]]) -> ProvisionedAsset:
    table = None if row.document is None else json.loads(row.document)
    return ProvisionedAsset(
        row.id, table, row.revision, row.changed_us, row.removed_us, row.added_us
    )
