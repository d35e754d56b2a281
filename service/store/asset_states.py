"""What the live twins of the assets need to go on after a restart."""

from base64 import b64decode, b64encode
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np
import structlog
from sqlalchemy import Row, delete, insert, select

from service.store.audit import add_line
from service.store.part import StorePart, rows_of
from service.store.records import AuditEntry, JsonDocument
from service.store.tables import AssetStateRow

_log = structlog.get_logger(__name__)

#: Wall seconds to wait for other writers; the next documents come soon.
_PATIENCE_S = 3.0
#: A document is kept as MessagePack under this name: seven hundred numbers as JSON text take the
#: processor a hundred times longer. Version 0.1.0 kept it as it is.
_PACKED: Final = "packed"


class AssetStates(StorePart):
    """One document per asset; a new one replaces the old one."""

    def save(
        self, asset: str, document: Mapping[str, object], lines: Sequence[AuditEntry] = ()
    ) -> None:
        """Keep a document for `load`, with lines of the audit trail about what changed it."""
        self.save_all({asset: document}, lines)

    def save_all(
        self, documents: Mapping[str, Mapping[str, object]], lines: Sequence[AuditEntry] = ()
    ) -> None:
        """Keep the documents of many assets in one transaction, as `save` does.

        Those of assets that another cell owns now are left out: it has kept newer ones. Cells write
        states next to each other: each only those of assets that are its own until the commit.
        """
        if not documents:
            return
        rows = {
            asset: {"asset": asset, "document": {_PACKED: b64encode(_packed(one)).decode()}}
            for asset, one in documents.items()
        }
        fence = self._database.fence
        # The audit trail is everyone's; for its lines this transaction must be alone.
        turn = self._database.writing if lines else self._database.writing_samples
        with turn(_PATIENCE_S) as connection:
            held = rows.keys() if fence is None else fence.held(connection, rows.keys())
            if len(held) < len(rows):
                _log.warning("states_of_others_left_out", count=len(rows) - len(held))
            if not held:
                return
            connection.execute(delete(AssetStateRow).where(AssetStateRow.asset.in_(list(held))))
            connection.execute(insert(AssetStateRow), [rows[asset] for asset in held])
            for line in lines:
                add_line(connection, line)

    def load(self, asset: str) -> JsonDocument | None:
        """Give back the document saved last, or None."""
        query = select(AssetStateRow.document).where(AssetStateRow.asset == asset)
        with self._database.reading() as connection:
            found = connection.scalar(query)
        return None if found is None else _unpacked(found)

    def load_all(self, assets: Collection[str] | None = None) -> dict[str, JsonDocument]:
        """Give back the documents of some assets, or of all."""
        query = select(AssetStateRow.asset, AssetStateRow.document)
        with self._database.reading() as connection:
            if assets is None:
                rows: Sequence[Row[*tuple[Any, ...]]] = connection.execute(query).all()
            else:
                rows = rows_of(connection, AssetStateRow.asset, query, assets)
        found = {}
        for asset, document in rows:
            try:
                found[asset] = _unpacked(document)
            except (msgspec.DecodeError, ValueError) as error:
                # This twin begins again; the others go on.
                _log.error("state_damaged", asset=asset, reason=str(error))
        return found


def _packed(document: Mapping[str, object]) -> bytes:
    def plain(value: object) -> object:
        if isinstance(value, np.generic):
            return value.item()
        raise NotImplementedError(type(value).__name__)

    return msgspec.msgpack.encode(document, enc_hook=plain)


def _unpacked(document: JsonDocument) -> JsonDocument:
    packed = document.get(_PACKED)
    if packed is None:
        return document
    unpacked: JsonDocument = msgspec.msgpack.decode(b64decode(packed))
    return unpacked
