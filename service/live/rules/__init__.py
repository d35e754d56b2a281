"""Which alarm conditions of one asset hold now: pure rules, one module per kind of evidence.

Delays, states and the journal are the alarm book's. A condition is True, False, or None where it
cannot be told (no good sample): an alarm then stays as it is. No rule ever looks at a sample that
is not good.
"""

from service.live.readings import allowed_age_s
from service.live.rules.limits import above_ambient, forecast_limits, measured_limits
from service.live.rules.scene import LEVELS, Scene
from service.live.rules.sensors import sensor_faults, stale_data
from service.live.rules.twin import rate_of_rise, twin_difference, twin_residual

__all__ = [
    "LEVELS",
    "Scene",
    "above_ambient",
    "allowed_age_s",
    "forecast_limits",
    "measured_limits",
    "rate_of_rise",
    "sensor_faults",
    "stale_data",
    "twin_difference",
    "twin_residual",
]
