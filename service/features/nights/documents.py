"""Nights in which a fleet is identified: how far each is, and what it costs."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal, Self

from pydantic import Field

from service.clock import rfc3339
from service.documents.base import Document, Page, Time
from service.features.nights.tables import FleetRun

NightState = Literal["running", "ended", "stopped", "lost"]

#: A run that has not been heard of for so long is lost, in wall microseconds.
LOST_AFTER_US: Final = 120 * 1_000_000


class NightDocument(Document):
    """What the runs of one night have done with the assets that they were asked for."""

    night: str = Field(description="Date of the evening.", examples=["2026-11-22"])
    assets: str = Field(examples=["all assets", "family axle box"])
    state: NightState = Field(
        description="`stopped`: by a signal, or store or workers were offline; `lost`: no report "
        "for two minutes. Both go on with the next call of the command."
    )
    began_at: Time = Field(description="Of the first run; wall time.")
    told_at: Time = Field(description="Last report of the last run; wall time.")
    ended_at: Time | None = Field(description="Of the last run; null while none has ended.")
    runs: int = Field(examples=[1])
    executor: str = Field(description="Of the last run.", examples=["process", "dask"])
    workers: int = Field(examples=[2])
    workers_lost: int = Field(description="Of all runs.", examples=[0])
    asked: int = Field(description="Assets.", examples=[1000])
    done: int = Field(description="Have a result of this night.", examples=[960])
    warm_starts: int = Field(
        description="Of these, from the active version without a search.", examples=[950]
    )
    refused: int = Field(description="Of these, refused by the gates.", examples=[12])
    failed: int = Field(examples=[1])
    skipped: int = Field(
        description="Without data, or with a job of the service under way.", examples=[39]
    )
    without_new_data: int = Field(
        description="Of the skipped ones, those with nothing new since their last night.",
        examples=[30],
    )
    left: int = Field(description="Not looked at yet.", examples=[0])
    processor_seconds: float = Field(description="Of all runs.", examples=[310.2])
    processor_seconds_per_machine: float | None = Field(
        description="Null while nothing is identified.", examples=[0.32]
    )
    problems: Mapping[str, str] = Field(
        description="The first assets that failed, and why; 20 at most."
    )

    @classmethod
    def of(cls, runs: Sequence[FleetRun], now_us: int) -> Self:
        """Show the runs of one night, newest first."""
        last = runs[0]
        done = last.identified + last.done_before
        identified = sum(run.identified for run in runs)
        processor_s = sum(run.processor_s for run in runs)
        left = max(last.asked - done - last.failed - last.skipped, 0)
        return cls(
            night=last.night,
            assets=last.chosen,
            state=_state(last, left, now_us),
            began_at=rfc3339(min(run.began_us for run in runs)),
            told_at=rfc3339(last.told_us),
            ended_at=None if last.ended_us is None else rfc3339(last.ended_us),
            runs=len(runs),
            executor=last.executor,
            workers=last.workers,
            workers_lost=sum(run.workers_lost for run in runs),
            asked=last.asked,
            done=done,
            warm_starts=sum(run.warm_starts for run in runs),
            refused=sum(run.refused for run in runs),
            failed=last.failed,
            skipped=last.skipped,
            without_new_data=last.without_new_data,
            left=left,
            processor_seconds=processor_s,
            processor_seconds_per_machine=processor_s / identified if identified else None,
            problems=last.problems,
        )


class NightsPage(Page):
    """Nights, newest first."""

    items: list[NightDocument]


def nights_of(runs: Iterable[FleetRun]) -> list[list[FleetRun]]:
    """Put together the runs of one night over the same assets; all newest first."""
    found: dict[tuple[str, str], list[FleetRun]] = {}
    for run in runs:
        found.setdefault((run.night, run.chosen), []).append(run)
    return list(found.values())


def _state(last: FleetRun, left: int, now_us: int) -> NightState:
    if last.ended_us is not None:
        return "stopped" if left else "ended"
    return "running" if now_us - last.told_us < LOST_AFTER_US else "lost"
