"""Flat tags for SCADA systems, and the snapshot of them.

Typed dictionaries and no models: every asset's tags are made again ten times a second, and compared
with those before.
"""

import math
from typing import Annotated

from pydantic import ConfigDict, Field, with_config
from typing_extensions import TypedDict

from service.documents.base import Quality, Time


@with_config(ConfigDict(extra="forbid"))
class Tag(TypedDict):
    """One value for a SCADA system; null when the quality is bad."""

    value: Annotated[float | None, Field(examples=[63.4])]
    unit: Annotated[str, Field(description="Empty for a number without one.", examples=["°C"])]
    quality: Quality
    time: Annotated[Time, Field(description="Of the value, process time.")]


@with_config(ConfigDict(extra="forbid"))
class Snapshot(TypedDict):
    """Flat tags: measured, estimated (`.twin`), forecast maxima, times to limit, alarm counts."""

    tags: dict[str, Tag]


def tag(value: float | None, unit: str, quality: int, time: str) -> Tag:
    """One snapshot tag; a value that is not a number is null."""
    if value is not None:
        # A scaled register is 24.7, not 24.700000000000003.
        value = round(value, 6) if math.isfinite(value) else None
    return {"value": value, "unit": unit, "quality": int(quality), "time": time}
