"""What the cell shows of an asset to the other processes, and to no caller."""

from service.documents.base import Document
from service.documents.profiles import OperatingPoint


class AssetFacts(Document):
    """What others must know of an asset before they ask anything; see `AssetReplica`."""

    running: bool
    channels: dict[str, str]
    temperature_names: list[str]


class PointOfEstimate(OperatingPoint):
    """What the machine runs at."""

    ambient_c: float
    inputs: tuple[float, ...]


class Estimate(Document):
    """What the live twin knows at a moment; ``machine`` is read by `twin_core.MachineState`."""

    machine: dict[str, object]
    point: PointOfEstimate
    time_us: int


class PresentMachine(Document):
    """What answers to callers are computed from: model version, estimate, plan and readings.

    Speeds and loads that are planned, operating channels without a usable value, and the good and
    fresh reading of each sensor. The estimate is None before the first good values.
    """

    version: int
    estimate: Estimate | None
    planned: list[tuple[float, float]]
    missing: list[str]
    measured_c: dict[str, float | None]
