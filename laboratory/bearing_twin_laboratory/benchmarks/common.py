"""What all benchmarks share: what one gives, and how time is taken."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from service.cli.errors import BadInputError

Progress = Callable[[float, str], None]
"""Called with the fraction done and a few words."""


class BenchmarkError(BadInputError):
    """A benchmark that does not exist or cannot run here; the text is one line."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """A figure and its reference.

    - ``value``, ``unit``: the figure: seconds, per second, bytes.
    - ``reference``: the figure measured next to it in the same run, same unit; None if there is
      none.
    - ``compared_with``: what the reference is, for people.
    - ``extra``: further figures by name.
    """

    value: float
    unit: str
    reference: float | None = None
    compared_with: str = ""
    extra: Mapping[str, object] = field(default_factory=dict)

    @property
    def ratio(self) -> float | None:
        """Value over reference."""
        return None if not self.reference else self.value / self.reference

    def to_dict(self) -> dict[str, object]:
        """Return plain JSON types."""
        return {
            "value": self.value,
            "unit": self.unit,
            "reference": self.reference,
            "ratio": self.ratio,
            "compared_with": self.compared_with,
            **self.extra,
        }


def shortest_s(
    function: Callable[[], object], *, at_least_s: float = 1.0, at_least: int = 5
) -> float:
    """Shortest duration of a call in s, after one call that does not count.

    On a machine that does other things too, the shortest of many calls is what the call itself
    takes.

    - ``function``: what is called.
    - ``at_least_s``, ``at_least``: repeated until both this time has passed and this many calls
      have been made.
    """
    function()
    best, calls, begun = float("inf"), 0, time.perf_counter()
    while calls < at_least or time.perf_counter() - begun < at_least_s:
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
        calls += 1
    return best
