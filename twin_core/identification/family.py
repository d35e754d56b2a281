"""What sisters, machines of the same family, have given to a machine's posterior.

It travels with the posterior: forecasts say it, count deviations from where sisters have been, and
widen or narrow their bands by what the sisters' own forecasts would have needed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_core.scores import WHOLE_RUN_LEVEL

BEYOND = 1.1
"""A load or speed of more than this many times the trained one has not been trained."""

_REACHED = 0.98
# The levels that conformal prediction can promise, and how many bearings each needs at least.
_LEVELS = ((0.95, 19), (0.90, 9))


@dataclass(frozen=True, slots=True)
class CalibrationRun:
    """One sister played as the target: forecast from its easy part, scored over the rest.

    Attributes
    ----------
    bearing
        Which sister.
    load_n_max, speed_rpm_max
        Heaviest load in N and highest speed in rpm of the part that was forecast.
    needed
        By sensor, the factor on its 95 % band with which the band would have held 95 % of that
        part's readings; 1 means that the band was just right.
    needed_whole
        By sensor, the factor on its band of the whole run with which that would have held all of
        these readings; empty in files of earlier versions.
    """

    bearing: str
    load_n_max: float
    speed_rpm_max: float
    needed: Mapping[str, float]
    needed_whole: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BandFactor:
    """A factor on the 95 % band, learned from runs of sisters.

    Attributes
    ----------
    by_sensor
        The factors.
    runs, bearings
        How many it was learned from.
    level
        Share of bearings whose run the band is to hold.
    whole_by_sensor
        The factors on the band of the whole run, for 90 % of bearings.
    """

    by_sensor: Mapping[str, float]
    runs: int
    bearings: int
    level: float
    whole_by_sensor: Mapping[str, float] = field(default_factory=dict)

    def of_whole_run(self, sensors: Sequence[str], rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        """What the whole run's factor on the calibrated band is to be multiplied with.

        Parameters
        ----------
        sensors
            Names; one without a factor of its own keeps the ratio of its two bands.
        rows
            (n,) where the band of each moment is calibrated.

        Returns
        -------
        ndarray
            (n, sensors).
        """
        ratio = [
            self.whole_by_sensor[name] / max(self.by_sensor[name], 1e-6)
            if name in self.whole_by_sensor
            else 1.0
            for name in sensors
        ]
        return np.where(rows[:, None], np.array(ratio), 1.0)

    @property
    def label(self) -> str:
        """What a forecast says of it."""
        said = f"calibrated on {self.runs} runs, {self.bearings} bearings"
        return said if self.level >= _LEVELS[0][0] else f"{said}: holds {self.level:.0%} of runs"


@dataclass(frozen=True, slots=True)
class SisterKnowledge:
    """Which sisters a prior was made of, where they have been, how their forecasts did.

    Attributes
    ----------
    names
        Of the sisters.
    loads_n, speeds_rpm
        Highest load in N and speed in rpm that each was identified from.
    calibration
        Their own forecasts; empty where their rows are not known.
    """

    names: tuple[str, ...]
    loads_n: tuple[float, ...]
    speeds_rpm: tuple[float, ...]
    calibration: tuple[CalibrationRun, ...] = ()

    @property
    def count(self) -> int:
        """Number of sisters."""
        return len(self.names)

    def with_load(self, load_n: float) -> int:
        """Number of sisters that have seen a load, or 1/1.1 of it."""
        return sum(BEYOND * seen >= load_n for seen in self.loads_n)

    def with_speed(self, speed_rpm: float) -> int:
        """Number of sisters that have seen a speed, or 1/1.1 of it."""
        return sum(BEYOND * seen >= speed_rpm for seen in self.speeds_rpm)

    @property
    def usual_load_n(self) -> float:
        """Load in N that at least half of the sisters have seen."""
        return float(np.quantile(self.loads_n, 0.5, method="lower"))

    def band_factor(self, load_n: float, speed_rpm: float) -> BandFactor | None:
        """Give the factor on the band of a forecast that goes beyond what was trained.

        Conformal prediction with bearings as the exchangeable units: of m bearings the k-th
        smallest need holds for a further one with probability k / (m + 1). A bearing with several
        runs counts with the greatest need of these.

        Parameters
        ----------
        load_n, speed_rpm
            Where the forecast goes; only runs that went there count. 0 for what it stays within.

        Returns
        -------
        BandFactor or None
            For 95 % of bearings where 19 or more reach that far, for 90 % where 9 do, else None.
        """
        runs = [
            run
            for run in self.calibration
            if run.load_n_max >= _REACHED * load_n and run.speed_rpm_max >= _REACHED * speed_rpm
        ]
        bearings = {run.bearing for run in runs}
        level = next((level for level, fewest in _LEVELS if len(bearings) >= fewest), None)
        if level is None:
            return None
        rank = ceil((len(bearings) + 1) * level - 1e-9)
        of_run = ceil((len(bearings) + 1) * WHOLE_RUN_LEVEL - 1e-9)
        return BandFactor(
            _ranked([(run.bearing, run.needed) for run in runs], rank),
            len(runs),
            len(bearings),
            level,
            _ranked([(run.bearing, run.needed_whole) for run in runs], of_run),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "names": list(self.names),
            "loads_n": list(self.loads_n),
            "speeds_rpm": list(self.speeds_rpm),
            "calibration": [
                {
                    "bearing": run.bearing,
                    "load_n_max": run.load_n_max,
                    "speed_rpm_max": run.speed_rpm_max,
                    "needed": dict(run.needed),
                    "needed_whole": dict(run.needed_whole),
                }
                for run in self.calibration
            ],
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "SisterKnowledge":
        """Take back what `to_dict` gave."""
        return cls(
            tuple(str(name) for name in document["names"]),
            tuple(float(load) for load in document["loads_n"]),
            tuple(float(speed) for speed in document["speeds_rpm"]),
            tuple(
                CalibrationRun(
                    str(run["bearing"]),
                    float(run["load_n_max"]),
                    float(run["speed_rpm_max"]),
                    {name: float(needed) for name, needed in run["needed"].items()},
                    {name: float(needed) for name, needed in run.get("needed_whole", {}).items()},
                )
                for run in document["calibration"]
            ),
        )


def _ranked(needs: Sequence[tuple[str, Mapping[str, float]]], rank: int) -> dict[str, float]:
    """The rank-th smallest of the bearings' greatest needs, of sensors that all runs have."""
    found = {}
    for sensor in sorted(set.intersection(*(set(needed) for _, needed in needs))):
        greatest: dict[str, float] = {}
        for bearing, needed in needs:
            greatest[bearing] = max(greatest.get(bearing, 0.0), needed[sensor])
        found[sensor] = sorted(greatest.values())[rank - 1]
    return found
