"""Operating points and profiles, as several answers show them."""

from pydantic import Field

from service.documents.base import Document


class OperatingPoint(Document):
    """A speed and a radial load."""

    speed_rpm: float = Field(description="rpm", examples=[4200])
    load_n: float = Field(description="N", examples=[2650])


class StepLevel(OperatingPoint):
    """A span at constant speed and load."""

    duration_s: float = Field(description="Seconds.", examples=[3600])


class ForecastStep(Document):
    """A span of constant operation that a forecast follows."""

    duration_s: float = Field(description="Seconds.", examples=[3600])
    speed_rpm: float = Field(description="rpm", examples=[4200])
    load_n: float = Field(description="Radial load, N.", examples=[2650])
    ambient_c: float = Field(description="Ambient temperature, °C.", examples=[23.1])
