"""Runs of a machine, from its start to standstill, and what was noted of them."""

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from service.clock import MICROSECONDS, rfc3339
from service.documents.base import Document, Number, Page, Time, time_or_none
from service.features.runs.runs import Annotation, Run, RunPage


class AnnotationDocument(Document):
    """What somebody noted at a moment."""

    id: str
    time: Time
    text: str = Field(examples=["noise at the outer ring"])
    who: str = Field(examples=["operator bt_1a2b3c4d"])


class RunDocument(Document):
    """A run: from the minute in which the machine began to turn until it stood still."""

    id: str = Field(
        description="Its start when it was first found; it stays when late data move the start.",
        examples=["20261121T0800Z"],
    )
    name: str | None = Field(description="Null without one.", examples=["run-in, new grease"])
    named_by: str | None = Field(examples=["operator bt_1a2b3c4d"])
    start: Time = Field(description="To the minute.")
    end: Time | None = Field(description="To the minute; null while it goes on.")
    ended: Literal["standstill", "no data"] | None = Field(
        description="How it ended: `no data` where the data ended while the machine turned; null "
        "while it goes on."
    )
    duration_s: Number = Field(description="Null while it goes on.", examples=[43200])


class RunDetail(RunDocument):
    """A run with its annotations."""

    annotations: list[AnnotationDocument] = Field(description="In the order of time.")


class RunList(Page):
    """Runs, the latest first."""

    items: list[RunDocument]
    report_formats: list[Literal["pdf", "png", "csv"]] = Field(
        description="In which reports can be made here; `pdf` and `png` need matplotlib.",
        examples=[["pdf", "png", "csv"]],
    )


def annotation_document(one: Annotation) -> AnnotationDocument:
    """Show an annotation."""
    return AnnotationDocument(id=one.id, time=rfc3339(one.time_us), text=one.text, who=one.who)


def run_document(run: Run) -> RunDocument:
    """Show a run."""
    length_us = None if run.end_us is None else run.end_us - run.start_us
    return RunDocument(
        id=run.id,
        name=run.name or None,
        named_by=run.named_by or None,
        start=rfc3339(run.start_us),
        end=time_or_none(run.end_us),
        ended=run.ended or None,
        duration_s=None if length_us is None else length_us / MICROSECONDS,
    )


def run_detail(run: Run, annotations: Sequence[Annotation]) -> RunDetail:
    """Show a run with what was noted of it."""
    shown = [annotation_document(one) for one in annotations]
    return RunDetail(**run_document(run).model_dump(), annotations=shown)


def run_list(
    page: RunPage, following: str | None, formats: list[Literal["pdf", "png", "csv"]]
) -> RunList:
    """Show a page of runs, with the formats in which reports can be made."""
    items = [run_document(run) for run in page.items]
    return RunList(items=items, next=following, report_formats=formats)
