"""Speeds, loads and ambient temperatures that a machine can have; anything else is a fault.

A deep groove ball bearing with grease is limited to a speed factor ``n dm`` of about 0.5 to 0.6
million mm/min, in traction motors with hybrid bearings of about 1 million; it deforms for good
from its static load rating C0 on (ISO 76). Twice these figures no machine reaches.
"""

from collections.abc import Mapping

from service.domain.channels import AMBIENT, LOAD, SPEED
from service.site.machines.bearings import BearingSection

SPEED_FACTOR_MM_RPM = 1.0e6
GENEROUS = 2.0
#: What a load cell may show of an unloaded machine, as a share of C0.
_UNLOADED = 0.05
_AMBIENT_C = (-60.0, 100.0)
# Of a network of one's own nothing is known but that it is a machine.
_ANY_SPEED_RPM, _ANY_LOAD_N = 100_000.0, 1_000_000.0

TEMPERATURE_C = (-80.0, 600.0)
"""What a temperature sensor on a machine can show."""

REFUSED_BEYOND = 1.5
"""Beyond this multiple of the default range no value is accepted, whatever is configured."""

Range = tuple[float, float]


def operating_ranges(bearing: BearingSection | None) -> Mapping[str, Range]:
    """Lowest and highest plausible value of speed in rpm, load in N and ambient in degC.

    ``bearing``: None for a network of one's own.
    """
    speed_rpm, load_n, unloaded_n = _ANY_SPEED_RPM, _ANY_LOAD_N, -_ANY_LOAD_N
    if bearing is not None:
        known = bearing.bearing()
        speed_rpm = GENEROUS * SPEED_FACTOR_MM_RPM / known.pitch_diameter_mm
        load_n = GENEROUS * known.static_load_rating_n
        unloaded_n = -_UNLOADED * known.static_load_rating_n
    return {
        SPEED: (-speed_rpm, speed_rpm),
        LOAD: (unloaded_n, load_n),
        AMBIENT: _AMBIENT_C,
    }


def refused_beyond(ranges: Mapping[str, Range]) -> Mapping[str, Range]:
    """Widen every range to what is refused outside of it."""
    return {
        name: (low - (REFUSED_BEYOND - 1.0) * abs(low), high + (REFUSED_BEYOND - 1.0) * abs(high))
        for name, (low, high) in ranges.items()
    }
