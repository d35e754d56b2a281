"""What parameters are identified from: windows of measured rows and how each one began."""

from dataclasses import dataclass

from twin_core.operating_points import new_points
from twin_core.windows import MinuteData, OperatingSpan, window_of


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationWindow:
    """One contiguous span of measured rows."""

    minutes: MinuteData  # the rows; bad ones are skipped, not filled
    #: Whether the whole machine was at ambient temperature at the first row. If not, the initial
    #: temperatures are estimated along with the parameters.
    at_rest: bool
    #: Revolutions of the shaft since the grease was fresh, at the first row.
    revolutions: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationData:
    """All windows of one identification, in time order.

    Raises `ValueError` if there is no window, or one without three good rows with a temperature.
    """

    windows: tuple[IdentificationWindow, ...]

    def __post_init__(self) -> None:
        if not self.windows:
            raise ValueError("no windows, expected at least one")
        for number, window in enumerate(self.windows):
            if int(window.minutes.good.sum()) < 3 or not window.minutes.sensors:
                raise ValueError(
                    f"window {number}: {int(window.minutes.good.sum())} good rows with "
                    f"{len(window.minutes.sensors)} temperature sensors, expected at least 3 rows "
                    "with 1 sensor"
                )

    @property
    def operating_points(self) -> tuple[OperatingSpan, ...]:
        """The operating points of all windows."""
        return tuple(
            point for window in self.windows for point in window_of(window.minutes).operating_points
        )

    @property
    def duty(self) -> tuple[OperatingSpan, ...]:
        """Where the machine ran while it was held nowhere, of all windows."""
        points = [point for window in self.windows for point in window_of(window.minutes).duty]
        return tuple(new_points((), points, 0.0))
