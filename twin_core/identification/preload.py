"""What a refused fit of a hot inner ring may mean."""

import numpy as np

from twin_core.identification.data import IdentificationData

_INNER, _OUTER = "t_inner_ring_c", "t_outer_ring_c"
_HOTTER_K = 18.0
_COOLING_K = 2.0
_LATE_ROWS, _BEFORE_ROWS = 10, 30


def preload_warning(data: IdentificationData) -> str:
    """Say that the data may show thermal preload; empty where nothing points to it.

    An inner ring more than 18 K above the outer ring at the end of a window that does not cool (by
    2 K from half an hour to ten minutes before) may lose its clearance. No law of the twin fits
    that, and it is how a runaway begins. Friction of fresh grease, the other thing that the twin
    may fail to fit, falls.
    """
    for window in data.windows:
        minutes = window.minutes
        if not {_INNER, _OUTER} <= set(minutes.sensors):
            continue
        end = np.flatnonzero(minutes.good)[-(_LATE_ROWS + _BEFORE_ROWS) :]
        if end.size < _LATE_ROWS + _BEFORE_ROWS:
            continue
        inner, outer = (minutes.temperatures_c[name][end] for name in (_INNER, _OUTER))
        late, before = slice(-_LATE_ROWS, None), slice(0, _BEFORE_ROWS)
        hotter_k = float(np.nanmean(inner[late]) - np.nanmean(outer[late]))
        rise_k = float(np.nanmean(inner[late]) - np.nanmean(inner[before]))
        if hotter_k > _HOTTER_K and rise_k > -_COOLING_K:
            course = "still climbs" if rise_k > 0.0 else "hardly cools"
            return (
                f"; the inner ring is {hotter_k:.0f} K hotter than the outer ring and {course}: "
                "the bearing may be losing its clearance (thermal preload), a runaway is possible"
            )
    return ""
