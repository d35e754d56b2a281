"""Which store this is: a name that changes with each restore, and who notices another one."""

import json
import os
import secrets
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Final

import structlog
from sqlalchemy import Connection, bindparam, delete, insert, select, update

from service.clock import wall_us
from service.files import FileError, make_private_file, replacing
from service.store.audit import add_line
from service.store.closable import Closable
from service.store.errors import StoreDoubtedError
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import DeliveryRow, StoreIdentityRow

FILE_NAME: Final = "store-seen.json"
#: How an incarnation came about.
CREATED: Final = "created"
RESTORED: Final = "restored"
CONFIRMED: Final = "confirmed"
_HOW_TO_CONFIRM: Final = (
    "nothing is written to it until the right store is there again, or a person confirms this one "
    "with 'bearing-twin db confirm'"
)

_OWN_COUNT = select(DeliveryRow.number).where(DeliveryRow.sender == bindparam("holder"))
_COUNT = (
    update(DeliveryRow)
    .where(DeliveryRow.sender == bindparam("holder"))
    .values(number=DeliveryRow.number + 1)
    .returning(
        DeliveryRow.number,
        select(StoreIdentityRow.incarnation).scalar_subquery(),
        select(StoreIdentityRow.origin).scalar_subquery(),
    )
)
_IDENTITY = select(StoreIdentityRow.incarnation, StoreIdentityRow.origin)

_log = structlog.get_logger(__name__)


def renew(connection: Connection, origin: str) -> None:
    """Give a store another name, within the transaction that makes it another store."""
    connection.execute(delete(StoreIdentityRow))
    connection.execute(
        insert(StoreIdentityRow).values(
            id=1, incarnation=secrets.token_hex(16), origin=origin, since_us=wall_us()
        )
    )


class StoreIdentity(StorePart):
    """Says whether the store is the one that it was, and takes a person's word that it is."""

    def confirm(self, audit: AuditEntry) -> None:
        """Have all cells go on with the store as it is, whatever it lacks."""
        with self._database.writing() as connection:
            renew(connection, CONFIRMED)
            add_line(connection, audit)

    def incarnation(self) -> str:
        """Name of the store: a cell that finds another one knows nothing of it."""
        with self._database.reading() as connection:
            found = connection.execute(_IDENTITY).first()
        return "" if found is None else str(found.incarnation)

    def check(self) -> None:
        """See whether the store answers and may be written to.

        Raises `StoreUnavailableError` if it does not answer; a `StoreDoubtedError` if it is another
        one.
        """
        witness = self._database.witness
        with self._database.reading() as connection:
            if witness is None:
                connection.execute(_IDENTITY).first()
            else:
                witness.check(connection)


class Witness(Closable):
    """What a cell knows of its store: which one it is, and what it has confirmed.

    The store counts the transactions of each cell, and the cell keeps on its own disk the last
    number that was committed: a store which has a lower one is an older copy, whatever its name.
    A process that is killed keeps it; a power cut may cost the last seconds of it.

    - ``begin_again``: called once, from any thread, when a person has confirmed another store than
      that with which this process has worked: what the process knows is of the one before, also
      where only what others wrote is missing.
    """

    def __init__(
        self, data_dir: Path, name: str, begin_again: Callable[[], object] = lambda: None
    ) -> None:
        self._path = data_dir / FILE_NAME
        self._name = name
        self._begin_again = begin_again
        self._descriptor = -1
        self._incarnation, self._holder, self._former, self._mark = "", "", list[str](), 0
        self._has_written, self._is_kept = False, True
        self.ended = ""
        self._read()

    def admit(self, connection: Connection) -> int:
        """Admit a transaction that writes; gives its number, for `committed`.

        Raises `StoreDoubtedError` if the store is another one, or lacks what it confirmed.
        """
        if self.ended:
            raise StoreDoubtedError(self.ended)
        row = connection.execute(_COUNT, {"holder": self._holder}).first()
        if row is None:
            connection.execute(insert(DeliveryRow).values(sender=self._holder, number=1))
            number, (incarnation, origin) = 1, connection.execute(_IDENTITY).first() or ("", "")
        else:
            number, incarnation, origin = row
        doubt = self._doubt(incarnation, origin, number - 1)
        if doubt is not None:
            raise StoreDoubtedError(doubt)
        if incarnation != self._incarnation:
            self._adopt(incarnation, number - 1)
            if self._has_written:
                self.ended = f"{self._name}: was confirmed; this cell begins again with it"
                self._begin_again()
                raise StoreDoubtedError(self.ended)
        return int(number)

    def committed(self, number: int) -> None:
        """Record that the store has confirmed a transaction."""
        self._mark, self._has_written = number, True
        if self._descriptor >= 0:
            try:
                os.pwrite(self._descriptor, self._line(), 0)
                self._is_kept = True
            except OSError as error:
                self._note_not_kept(error)

    def check(self, connection: Connection) -> None:
        """See, without writing, whether a transaction would be admitted; raises as `admit`."""
        incarnation, origin = connection.execute(_IDENTITY).first() or ("", "")
        number = connection.scalar(_OWN_COUNT, {"holder": self._holder}) or 0
        doubt = self.ended or self._doubt(incarnation, origin, number)
        if doubt:
            raise StoreDoubtedError(doubt)

    def close(self) -> None:
        """Close the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _doubt(self, incarnation: str, origin: str, number: int) -> str | None:
        """Say why the store is not the one that it was, or lacks something; None if all is well."""
        if not self._incarnation:
            return None
        if incarnation == self._incarnation:
            if number >= self._mark:
                return None
            return (
                f"{self._name}: an older copy, as after a failover to a standby that lagged: it "
                f"lacks {self._mark - number} of {self._mark} transactions that it confirmed to "
                f"this cell; {_HOW_TO_CONFIRM}"
            )
        if origin == CONFIRMED and incarnation not in self._former:
            return None
        what = "was restored from a backup" if origin == RESTORED else "is another store"
        return f"{self._name}: {what} since this cell last wrote to it; {_HOW_TO_CONFIRM}"

    # ------------------------------------------------------------------ the file
    def _adopt(self, incarnation: str, mark: int) -> None:
        if self._incarnation:
            self._former.append(self._incarnation)
            _log.warning("store_confirmed", store=self._name)
        self._incarnation, self._mark = incarnation, mark
        self._write()

    def _line(self) -> bytes:
        number = f"{self._mark:020d}"
        return f"{number} {zlib.crc32(f'{self._holder} {number}'.encode()):08x}\n".encode()

    def _write(self) -> None:
        self.close()
        document = {
            "incarnation": self._incarnation,
            "holder": self._holder,
            "former": self._former,
        }
        try:
            with replacing(self._path, binary=True, private=True) as file:
                file.write(self._line())
                file.write(json.dumps(document).encode())
            self._open()
        except (FileError, OSError) as error:
            self._note_not_kept(error)

    def _note_not_kept(self, error: Exception) -> None:
        # Once, not with every transaction: what is known is known in memory all the same.
        if self._is_kept:
            _log.warning("store_mark_not_kept", reason=str(error))
        self._is_kept = False

    def _open(self) -> None:
        self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CLOEXEC)

    def _read(self) -> None:
        try:
            line, document = self._path.read_bytes().split(b"\n", 1)
            found = json.loads(document)
            self._incarnation = str(found["incarnation"])
            self._holder = str(found["holder"])
            self._former = [str(one) for one in found["former"]]
            self._mark = int(line[:20])
            if line + b"\n" != self._line():
                raise ValueError("its number is damaged")
            make_private_file(self._path)
            self._open()
        except FileNotFoundError:
            self._holder = _new_holder()
        except (OSError, ValueError, KeyError, TypeError) as error:
            # Nothing is known then, as with a new data directory.
            _log.warning("store_mark_not_read", file=str(self._path), reason=str(error))
            self._incarnation, self._former, self._mark = "", [], 0
            self._holder = _new_holder()


def forget(data_dir: Path) -> None:
    """Forget which store a data directory belongs to: a person has just said which it is."""
    (data_dir / FILE_NAME).unlink(missing_ok=True)


def _new_holder() -> str:
    return f"witness/{secrets.token_hex(8)}"
