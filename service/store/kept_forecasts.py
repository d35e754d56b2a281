"""The forecast ledger: what was forecast, and what came of it."""

from collections.abc import Sequence
from typing import Any

import msgspec
import structlog
from sqlalchemy import ColumnElement, Row, bindparam, func, insert, select, update

from service.clock import MICROSECONDS
from service.store.audit import add_line
from service.store.deliveries import Delivery
from service.store.forecast_records import (
    ForecastPage,
    IssuedContent,
    IssuedForecast,
    Outcome,
    Reason,
    Settled,
    StoredForecast,
)
from service.store.part import StorePart
from service.store.records import AuditEntry
from service.store.tables import KeptForecastRow, ModelVersionRow

_log = structlog.get_logger(__name__)

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


class KeptForecasts(StorePart):
    """What a forecast said is never changed; what came of it is added when its times come."""

    def add(
        self,
        issued: Sequence[IssuedForecast],
        delivery: Delivery | None = None,
        audit: AuditEntry | None = None,
    ) -> None:
        """Keep forecasts of any number of assets, in one transaction.

        Parameters
        ----------
        issued
            The forecasts, each with a lead time at least.
        delivery
            Of an outbox; what it delivers again is known.
        audit
            Line of the audit trail, where somebody asked for it.
        """
        rows = [
            {
                "asset": one.asset,
                "time_us": one.time_us,
                "model_version": one.model_version,
                "reason": one.reason,
                "issued": _PACK(one.content),
                "outcome": None,
                "due_us": one.time_us + one.content.lead_times_s[0] * MICROSECONDS,
            }
            for one in issued
        ]
        fence = self._database.fence
        with self._writing_once(delivery) as connection:
            if connection is None:
                return
            if fence is not None and delivery is not None:
                assets = {one.asset for one in issued}
                ours = set(fence.deliverable(connection, assets, delivery.run))
                rows = [row for row in rows if row["asset"] in ours]
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
        if damaged:  # nobody can say what came of them, and they must not hold up the others
            with self._database.writing() as connection:
                connection.execute(update(row).where(row.id.in_(damaged)).values(due_us=None))
        return found

    def settle(self, settled: Sequence[Settled]) -> set[int]:
        """Write what came of forecasts, in one transaction; returns of which it was news.

        A forecast that somebody else has looked at meanwhile stays as that one left it.
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
        """Part of the forecasts of an asset, the last that was kept first.

        Parameters
        ----------
        asset, limit
            Whose, and how many at most.
        cursor
            `ForecastPage.next_cursor` of the page before.
        """
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
