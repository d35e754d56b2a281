"""Runs that identify a fleet: how far each is, and what it has cost so far."""

from dataclasses import asdict, dataclass, field
from typing import Final

from sqlalchemy import delete, insert, select

from service.store.part import StorePart
from service.store.tables import FleetRunRow

#: Runs that are older are forgotten, in wall microseconds: 400 days.
KEPT_US: Final = 400 * 86_400 * 1_000_000
#: Assets of a run whose failure is kept with it.
MOST_PROBLEMS: Final = 20
#: Wall seconds to wait for other writers; the next word comes soon.
_PATIENCE_S: Final = 3.0


@dataclass(frozen=True, slots=True)
class FleetRun:
    """One run of a night, as it is at `told_us`. Times in wall microseconds.

    Attributes
    ----------
    id
        Of this run; a night may have several.
    night, chosen
        Name of the night, and which assets: the runs that have both in common share their work.
    executor, workers, workers_lost
        Who computes.
    asked
        Assets that were asked for.
    identified, warm_starts, refused
        By this run; those without a search, and those that the gates refused.
    done_before
        By other runs of the night.
    skipped, without_new_data
        Not identified, and of those the ones that have nothing new.
    failed
        Machines whose computation failed, in this night.
    processor_s
        Processor seconds of this run.
    began_us, told_us, ended_us
        Begin, last sign of life, end; None while it runs, and of a run that was killed.
    problems
        First assets that failed, and why.
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
    """Runs of the last 400 days; each replaces what it said of itself before."""

    def tell(self, run: FleetRun) -> None:
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
