"""History of channels, and what became of pushed samples."""

from typing import Annotated

from pydantic import ConfigDict, Field, with_config
from typing_extensions import TypedDict

from service.clock import rfc3339_exact
from service.documents.base import Document, Number, Page, Quality, Time, is_none


@with_config(ConfigDict(extra="forbid"))
class SampleItem(TypedDict):
    """One raw sample.

    A typed dictionary and no model: an answer holds thousands of them.
    """

    channel: Annotated[str, Field(examples=["t_inner_ring_c"])]
    time: Time
    value: Annotated[
        Number, Field(description="In the channel's unit; null when the quality is bad.")
    ]
    quality: Quality


@with_config(ConfigDict(extra="forbid"))
class ReceivedSampleItem(SampleItem):
    """One raw sample, and when the service received it."""

    received: Annotated[
        Time | None,
        Field(
            description="Process time at which the service received it; null when an earlier "
            "version stored it."
        ),
    ]


@with_config(ConfigDict(extra="forbid"))
class BucketItem(TypedDict):
    """Statistics over the good samples of a span of time; null where there is none."""

    channel: Annotated[str, Field(examples=["t_inner_ring_c"])]
    time: Annotated[Time, Field(description="Start of the bucket.")]
    mean: Annotated[Number, Field(description="In the channel's unit.")]
    min: Annotated[Number, Field(description="In the channel's unit.")]
    max: Annotated[Number, Field(description="In the channel's unit.")]
    count: Annotated[int, Field(ge=0, description="Good samples in the bucket.")]
    quality: Quality


def sample_item(channel: str, time_us: int, value: float | None, quality: int) -> SampleItem:
    """Show one sample."""
    return {
        "channel": channel,
        "time": rfc3339_exact(time_us),
        "value": value,
        "quality": int(quality),
    }


class Measurements(Page):
    """History with quality, ascending by time, then by channel."""

    resolution: str = Field(
        description="What `items` are: raw samples, or buckets of this length.", examples=["1min"]
    )
    items: list[SampleItem] | list[ReceivedSampleItem] | list[BucketItem]


class Rejected(Document):
    """A sample that was not taken, and why."""

    index: int = Field(description="Place in `samples`, from 0.")
    detail: str


class Pushed(Document):
    """What became of the samples; the answer means that those taken are on the disk."""

    accepted: int = Field(description="Newly stored.", examples=[2])
    duplicates: int = Field(description="Already stored: sent again.", examples=[0])
    rejected: list[Rejected]
    clock_ahead_s: float | None = Field(
        None,
        description="By how many seconds of process time the newest sample is ahead. Only where "
        "that is more than 5 s of wall time: the clock of the sender is wrong, and samples of such "
        "a channel are stored as uncertain, the newest with the time of its receipt.",
        examples=[280.0],
        exclude_if=is_none,
    )
