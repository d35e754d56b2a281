"""Limits and regions of operation, as several answers show them."""

from typing import Literal

from pydantic import Field

from service.documents.base import Document, Number

Level = Literal["warning", "alarm"]


class Limits(Document):
    """Limits of one temperature, °C."""

    warning: float = Field(examples=[90])
    alarm: float = Field(examples=[105])


class LowRisk(Document):
    """The region whose data may be used for identification."""

    speed_rpm_max: float = Field(description="rpm", examples=[4300])
    load_n_max: float = Field(description="Radial load, N.", examples=[3000])


class Limit(Document):
    """One limit of one temperature."""

    channel: str = Field(examples=["t_inner_ring_c"])
    level: Level
    value_c: float = Field(description="The limit itself, °C.", examples=[90])


class Crossing(Document):
    """When and how probably a limit is exceeded within the horizon of a forecast."""

    probability: float = Field(ge=0, le=1, description="That it is exceeded.", examples=[0.42])
    median_s: Number = Field(
        description="Seconds from the moment of the forecast until half of its members exceed it; "
        "null when fewer do."
    )
    earliest_s: Number = Field(
        description="Seconds until 2.5 % of its members exceed it; null when fewer do."
    )


Crossings = dict[str, dict[Level, Crossing]]
"""By channel and level."""
