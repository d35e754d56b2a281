"""What all parts of the store share."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

from sqlalchemy import ColumnElement, Connection, Row, Select, delete, select
from sqlalchemy.orm import InstrumentedAttribute

from service.store.database import PATIENCE_S, Database
from service.store.deliveries import Delivery, is_first
from service.store.errors import NotOwnerError
from service.store.tables import Base

#: Wall seconds for a change that can wait in its outbox.
DELIVERY_PATIENCE_S = 1.0
#: This many old lines go in one transaction; the others have their turn in between.
_PORTION = 1000
#: Keys of one look-up.
_KEYS = 400

#: Keeps, within the transaction that writes the others, what the store does not take of a change.
Refuse = Callable[[Connection, Sequence[Any]], None]


def rows_of(
    connection: Connection,
    key: ColumnElement[Any] | InstrumentedAttribute[Any],
    query: Select[*tuple[Any, ...]],
    keys: Collection[Any],
) -> list[Row[*tuple[Any, ...]]]:
    """Rows with one of these keys, looked up in portions that every database takes."""
    wanted = sorted(keys)
    found: list[Row[*tuple[Any, ...]]] = []
    for first in range(0, len(wanted), _KEYS):
        found += connection.execute(query.where(key.in_(wanted[first : first + _KEYS]))).all()
    return found


class StorePart:
    """One part of the store: the methods that belong to one noun, on a shared database.

    All methods are synchronous and may be called from any thread; callers on an event loop go
    through a worker thread. A method raises `StoreUnavailableError` when the database does not
    answer.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    @contextmanager
    def _writing_once(self, delivery: Delivery | None) -> Iterator[Connection | None]:
        """Give a connection to write with; None when this delivery was made before."""
        patience_s = PATIENCE_S if delivery is None else DELIVERY_PATIENCE_S
        with self._database.writing(patience_s) as connection:
            first = delivery is None or is_first(connection, delivery)
            yield connection if first else None

    def _require(self, connection: Connection, asset: str) -> None:
        """Refuse to write what was derived for an asset that another cell owns.

        Raises `NotOwnerError` if it does; the transaction is to be rolled back.
        """
        fence = self._database.fence
        if fence is not None and not fence.held(connection, (asset,)):
            raise NotOwnerError(f"asset {asset}: another cell owns it")

    def _ours(
        self, connection: Connection, assets: Collection[str], delivery: Delivery | None
    ) -> set[str]:
        """Give those of some assets for which this run, or that of a delivery, may write."""
        fence = self._database.fence
        if fence is None or not assets:
            return set(assets)
        if delivery is None:
            return set(fence.held(connection, assets))
        return set(fence.deliverable(connection, assets, delivery.run))

    def _expire(self, row: type[Base], before_us: int) -> int:
        """Remove numbered lines from before a time, in portions; returns how many."""
        columns = row.__table__.c
        old = select(columns.id).where(columns.time_us < before_us)
        oldest = old.order_by(columns.id).limit(_PORTION)
        removed, count = 0, _PORTION
        while count == _PORTION:
            with self._database.writing() as connection:
                count = connection.execute(delete(row).where(columns.id.in_(oldest))).rowcount
            removed += count
        return removed

    def _newest_first(
        self,
        query: Select[*tuple[Any, ...]],
        number: InstrumentedAttribute[int],
        limit: int,
        cursor: int | None,
    ) -> tuple[Sequence[Sequence[Any]], int | None]:
        """A page of numbered rows, the number their first column, and the cursor of the next."""
        query = query.order_by(number.desc())
        if cursor is not None:
            query = query.where(number < cursor)
        with self._database.reading() as connection:
            rows = connection.execute(query.limit(limit + 1)).all()
        page = rows[:limit]
        return page, page[-1][0] if len(rows) > limit else None


PartT = TypeVar("PartT", bound=StorePart)


class Parts(Protocol):
    """What gives the parts of a store: `service.store.store.Store`."""

    def part(self, kind: type[PartT]) -> PartT:
        """Give a feature's part of the store."""
