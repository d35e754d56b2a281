"""How a machine is run: an operating point, now or up to now."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class OperatingPoint:
    """What a machine runs at.

    Attributes
    ----------
    speed_rpm, load_n, ambient_c
        Speed, load and ambient temperature.
    inputs
        (k,) the network's inputs, in its order; empty where it has none.
    """

    speed_rpm: float
    load_n: float
    ambient_c: float
    inputs: tuple[float, ...] = ()
