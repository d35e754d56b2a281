"""Runs that identify a fleet: how far each is, and what it has cost so far."""

from dataclasses import asdict, dataclass, field
from typing import Final

from sqlalchemy import Index, delete, insert, select
from sqlalchemy.orm import Mapped, mapped_column

from service.store.part import StorePart
from service.store.records import JsonDocument
from service.store.tables import Base

#: Runs that are older are forgotten, in wall microseconds: 400 days.
KEPT_US: Final = 400 * 86_400 * 1_000_000
#: Assets of a run whose failure is kept with it.
MAX_PROBLEMS: Final = 20
#: Wall seconds to wait for other writers; the next report comes soon.
_PATIENCE_S: Final = 3.0


class FleetRunRow(Base):
    """One run over a fleet, with how far it is and what it costs."""

    __tablename__ = "fleet_runs"
    __table_args__ = (Index("ix_fleet_runs_began_us", "began_us"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    began_us: Mapped[int]
    document: Mapped[JsonDocument]


@dataclass(frozen=True, slots=True)
class FleetRun:
    """One run of a night, as it is at `told_us`. Times in wall microseconds.

    - ``night``, ``chosen``: name of the night, and which assets: the runs that have both in common
      share their work.
    - ``executor``, ``workers``, ``workers_lost``: what computes.
    - ``asked``: assets that were asked for.
    - ``identified``, ``warm_starts``, ``refused``: by this run; those without a search, and those
      that the gates refused.
    - ``done_before``: by other runs of the night.
    - ``skipped``, ``without_new_data``: not identified, and of those the ones that have nothing
      new.
    - ``failed``: machines whose computation failed, in this night.
    - ``processor_s``: processor seconds of this run.
    - ``began_us``, ``told_us``, ``ended_us``: begin, last report, end; None while it runs,
      and of a run that was killed.
    - ``problems``: first assets that failed, and why.
    """

    id: str
    night: str
    chosen: str
    executor: str
    workers: int
    workers_lost: int
    asked: int
    identified: int
    warm_starts: int
    refused: int
    done_before: int
    skipped: int
    without_new_data: int
    failed: int
    processor_s: float
    began_us: int
    told_us: int
    ended_us: int | None
    problems: dict[str, str] = field(default_factory=dict)


class FleetRuns(StorePart):
    """Runs of the last 400 days; each replaces its own last report."""

    def save(self, run: FleetRun) -> None:
        """Keep a run as it is now."""
        row = {"id": run.id, "began_us": run.began_us, "document": asdict(run)}
        with self._database.writing(_PATIENCE_S) as connection:
            connection.execute(
                delete(FleetRunRow).where(
                    (FleetRunRow.id == run.id) | (FleetRunRow.began_us < run.began_us - KEPT_US)
                )
            )
            connection.execute(insert(FleetRunRow).values(row))

    def all(self) -> list[FleetRun]:
        """All that are kept, newest first."""
        query = select(FleetRunRow.document).order_by(
            FleetRunRow.began_us.desc(), FleetRunRow.id.desc()
        )
        with self._database.reading() as connection:
            return [FleetRun(**document) for (document,) in connection.execute(query)]
