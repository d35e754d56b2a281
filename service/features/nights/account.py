"""What came of identifying a fleet, asset by asset, and what it cost."""

from typing import Literal

from pydantic import Field

from service.documents.base import Document

ExecutorName = Literal["process", "dask"]


class IdentifiedAsset(Document):
    """What came of one asset."""

    asset: str
    status: Literal["identified", "done before", "skipped", "failed"] = Field(
        description="`done before`: in the same night, by an earlier run or another one."
    )
    model_version: int | None = Field(None, description="That came of it.")
    active: bool = Field(False, description="Whether that version is the active one.")
    reason: str = Field("", description="Of the gates, or why there is no version.")
    warm_start: bool | None = Field(
        None, description="Whether it comes from the active version, without a search."
    )
    seconds: float | None = Field(None, description="Of computation in the worker.")


class FleetIdentification(Document):
    """A run over a fleet; the figures are those of this run."""

    night: str = Field(description="Date of the evening before.", examples=["2026-11-22"])
    executor: ExecutorName
    workers: int = Field(description="At the start.")
    workers_lost: int
    machines: int = Field(description="Identified by this run.")
    warm_starts: int
    done_before: int
    skipped: int
    failed: int
    seconds: float = Field(description="Of the run.")
    processor_seconds: float = Field(description="Of the workers and of the command.")
    seconds_per_machine: float | None = Field(description="Of the run; null without a machine.")
    ended_by: str | None = Field(
        None, description="Why it ended before all machines were done; null where it did not."
    )
    items: list[IdentifiedAsset]


def nothing_done(night: str, executor: ExecutorName) -> FleetIdentification:
    """The document of a run that did not get as far as its first machine."""
    return FleetIdentification(
        night=night,
        executor=executor,
        workers=0,
        workers_lost=0,
        machines=0,
        warm_starts=0,
        done_before=0,
        skipped=0,
        failed=0,
        seconds=0.0,
        processor_seconds=0.0,
        seconds_per_machine=None,
        items=[],
    )


def summary(found: FleetIdentification) -> str:
    """What a run did and cost, in one line: for the terminal and for the audit trail."""
    each = found.seconds_per_machine
    return (
        f"Night {found.night}: {found.machines} machines identified ({found.warm_starts} by a warm "
        f"start), {found.done_before} done before, {found.skipped} skipped, {found.failed} failed "
        f"in {found.seconds:.1f} s on {found.workers} workers ({found.executor}"
        + (f", {found.workers_lost} lost" if found.workers_lost else "")
        + f"), {found.processor_seconds:.1f} s of processor time"
        + ("" if each is None else f", {each:.2f} s for each machine")
    )
