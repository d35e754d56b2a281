"""What sisters, machines of the same family, have given to a machine's posterior.

It travels with the posterior: forecasts say it, count deviations from where sisters have been, and
widen their bands by what the sisters' own forecasts would have needed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin_core.scores import WHOLE_RUN_LEVEL

Law = Literal["load", "speed", "start", "housing"]
"""How friction grows with load; with speed and temperature; how it falls from fresh grease on; and
all the rest: housing, films, joints, the level of the friction."""
LawSource = Literal["own", "family", "literature"]

BEYOND = 1.1
"""A load or speed of more than this many times the trained one has not been trained."""

_REACHED = 0.98
_MORE_PROBABLE = 0.5
# The levels that conformal prediction can promise, and how many bearings each needs at least.
_LEVELS = ((0.95, 19), (0.90, 9))


@dataclass(frozen=True, slots=True)
class SisterRun:
    """One sister played as the target: forecast from its easy part, scored over the rest."""

    bearing: str  # which sister
    #: Heaviest load in N and highest speed in rpm of the part that was forecast.
    load_n_max: float
    speed_rpm_max: float
    #: By sensor, the factor on its 95 % band with which the band would have held 95 % of that
    #: part's readings; 1 means that the band was just right.
    needed: Mapping[str, float]
    #: By sensor, the factor on its band of the whole run with which that would have held all of
    #: these readings; empty in files of earlier versions.
    needed_whole: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BandFactor:
    """A factor on the 95 % band, learned from runs of sisters."""

    by_sensor: Mapping[str, float]
    #: How many it was learned from.
    runs: int
    bearings: int
    level: float  # share of bearings whose run the band is to hold
    #: The factors on the band of the whole run, for 90 % of bearings.
    whole_by_sensor: Mapping[str, float] = field(default_factory=dict)

    def of_whole_run(self, sensors: Sequence[str], rows: NDArray[np.bool_]) -> NDArray[np.float64]:
        """What to multiply the whole run's factor on the calibrated band with, (n, sensors).

        A sensor without a factor of its own keeps the ratio of its two bands. `rows` (n,): where
        the band of each moment is calibrated.
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
class LawTrust:
    """Where a law of a machine's posterior comes from, and what speaks for it."""

    #: ``"own"``: its own data decide it; else whichever of both priors is the more probable.
    source: LawSource
    weight_family: float  # probability that the family's law is this machine's, 0 to 1
    #: Natural logarithm of how many times more probable the family's law makes the machine's own
    #: data than the literature's, all else the family's; None where no family was asked.
    log_bayes_factor: float | None
    tested: bool  # whether the machine's own data say anything about the law
    settled_by: str | None  # what it would take to test it; None where it is tested

    @property
    def rests_on_family(self) -> bool:
        """Whether the family's law is the more probable one."""
        return self.weight_family >= _MORE_PROBABLE

    @property
    def said(self) -> str:
        """The same in words."""
        if self.tested or not self.rests_on_family:
            odds = f"family's with {self.weight_family:.0%}"
            return odds if self.source != "own" else f"{odds}, its own data say most of it"
        would = f"; {self.settled_by} would settle it" if self.settled_by else ""
        return f"family's, not tested on this machine{would}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "source": self.source,
            "weight_family": self.weight_family,
            "log_bayes_factor": self.log_bayes_factor,
            "tested": self.tested,
            "settled_by": self.settled_by,
        }


@dataclass(frozen=True, slots=True)
class SisterKnowledge:
    """Which sisters a prior was made of, where they have been, how their forecasts did."""

    names: tuple[str, ...]  # of the sisters
    #: Highest load in N and speed in rpm that each was identified from.
    loads_n: tuple[float, ...]
    speeds_rpm: tuple[float, ...]
    #: Their own forecasts; empty where their rows are not known.
    calibration: tuple[SisterRun, ...] = ()
    #: How far each law is trusted; empty in files of earlier versions, which trusted all or none.
    laws: Mapping[Law, LawTrust] = field(default_factory=dict)

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

    def taught(self, law: Law) -> bool:
        """Whether a law rests on them."""
        return law not in self.laws or self.laws[law].rests_on_family

    def band_factor(self, load_n: float, speed_rpm: float) -> BandFactor | None:
        """Give the factor on the band of a forecast that goes beyond what was trained.

        Conformal prediction with bearings as the exchangeable units: of m bearings the k-th
        smallest need holds for a further one with probability k / (m + 1). A bearing with several
        runs counts with the greatest need of these.

        `load_n`, `speed_rpm`: where the forecast goes; only runs that went there count. 0 for what
        it stays within. It is for 95 % of bearings where 19 or more reach that far, for 90 %
        where 9 do, else None.
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
            "laws": {law: trust.to_dict() for law, trust in self.laws.items()},
        }

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "SisterKnowledge":
        """Take back what `to_dict` gave."""
        return cls(
            tuple(str(name) for name in document["names"]),
            tuple(float(load) for load in document["loads_n"]),
            tuple(float(speed) for speed in document["speeds_rpm"]),
            tuple(
                SisterRun(
                    str(run["bearing"]),
                    float(run["load_n_max"]),
                    float(run["speed_rpm_max"]),
                    {name: float(needed) for name, needed in run["needed"].items()},
                    {name: float(needed) for name, needed in run.get("needed_whole", {}).items()},
                )
                for run in document["calibration"]
            ),
            {law: LawTrust(**trust) for law, trust in document.get("laws", {}).items()},
        )


def _ranked(needs: Sequence[tuple[str, Mapping[str, float]]], rank: int) -> dict[str, float]:
    """The rank-th smallest of the bearings' greatest needs, of sensors that all runs have.

    One at least: so few bearings can confirm a band or widen it, and what is doubted of the family
    must not be narrowed by it.
    """
    found = {}
    for sensor in sorted(set.intersection(*(set(needed) for _, needed in needs))):
        greatest: dict[str, float] = {}
        for bearing, needed in needs:
            greatest[bearing] = max(greatest.get(bearing, 0.0), needed[sensor])
        found[sensor] = max(sorted(greatest.values())[rank - 1], 1.0)
    return found
