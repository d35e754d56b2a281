"""Which steps of the plan were called *not safe*: each stays so until it has ended or was changed.

The forecast is made again every minute with slightly other numbers. A step that was called *not
safe* is not called *safe* because of that: a person may have read the first word only.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from service.live.outlook import StepOutlook, same_point

#: A step that ends earlier by more than this share of it, or this time, was changed.
_SHORTENED_SHARE, _SHORTENED_S = 0.1, 60.0


@dataclass(frozen=True, slots=True)
class NotSafeCall:
    """A planned step that was called *not safe*.

    Attributes
    ----------
    speed_rpm, load_n : float
        Its set-points.
    start_us, end_us : int
        Process times of its begin and end by the plan.
    called_us : int
        When it was called *not safe*.
    probability : float
        That it exceeds a limit, as it was forecast then.
    """

    speed_rpm: float
    load_n: float
    start_us: int
    end_us: int
    called_us: int
    probability: float

    def moved(self, by_us: int) -> "NotSafeCall":
        """Give it by a clock that was set by so much."""
        times_us = (self.start_us, self.end_us, self.called_us)
        start_us, end_us, called_us = (time_us + by_us for time_us in times_us)
        return replace(self, start_us=start_us, end_us=end_us, called_us=called_us)


def span_us(step: StepOutlook, made_us: int) -> tuple[int, int]:
    """Begin and end of a step of a forecast in process time, its end by the plan."""
    start_us = made_us + round(step.start_s * 1e6)
    length_s = step.end_s - step.start_s if step.plan is None else step.plan.duration_s
    return start_us, start_us + round(length_s * 1e6)


def call_of(called: Iterable[NotSafeCall], step: StepOutlook, made_us: int) -> NotSafeCall | None:
    """What was said of a step before, with its present end; None where nothing was.

    A step is the same while its set-points are, and while it does not end much earlier. It may
    begin and end later: the controller waits.
    """
    if step.plan is None:
        return None
    start_us, end_us = span_us(step, made_us)
    for one in called:
        tolerance_us = max(_SHORTENED_S * 1e6, _SHORTENED_SHARE * (one.end_us - one.start_us))
        if (
            same_point(one.speed_rpm, one.load_n, step.plan.speed_rpm, step.plan.load_n)
            and start_us < one.end_us
            and end_us >= one.end_us - tolerance_us
        ):
            return replace(one, end_us=max(one.end_us, end_us))
    return None


def call(step: StepOutlook, made_us: int, now_us: int, probability: float) -> NotSafeCall | None:
    """Note that a step is called *not safe* now; None where it is not a step of a plan."""
    if step.plan is None:
        return None
    start_us, end_us = span_us(step, made_us)
    return NotSafeCall(
        step.plan.speed_rpm, step.plan.load_n, start_us, end_us, now_us, round(probability, 4)
    )


def called_steps_to_rows(called: Iterable[NotSafeCall]) -> list[list[float]]:
    """Rows for the state that is kept for the next start."""
    return [
        [one.speed_rpm, one.load_n, one.start_us, one.end_us, one.called_us, one.probability]
        for one in called
    ]


def called_steps_of(rows: Sequence[Sequence[float]]) -> tuple[NotSafeCall, ...]:
    """Read the rows again.

    Raises
    ------
    ValueError
        Where they are of another form.
    """
    try:
        return tuple(
            NotSafeCall(float(speed), float(load), int(start), int(end), int(at), float(share))
            for speed, load, start, end, at, share in rows
        )
    except TypeError as error:
        raise ValueError(f"called_steps: expected rows of six numbers: {error}") from error
