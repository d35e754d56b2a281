"""How a machine is run: at a point, now or up to now, and over a step."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Point:
    """What a machine runs at."""

    speed_rpm: float
    load_n: float
    ambient_c: float
    #: (k,) the network's inputs, in its order; empty where it has none.
    inputs: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Step:
    """A span at constant speed and load."""

    speed_rpm: float
    load_n: float
    duration_s: float
