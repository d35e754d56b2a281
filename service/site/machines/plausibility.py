"""What speed, load, temperatures and times say of a mistake in their units.

One table for live values, recordings, profiles and the check of a configuration. A load in
kilonewtons or a temperature in kelvin fits as well as one in our unit, and every forecast of it is
wrong: only a figure that no machine has shows it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from service.domain.channels import AMBIENT, LOAD, SPEED, is_temperature
from service.site.machines.bearings import BearingSection
from twin_core.operating_points import STANDING_RPM

FloatArray = NDArray[np.float64]
Weight = Literal["said", "not accepted", "refused"]

# The least load at which balls roll is a hundredth of the dynamic rating; a tenth of that is a
# machine without load, or a load in another unit.
_LEAST_LOAD_SHARE = 0.001
_LOADED = 0.95
_USUAL_AMBIENT_C, _ANY_AMBIENT_C = (-60.0, 60.0), (-60.0, 100.0)
_KELVIN, _HOTTEST_C, _HOTTEST_START_C = 273.15, 200.0, 150.0
_LONGEST_STEP_S, _MOST_STEP_S, _SHORTEST_S, _FEWEST_ROWS = 3600.0, 600.0, 600.0, 10


@dataclass(frozen=True, slots=True)
class Doubt:
    """Why values may be in another unit than they should be.

    - ``text``: one line: the channel, what was found, what was expected and the guess.
    - ``words``: the same for an operator, without figures that change.
    - ``weight``: ``said``: a machine can be so. ``not accepted``: no model of it is activated
      without a person. ``refused``: no machine can be so.
    """

    channel: str
    text: str
    weight: Weight = "said"
    words: str = ""


def load_doubt(bearing: BearingSection | None, speed_rpm: float, load_n: float) -> Doubt | None:
    """Doubt a load that is next to nothing while the machine turns.

    ``bearing``: None for a network of one's own, of which nothing is known.
    """
    if bearing is None or abs(speed_rpm) < STANDING_RPM:
        return None
    rating_n = _static_load_rating_n(bearing)
    least_n = _LEAST_LOAD_SHARE * rating_n
    if abs(load_n) >= least_n:
        return None
    in_kn = least_n <= 1000.0 * abs(load_n) <= rating_n
    guess = "kN?" if in_kn else "no load, or not measured?"
    return Doubt(
        LOAD,
        f"{LOAD}: {load_n:.3g} at {speed_rpm:.0f} rpm; expected {least_n:.0f} N or more, 0.1 % of "
        f"the static load rating; {guess}",
        "not accepted" if in_kn else "said",
        f"load below {least_n:.0f} N at this speed: {guess}",
    )


@lru_cache(maxsize=256)
def _static_load_rating_n(bearing: BearingSection) -> float:
    return bearing.bearing().static_load_rating_n


def ambient_doubt(bearing: BearingSection | None, ambient_c: float) -> Doubt | None:
    """Doubt an ambient temperature that people do not work in."""
    low_c, high_c = _USUAL_AMBIENT_C
    if low_c <= ambient_c <= high_c:
        return None
    guess = "not measured there?"
    if low_c <= ambient_c - _KELVIN <= high_c:
        guess = "kelvin?"
    elif high_c < ambient_c and (ambient_c - 32.0) / 1.8 <= high_c:
        guess = "°F?"
    impossible = not _ANY_AMBIENT_C[0] <= ambient_c <= _ANY_AMBIENT_C[1]
    return Doubt(
        AMBIENT,
        f"{AMBIENT}: {ambient_c:.1f}; expected {low_c:g} to {high_c:g} °C; {guess}",
        "refused" if impossible and bearing is not None else "said",
        f"ambient not within {low_c:g} to {high_c:g} °C: {guess}",
    )


def doubts_of_values(
    bearing: BearingSection | None, values: Mapping[str, float | None]
) -> list[Doubt]:
    """Doubts of the present values by channel; None is no good one."""
    speed_rpm, load_n, ambient_c = (values.get(name) for name in (SPEED, LOAD, AMBIENT))
    found: list[Doubt | None] = []
    if speed_rpm is not None and load_n is not None:
        found.append(load_doubt(bearing, speed_rpm, load_n))
    if ambient_c is not None:
        found.append(ambient_doubt(bearing, ambient_c))
    return [one for one in found if one is not None]


def doubts_of_rows(
    bearing: BearingSection | None, columns: Mapping[str, FloatArray], time_s: FloatArray
) -> list[Doubt]:
    """Doubts of rows: columns (n,) by channel, NaN where there is no value, at times (n,) in s."""
    known = {name: values[np.isfinite(values)] for name, values in columns.items()}
    typical = {name: float(np.median(values)) for name, values in known.items() if values.size}
    if SPEED in columns and LOAD in columns:
        turning = np.abs(columns[SPEED]) >= STANDING_RPM
        turning &= np.isfinite(columns[LOAD])
        if turning.any():
            # A machine may idle for most of its time, and turn either way.
            typical[SPEED] = float(np.median(np.abs(columns[SPEED][turning])))
            typical[LOAD] = float(np.quantile(np.abs(columns[LOAD][turning]), _LOADED))
    found = doubts_of_values(bearing, typical)
    if bearing is not None:
        found += _kelvin_doubts(known, typical.get(AMBIENT))
        found += _time_doubts(time_s)
    return found


def _kelvin_doubts(known: Mapping[str, FloatArray], ambient_c: float | None) -> Iterator[Doubt]:
    """Doubt temperatures that are never below 200 °C, and ordinary ones as kelvins."""
    if ambient_c is None or ambient_c > _HOTTEST_C:  # said of ambient
        return
    for name, values in known.items():
        if is_temperature(name) and values.size:
            least_c = float(values.min())
            if least_c > _HOTTEST_C and least_c - _KELVIN < _HOTTEST_START_C:
                text = f"{name}: {least_c:.1f} and more; expected a start below {_HOTTEST_C:g} °C"
                yield Doubt(name, f"{text}; kelvin?", "refused")


def _time_doubts(time_s: FloatArray) -> Iterator[Doubt]:
    if time_s.size < _FEWEST_ROWS:
        return
    step_s = float(np.median(np.diff(time_s)))
    duration_s = float(time_s[-1] - time_s[0])
    if step_s > _LONGEST_STEP_S:
        guess = "; ms?" if step_s <= 1000.0 * _MOST_STEP_S else ""
        text = f"time_s: rows {step_s:.6g} s apart, {step_s / 3600.0:.1f} h; expected minutes"
        yield Doubt("time_s", text + guess, "refused")
    elif duration_s < _SHORTEST_S:
        text = f"time_s: all rows within {duration_s:.0f} s; expected hours; minutes?"
        yield Doubt("time_s", text)
