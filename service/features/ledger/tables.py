"""The forecast ledger in the store: what was forecast, and what came of it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec
import structlog
from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Index,
    Integer,
    LargeBinary,
    Row,
    bindparam,
    func,
    insert,
    select,
    text,
    update,
)
from sqlalchemy.orm import Mapped, mapped_column

from service.clock import MICROSECONDS
from service.store.audit import add_line
from service.store.changes import FeatureChange, RefuseChange
from service.store.deliveries import Delivery
from service.store.errors import NotOwnerError
from service.store.forecast_records import (
    ForecastPage,
    ForecastRecords,
    IssuedContent,
    IssuedForecast,
    Outcome,
    Reason,
    StoredForecast,
)
from service.store.part import Parts, Refuse
from service.store.records import AuditEntry
from service.store.tables import Base, ModelVersionRow

_log = structlog.get_logger(__name__)


class KeptForecastRow(Base):
    """A forecast and what came of it, packed; see `KeptForecasts`."""

    __tablename__ = "kept_forecasts"
    __table_args__ = (
        Index("ix_kept_forecasts_asset_id", "asset", "id"),
        Index("ix_kept_forecasts_time_us", "time_us"),
        Index(
            "ix_kept_forecasts_due_us",
            "due_us",
            sqlite_where=text("due_us IS NOT NULL"),
        ),
    )

    id: Mapped[int] = mapped_column(
        BigInteger().with_variant(Integer(), "sqlite"), primary_key=True
    )
    asset: Mapped[str]
    time_us: Mapped[int]
    model_version: Mapped[int]
    reason: Mapped[str]
    issued: Mapped[bytes] = mapped_column(LargeBinary)
    outcome: Mapped[bytes | None] = mapped_column(LargeBinary)
    due_us: Mapped[int | None]


_COLUMNS = (
    KeptForecastRow.id,
    KeptForecastRow.asset,
    KeptForecastRow.time_us,
    KeptForecastRow.model_version,
    KeptForecastRow.reason,
    KeptForecastRow.issued,
    KeptForecastRow.outcome,
    KeptForecastRow.due_us,
)
_PACK = msgspec.msgpack.Encoder().encode
_READ_CONTENT = msgspec.msgpack.Decoder(IssuedContent).decode
_READ_OUTCOME = msgspec.msgpack.Decoder(Outcome).decode


@dataclass(frozen=True, slots=True)
class Settled:
    """What a look at a due forecast found: written only where it is due as it was then."""

    id: int
    was_due_us: int
    due_us: int | None
    outcome: Outcome


class KeptForecasts(ForecastRecords):
    """What a forecast said is never changed; what came of it is added when its times come."""

    def add(
        self,
        issued: Sequence[IssuedForecast],
        delivery: Delivery | None = None,
        audit: AuditEntry | None = None,
        refuse: Refuse | None = None,
    ) -> None:
        """Keep forecasts of any number of assets, in one transaction.

        Raises `NotOwnerError` if another cell has owned all of their assets since.

        - ``delivery``: of an outbox; what it delivers again is known.
        - ``refuse``: takes the forecasts of assets that another cell has owned since.
        """
        with self._writing_once(delivery) as connection:
            if connection is None:
                return
            ours = {one.asset for one in issued}
            if delivery is not None:
                ours = self._ours(connection, ours, delivery)
            rest = [one for one in issued if one.asset not in ours]
            if issued and len(rest) == len(issued):
                raise NotOwnerError("forecasts: another cell has owned their assets since")
            if rest and refuse is not None:
                refuse(connection, rest)
            rows = [row_of(one) for one in issued if one.asset in ours]
            if rows:
                connection.execute(insert(KeptForecastRow), rows)
                add_line(connection, audit)

    def due(self, before_us: int, limit: int) -> list[StoredForecast]:
        """Give forecasts of which a reading was due by then, the longest overdue first."""
        row, model = KeptForecastRow, ModelVersionRow
        query = (
            select(*_COLUMNS, model.version)
            .outerjoin(model, (model.asset == row.asset) & (model.version == row.model_version))
            .where(row.due_us <= before_us)
            .order_by(row.due_us)
            .limit(limit)
        )
        damaged: list[int] = []
        with self._database.reading() as connection:
            found = _read(connection.execute(query).all(), damaged)
        if damaged:  # what came of them is unknown, and they must not hold up the others
            with self._database.writing() as connection:
                connection.execute(update(row).where(row.id.in_(damaged)).values(due_us=None))
        return found

    def settle(self, settled: Sequence[Settled]) -> set[int]:
        """Write what came of forecasts, in one transaction; returns of which it was news.

        A forecast that another look has changed meanwhile stays as it is.
        """
        if not settled:
            return set()
        row = KeptForecastRow
        change = (
            update(row.__table__)  # type: ignore[arg-type]
            .where(row.id == bindparam("of_id"), row.due_us == bindparam("was_due_us"))
            .values(outcome=bindparam("what_came"), due_us=bindparam("next_us"))
        )
        with self._database.writing() as connection:
            return {
                one.id
                for one in settled
                if connection.execute(
                    change,
                    {
                        "of_id": one.id,
                        "was_due_us": one.was_due_us,
                        "what_came": _PACK(one.outcome),
                        "next_us": one.due_us,
                    },
                ).rowcount
            }

    def page(self, asset: str, limit: int, cursor: int | None = None) -> ForecastPage:
        """Part of the forecasts of an asset, the last that was kept first."""
        query = select(*_COLUMNS).where(KeptForecastRow.asset == asset)
        rows, following = self._newest_first(query, KeptForecastRow.id, limit, cursor)
        return ForecastPage(_read(rows), following)

    def since(
        self, asset: str, start_us: int, version: int | None = None, end_us: int | None = None
    ) -> list[StoredForecast]:
        """All forecasts of an asset made from a time on, of one model version or of all.

        With an end, those made before it.
        """
        conditions: list[ColumnElement[bool]] = [
            KeptForecastRow.asset == asset,
            KeptForecastRow.time_us >= start_us,
        ]
        if version is not None:
            conditions.append(KeptForecastRow.model_version == version)
        if end_us is not None:
            conditions.append(KeptForecastRow.time_us < end_us)
        query = select(*_COLUMNS).where(*conditions).order_by(KeptForecastRow.id)
        with self._database.reading() as connection:
            return _read(connection.execute(query).all())

    def count_waiting(self, asset: str, reason: Reason) -> int:
        """How many forecasts of an asset that were kept for a reason are not settled yet."""
        row = KeptForecastRow
        query = select(func.count()).where(
            row.asset == asset, row.reason == reason, row.due_us.is_not(None)
        )
        with self._database.reading() as connection:
            return connection.scalar(query) or 0

    def expire(self, before_us: int) -> int:
        """Remove forecasts made before a process time; returns how many."""
        return self._expire(KeptForecastRow, before_us)


class ForecastBatch(FeatureChange, frozen=True):
    """Forecasts that are to be kept together, with the audit line of a user who asked for them."""

    kind = "forecasts"

    forecasts: tuple[IssuedForecast, ...]
    audit: AuditEntry | None = None

    @property
    def summary(self) -> str:
        """How many there are."""
        return f"{len(self.forecasts)} forecasts"

    def assets(self) -> Iterable[str]:
        """Name the assets whose forecasts they are."""
        return {one.asset for one in self.forecasts}

    def save(self, parts: Parts, delivery: Delivery | None, refuse: RefuseChange) -> None:
        """Keep them, and refuse those of assets that another cell has owned since."""
        parts.part(KeptForecasts).add(
            self.forecasts,
            delivery,
            self.audit,
            lambda connection, rest: refuse(connection, ForecastBatch(tuple(rest))),
        )

    def repeat(self, connection: Connection) -> str:
        """Keep all of them."""
        connection.execute(insert(KeptForecastRow), [row_of(one) for one in self.forecasts])
        add_line(connection, self.audit)
        return self.summary


#: Its outbox is one of its own: it takes neither turn nor room on a full disk from the alarms.
FORECASTS_FILE_NAME: Final = "outbox-forecasts.db"
CHANGES: Final = (ForecastBatch,)
OUTBOXES: Final = (FORECASTS_FILE_NAME,)


def row_of(issued: IssuedForecast) -> dict[str, Any]:
    """Give the row of a new forecast."""
    return {
        "asset": issued.asset,
        "time_us": issued.time_us,
        "model_version": issued.model_version,
        "reason": issued.reason,
        "issued": _PACK(issued.content),
        "outcome": None,
        "due_us": issued.time_us + issued.content.lead_times_s[0] * MICROSECONDS,
    }


def _read(
    rows: Sequence[Row[*tuple[Any, ...]]] | Sequence[Sequence[Any]],
    damaged: list[int] | None = None,
) -> list[StoredForecast]:
    found = []
    for row in rows:
        number, asset, time_us, version, reason, issued, outcome, due_us, *versions = row
        try:
            content = _READ_CONTENT(issued)
            came = Outcome.waiting(content) if outcome is None else _READ_OUTCOME(outcome)
        except (msgspec.DecodeError, msgspec.ValidationError) as error:
            # The others are read on.
            _log.error("forecast_damaged", asset=asset, id=number, reason=str(error))
            if damaged is not None:
                damaged.append(number)
            continue
        found.append(
            StoredForecast(
                number,
                IssuedForecast(asset, time_us, version, reason, content),
                came,
                due_us,
                not versions or versions[0] is not None,
            )
        )
    return found
