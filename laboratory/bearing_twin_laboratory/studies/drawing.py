"""What the plots of the studies have in common."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bearing_twin_laboratory.studies.bench_runs import NODES, RINGS, BenchRun
from bearing_twin_laboratory.studies.study import Document, figure
from twin_core.forecasting import Forecast

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

RING_NAMES = {"t_inner_ring_c": "T_ir", "t_outer_ring_c": "T_or"}
_COLOURS = {"t_inner_ring_c": "tab:red", "t_outer_ring_c": "tab:blue"}


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Readings of both rings over a whole run and a forecast of a part of it.

    - ``time_h``: (n,) since the start.
    - ``measured_c``: (n,) by sensor.
    - ``ahead_h``: (m,) times of the forecast.
    - ``quantiles_c``: (5, m) by sensor.
    """

    time_h: FloatArray
    measured_c: dict[str, FloatArray]
    ahead_h: FloatArray
    quantiles_c: dict[str, FloatArray]

    def since(self, row: int) -> "Curves":
        """The same without the readings before a row; time counts from there."""
        start_h = float(self.time_h[row])
        return Curves(
            self.time_h[row:] - start_h,
            {name: values[row:] for name, values in self.measured_c.items()},
            self.ahead_h - start_h,
            self.quantiles_c,
        )


def curves(run: BenchRun, made: Forecast, begun: int) -> Curves:
    """Curves of a forecast that was made at row ``begun`` of a run."""
    return Curves(
        run.minutes.time_s / 3600.0,
        {ring: run.minutes.temperatures_c[ring] for ring in RINGS},
        (run.minutes.time_s[begun] + made.time_s) / 3600.0,
        {ring: made.quantile(ring) for ring in RINGS},
    )


def draw_curves(axes: "Axes", shown: Curves, *, legend: bool) -> None:
    """Readings of both rings, median and 95 % band of a forecast."""
    for ring in RINGS:
        name, colour = RING_NAMES[ring], _COLOURS[ring]
        low, _, median, _, high = shown.quantiles_c[ring]
        axes.plot(
            shown.time_h, shown.measured_c[ring], color="0.2", linewidth=0.9, label=f"real {name}"
        )
        axes.fill_between(shown.ahead_h, low, high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(
            shown.ahead_h,
            median,
            color=colour,
            linewidth=1.2,
            linestyle="--",
            label=f"predicted {name}",
        )
    axes.set_xlabel("time, h")
    axes.set_ylabel("temperature, °C")
    axes.grid(alpha=0.3)
    if legend:
        axes.legend(loc="upper left", fontsize="small")


def draw_agreement(axes: "Axes", measured: FloatArray, quantiles: FloatArray, title: str) -> None:
    """Readings over their predictions, with the 95 % band; those outside it are circled.

    - ``measured``: (m,) readings.
    - ``quantiles``: (5, m) of their predictions.
    - ``title``: what stands over it.
    """
    low, _, median, _, high = quantiles
    outside = (measured < low) | (measured > high)
    axes.vlines(median, low, high, color="tab:orange", alpha=0.25, linewidth=1.0, label="95 % band")
    axes.plot(median, measured, ".", color="0.2", markersize=3, label="real")
    axes.plot(
        median[outside],
        measured[outside],
        "o",
        markerfacecolor="none",
        markeredgecolor="tab:blue",
        markersize=6,
        label=f"outside: {np.mean(outside):.1%}",
    )
    ends = [float(np.min(median)), float(np.max(median))]
    axes.plot(ends, ends, color="tab:red", linewidth=0.8)
    axes.set(title=title, xlabel="predicted, °C", ylabel="real, °C")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")


def draw_node_map(
    schemes: Mapping[str, Document], name: str, title: str, digits: int = 2
) -> "Figure":
    """A figure of all nodes under every scheme; nodes with a sensor of their own are framed.

    - ``schemes``: by name; with the figures of ``nodes``, and with ``sensors`` where some have
      their own.
    - ``name``: which figure.
    - ``title``, ``digits``: what stands over it, and decimals.
    """
    made = figure(12.0, 4.0)
    axes = made.subplots()
    values = np.array(
        [
            [scheme["nodes"].get(node, {}).get(name, np.nan) for node in NODES]
            for scheme in schemes.values()
        ],
        dtype=np.float64,
    )
    image = axes.imshow(values, cmap="YlOrBr_r", aspect="auto", vmin=0.0)
    for (row, column), value in np.ndenumerate(values):
        shade = "black" if value > 0.4 * np.nanmax(values) else "white"
        framed = NODES[column] in list(schemes.values())[row].get("sensors", ())
        axes.text(
            column,
            row,
            f"{value:.{digits}f}",
            ha="center",
            va="center",
            color=shade,
            bbox={"boxstyle": "round", "fill": False, "edgecolor": shade} if framed else None,
        )
    axes.set_xticks(range(len(NODES)), [f"T{number + 1}" for number in range(len(NODES))])
    axes.set_yticks(range(len(schemes)), list(schemes))
    axes.set_title(title)
    made.colorbar(image, ax=axes)
    return made
