"""What the live twin of an asset needs to go on after a restart."""

from collections.abc import Sequence

from sqlalchemy import delete, insert, select

from service.store.audit import add_line
from service.store.part import StorePart
from service.store.records import AuditEntry, JsonDocument
from service.store.tables import AssetStateRow

#: Wall seconds to wait for other writers; the next document comes soon.
_PATIENCE_S = 3.0


class AssetStates(StorePart):
    """One JSON document per asset; a new one replaces the old one."""

    def save(self, asset: str, document: JsonDocument, lines: Sequence[AuditEntry] = ()) -> None:
        """Keep a document for `load`, with lines of the audit trail about what changed it."""
        with self._database.writing(_PATIENCE_S) as connection:
            connection.execute(delete(AssetStateRow).where(AssetStateRow.asset == asset))
            connection.execute(insert(AssetStateRow).values(asset=asset, document=document))
            for line in lines:
                add_line(connection, line)

    def load(self, asset: str) -> JsonDocument | None:
        """Give back the document saved last, or None."""
        query = select(AssetStateRow.document).where(AssetStateRow.asset == asset)
        with self._database.reading() as connection:
            return connection.scalar(query)
