"""Units of measurement systems, turned into those of our channels."""

import math
from typing import Final

from service.domain.channels import unit_of

# By our unit: the names that others give it or another unit, with scale and offset into ours.
# "Â°C" is what readers make of a UTF-8 file that they take for a Western European one.
_NAMES: Final = {
    "°C": {
        ("°C", "degC", "deg C", "DegC", "℃", "C", "Cel", "Celsius", "Â°C"): (1.0, 0.0),
        ("K", "degK", "Kelvin"): (1.0, -273.15),
        ("°F", "degF", "deg F", "DegF", "F", "Fahrenheit", "Â°F"): (5.0 / 9.0, -160.0 / 9.0),
    },
    "rpm": {
        ("rpm", "RPM", "1/min", "min-1", "min^-1", "/min", "r/min", "rev/min", "U/min"): (1.0, 0.0),
        ("1/s", "s-1", "s^-1", "rps", "r/s", "rev/s", "Hz"): (60.0, 0.0),
        ("rad/s",): (30.0 / math.pi, 0.0),
    },
    "N": {
        ("N", "Newton", "newton"): (1.0, 0.0),
        ("daN",): (10.0, 0.0),
        ("kN",): (1e3, 0.0),
        ("lbf",): (4.4482216152605, 0.0),
    },
}
_KNOWN: Final = {
    ours: {name: factors for names, factors in groups.items() for name in names}
    for ours, groups in _NAMES.items()
}


def into_ours(channel: str, unit: str) -> tuple[float, float] | None:
    """Give the scale and the offset that turn values of a unit into those of a channel.

    ``unit``: as a file has it; empty counts as the channel's own. A channel without a unit of ours
    has 1 and 0; where the unit is no unit of the channel, None.
    """
    ours = unit_of(channel)
    if not unit.strip() or ours not in _KNOWN:
        return 1.0, 0.0
    return _KNOWN[ours].get(unit.strip())


def units_of(channel: str) -> tuple[str, ...]:
    """Units that `into_ours` knows for a channel, ours first."""
    return tuple(names[0] for names in _NAMES.get(unit_of(channel), {}))
