"""Spans of constant speed and load within measured rows, and what is new among them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

STANDING_RPM = 10.0
"""Below this speed a machine is at standstill: the one rule for estimates, windows and forecasts.

Two rules of the service differ for a reason, which stands next to them: the check of flat lines in
`service.ingest.quality`, and the setting of the alarms on standstill."""

# Two rows belong to one operating point when speed and load differ by less than this, relative or
# absolute: measurement noise, hysteresis of the loading.
_SAME_SPEED = (0.02, 30.0)
_SAME_LOAD = (0.03, 60.0)
# Shorter spans are transitions, not operating points.
_SHORTEST_POINT_S = 180.0
# A point that lasted this long is one that the machine was held at.
HELD_S = 1200.0
# The duty of a machine varies when it was held nowhere for so long, and for this part of its time.
_VARYING_S, _VARYING_SHARE = 1200.0, 0.25
# Against other windows a point counts as new from these relative differences on.
NEW_SPEED = 0.10
NEW_LOAD = 0.08


@dataclass(frozen=True, slots=True)
class OperatingSpan:
    """A span of constant speed and load; means over the span."""

    speed_rpm: float
    load_n: float
    duration_s: float
    start_s: float

    @property
    def end_s(self) -> float:
        """End of the span."""
        return self.start_s + self.duration_s

    def to_dict(self) -> dict[str, float]:
        """Return plain JSON types."""
        return asdict(self)

    @classmethod
    def from_dict(cls, document: Mapping[str, float]) -> "OperatingSpan":
        """Take back what `to_dict` gave."""
        return cls(**{field.name: float(document[field.name]) for field in fields(cls)})


def split(
    time_s: FloatArray, speed_rpm: FloatArray, load_n: FloatArray, spacing_s: float = 60.0
) -> tuple[OperatingSpan, ...]:
    """Split rows (n,), finite, into spans of constant speed and load.

    A row belongs to the present span while it stays near the span's running mean. Spans shorter
    than three minutes (ramps) and standstill are left out. The last row of a span lasts
    `spacing_s`.
    """
    points: list[OperatingSpan] = []
    span: list[int] = []
    speed_mean = load_mean = 0.0

    def close() -> None:
        if not span or speed_mean < STANDING_RPM:
            return
        start_s = float(time_s[span[0]])
        duration_s = float(time_s[span[-1]]) - start_s + spacing_s
        if duration_s < _SHORTEST_POINT_S:
            return
        last = points[-1] if points else None
        if (
            last is not None
            and _near(last.speed_rpm, speed_mean, _SAME_SPEED)
            and _near(last.load_n, load_mean, _SAME_LOAD)
            and start_s - last.end_s < _SHORTEST_POINT_S
        ):
            points[-1] = _joined(last, speed_mean, load_mean, duration_s, start_s)
        else:
            points.append(OperatingSpan(speed_mean, load_mean, duration_s, start_s))

    for row in range(time_s.size):
        speed, load = float(abs(speed_rpm[row])), float(load_n[row])
        if span and _near(speed, speed_mean, _SAME_SPEED) and _near(load, load_mean, _SAME_LOAD):
            span.append(row)
            speed_mean += (speed - speed_mean) / len(span)
            load_mean += (load - load_mean) / len(span)
        else:
            close()
            span, speed_mean, load_mean = [row], speed, load
    close()
    return tuple(points)


def varying_duty(
    time_s: FloatArray,
    speed_rpm: FloatArray,
    load_n: FloatArray,
    points: Sequence[OperatingSpan],
    spacing_s: float = 60.0,
) -> tuple[OperatingSpan, ...]:
    """Sum up the duty of a machine that is held nowhere: where it ran, and for how long.

    A vehicle's motor never holds a point. What its temperatures follow is the mean over minutes of
    what drives them, so the rows outside the points that lasted 20 min are averaged over blocks of
    three minutes, the shortest time that makes an operating point, and blocks alike are put
    together. Faster changes leave one mean, which is all that they teach.

    `time_s`, `speed_rpm`, `load_n` (n,), finite; `points`: the operating points of these rows, from
    `split`; `spacing_s`: how long the last row of a block lasts. Each point has its time in all,
    from the first block on. Empty unless the duty varies for 20 min and a quarter of the time on
    the running machine.
    """
    held = np.zeros(time_s.size, dtype=np.bool_)
    for point in points:
        if point.duration_s >= HELD_S:
            held |= (time_s >= point.start_s) & (time_s < point.end_s)
    lasts_s = np.append(np.minimum(np.diff(time_s), 5.0 * spacing_s), spacing_s)[: time_s.size]
    running = np.abs(speed_rpm) >= STANDING_RPM
    varying_s = float(np.sum(lasts_s[running & ~held]))
    if varying_s < max(_VARYING_S, _VARYING_SHARE * float(np.sum(lasts_s[running]))):
        return ()
    blocks: list[OperatingSpan] = []
    rows: list[int] = []
    for row in range(time_s.size + 1):
        ends = row == time_s.size or held[row] or not running[row]
        broken = bool(rows) and not ends and time_s[row] - time_s[rows[-1]] > 5.0 * spacing_s
        lasted_s = float(np.sum(lasts_s[rows])) if rows else 0.0
        if rows and (ends or broken or lasted_s >= _SHORTEST_POINT_S):
            if lasted_s >= _SHORTEST_POINT_S:
                blocks.append(_mean_point(time_s, speed_rpm, load_n, lasts_s, rows))
            rows = []
        if not ends:
            rows.append(row)
    return tuple(new_points((), sorted(blocks, key=demand, reverse=True), 0.0))


def _mean_point(
    time_s: FloatArray,
    speed_rpm: FloatArray,
    load_n: FloatArray,
    lasts_s: FloatArray,
    rows: list[int],
) -> OperatingSpan:
    weights = lasts_s[rows]
    return OperatingSpan(
        speed_rpm=float(np.average(np.abs(speed_rpm[rows]), weights=weights)),
        load_n=float(np.average(load_n[rows], weights=weights)),
        duration_s=float(np.sum(weights)),
        start_s=float(time_s[rows[0]]),
    )


def taught_values(
    points: Sequence[OperatingSpan],
    duty: Sequence[OperatingSpan],
    quantity: Literal["speed_rpm", "load_n"],
    relative: float,
) -> list[float]:
    """Speeds or loads, none alike to another, that were run for 20 min.

    Each in one go on a machine that is held at points; in all on one whose duty varies.
    """
    if not duty:
        lasting = [getattr(point, quantity) for point in points if point.duration_s >= HELD_S]
        return distinct_values(lasting, relative)
    total_s: dict[float, float] = {}
    for point in (*points, *duty):
        value = float(getattr(point, quantity))
        known = next((other for other in total_s if alike(value, other, relative)), value)
        total_s[known] = total_s.get(known, 0.0) + point.duration_s
    return [value for value, seconds in total_s.items() if seconds >= HELD_S]


def _near(value: float, reference: float, tolerance: tuple[float, float]) -> bool:
    relative, absolute = tolerance
    return abs(value - reference) <= max(relative * abs(reference), absolute)


def _joined(
    last: OperatingSpan, speed_rpm: float, load_n: float, duration_s: float, start_s: float
) -> OperatingSpan:
    weight = duration_s / (duration_s + last.duration_s)
    return OperatingSpan(
        speed_rpm=(1.0 - weight) * last.speed_rpm + weight * speed_rpm,
        load_n=(1.0 - weight) * last.load_n + weight * load_n,
        duration_s=start_s + duration_s - last.start_s,
        start_s=last.start_s,
    )


def alike(first: float, second: float, relative: float) -> bool:
    """Return whether two positive numbers differ by at most a relative amount."""
    return abs(first - second) <= relative * max(abs(first), abs(second))


def distinct_values(values: Sequence[float], relative: float) -> list[float]:
    """Return the values of which none is alike to one before it."""
    found: list[float] = []
    for value in values:
        if not any(alike(value, other, relative) for other in found):
            found.append(value)
    return found


def new_points(
    known: Sequence[OperatingSpan],
    candidates: Sequence[OperatingSpan],
    min_duration_s: float,
) -> list[OperatingSpan]:
    """Return the candidates that no known point is like, each once.

    A point is new when its speed differs by more than 10 % or its load by more than 8 % from every
    known one. Spans at alike points add up.

    `min_duration_s`: shortest total time at a new point that counts.
    """
    found: list[OperatingSpan] = []
    for point in candidates:
        if any(alike_points(point, other) for other in known):
            continue
        for index, other in enumerate(found):
            if alike_points(point, other):
                total = other.duration_s + point.duration_s
                found[index] = replace(other, duration_s=total)
                break
        else:
            found.append(point)
    return [point for point in found if point.duration_s >= min_duration_s]


def usual_levels(points: Sequence[OperatingSpan]) -> tuple[tuple[float, float], ...]:
    """Speed in rpm and load in N of the lighter, the middle and the heavier third of the time.

    Each is the mean over the points of that third, sorted by what a bearing's heat follows.
    """
    ordered = sorted(points, key=demand)
    total_s = sum(point.duration_s for point in ordered)
    if total_s <= 0.0:
        return ()
    ends_s = np.cumsum([point.duration_s for point in ordered])
    starts_s = ends_s - [point.duration_s for point in ordered]
    levels = []
    for third in range(3):
        low_s, high_s = total_s * third / 3.0, total_s * (third + 1) / 3.0
        weights = np.clip(np.minimum(ends_s, high_s) - np.maximum(starts_s, low_s), 0.0, None)
        levels.append(
            (
                float(np.average([point.speed_rpm for point in ordered], weights=weights)),
                float(np.average([point.load_n for point in ordered], weights=weights)),
            )
        )
    return tuple(dict.fromkeys(levels))


def demand(point: OperatingSpan) -> float:
    """Something that grows with the heat of a bearing: speed, and load to a middling exponent."""
    return float(point.speed_rpm * max(point.load_n, 1.0) ** 0.6)


def alike_points(first: OperatingSpan, second: OperatingSpan) -> bool:
    """Return whether two points are at most 10 % of speed and 8 % of load apart."""
    return alike(first.speed_rpm, second.speed_rpm, NEW_SPEED) and alike(
        first.load_n, second.load_n, NEW_LOAD
    )
