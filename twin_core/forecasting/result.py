"""What a forecast is: members, quantiles, and how likely and when a limit is passed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.limits import first_crossings
from twin_core.forecasting.whole_run import whole_run_band

FloatArray = NDArray[np.float64]

_EARLIEST = 0.025


@dataclass(frozen=True, slots=True)
class Exceedance:
    """How likely and when a limit is passed."""

    probability: float  # share of the members that pass the limit within the span
    #: Time at which half of the members have passed it; None when fewer than half do.
    median_s: float | None
    #: Time at which 2.5 % of the members have passed it; None when fewer do.
    earliest_s: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """An ensemble forecast."""

    time_s: FloatArray  # (n,) times of the rows, as in the profile
    names: tuple[str, ...]  # sensors, then nodes
    #: (5, n, names) at 2.5, 25, 50, 75 and 97.5 %, degC: of what a sensor will read, of a node's
    #: true temperature.
    quantiles: FloatArray
    #: (members, n, sensors) readings of every member without their minute-to-minute noise.
    members_c: FloatArray
    sensors: tuple[str, ...]  # names of the members' last axis
    runaway_probability: float  # that the machine runs away; see `twin_core.forecasting.runaway`
    #: What must be said with this forecast; see `twin_core.forecasting.labels`.
    labels: tuple[str, ...]
    #: (n, sensors) factors on the 95 % band of each moment with which 90 % of runs stay inside with
    #: all of their readings; see `twin_core.forecasting.whole_run`.
    whole_run_factor: FloatArray
    #: Share of the members that run away: a sensor passes the temperature of the model's limits (of
    #: a bearing 130 degC), or the simulation fails.
    runaway_share: float = 0.0
    #: Nodes that no sensor shows well enough, by name: half the 95 % band, K, that they would have
    #: if all sensors were known exactly, where it is widest.
    not_known: Mapping[str, float] = field(default_factory=dict)

    def quantile(self, name: str) -> FloatArray:
        """Return the (5, n) quantiles of a sensor or node."""
        return np.asarray(self.quantiles[:, :, self._index(self.names, name)])

    def whole_run(self, name: str) -> FloatArray:
        """Return the edges (2, n) of the band that 90 % of runs of a sensor stay inside wholly."""
        factor = self.whole_run_factor[:, self._index(self.sensors, name)]
        return whole_run_band(self.quantile(name), factor)

    def exceedance(
        self, name: str, limit_c: float, start_s: float = -np.inf, end_s: float = np.inf
    ) -> Exceedance:
        """Return how likely and when a sensor reaches a limit between two times, both inclusive.

        Crossing times are interpolated between rows; a member that is over the limit at the first
        row of the span crosses it there. Raises `KeyError` if there is no such sensor, `ValueError`
        if no row lies in the span.
        """
        rows = np.flatnonzero((self.time_s >= start_s) & (self.time_s <= end_s))
        if rows.size == 0:
            raise ValueError(f"no row of the forecast lies between {start_s} and {end_s} s")
        paths = self.members_c[:, rows, self._index(self.sensors, name)]
        if np.max(paths) < limit_c:
            return Exceedance(0.0, None, None)  # as of most machines: without a look at each member
        times = np.sort(first_crossings(self.time_s[rows], paths, limit_c))
        crossed = int(np.count_nonzero(np.isfinite(times)))
        return Exceedance(
            probability=crossed / times.size,
            median_s=_time_of_share(times, 0.5),
            earliest_s=_time_of_share(times, _EARLIEST),
        )

    @staticmethod
    def _index(names: Sequence[str], name: str) -> int:
        if name not in names:
            raise KeyError(f"{name!r} is not in this forecast, expected one of {', '.join(names)}")
        return names.index(name)


def _time_of_share(ordered_times: FloatArray, share: float) -> float | None:
    """Time at which a share of the members has crossed; None when fewer do."""
    needed = max(int(np.ceil(share * ordered_times.size)), 1)
    time = float(ordered_times[needed - 1])
    return time if np.isfinite(time) else None
