"""What the live twin of an asset keeps for its next start, as plain JSON types.

It is read with care: another release, or another configuration, may have written it.
"""

from typing import TypedDict


class KeptChart(TypedDict):
    """The sequential test of one temperature."""

    high: float
    low: float
    usual: list[float]


class KeptReference(TypedDict):
    """Temperatures of the nodes as the model alone has them."""

    temperatures_c: list[float]
    revolutions: float


class KeptWatch(TypedDict, total=False):
    """What the alarm rules have learnt, and of which model version."""

    version: int
    spoken: list[str]
    reference: KeptReference | None
    residuals: dict[str, KeptChart]


class KeptEstimate(TypedDict, total=False):
    """The running estimate; ``observer`` is read by `twin_core.observer.Observer`."""

    bearing: str
    time_us: int
    observer: dict[str, object]
    speed_rpm: float
    load_n: float
    ambient_c: float
    inputs: list[float]
    ambient_measured: bool
    followed_s: float


class KeptState(KeptEstimate, total=False):
    """All of it; what follows the forecasts adds what it knows under its name."""

    watch: KeptWatch
    called_steps: list[list[float]]
