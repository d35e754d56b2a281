"""Thermal plant of the virtual bench: 28 nodes, integrated in small implicit steps.

`simulate` runs a whole profile offline; `Plant` advances the same equations piece by piece for the
live process. Both give the same numbers for the same rows.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.virtual_bench.kernel import build_model, integrate
from adapters.virtual_bench.network import (
    INNER_BORE,
    NODE_COUNT,
    OUTER_SURFACE,
    paper_node_weights,
)
from adapters.virtual_bench.parameters import BenchParameters

MAX_STEP_S = 1.0


@dataclass(frozen=True, slots=True)
class Condition:
    """What changes about a machine while it runs, row by row.

    Attributes
    ----------
    oil_loss : ndarray, shape (n,)
        How fast the grease loses its oil, in multiples of the rate that its life is stated for.
    cooling : ndarray, shape (n,)
        Factor on the heat that housing and base plate give to the air.
    """

    oil_loss: NDArray[np.float64]
    cooling: NDArray[np.float64]

    @classmethod
    def unchanged(cls, rows: int) -> "Condition":
        """A machine that stays as it is."""
        return cls(np.zeros(rows), np.ones(rows))


@dataclass(frozen=True, slots=True)
class BenchProfile:
    """True operating point of the bench; row k holds from time_s[k] to time_s[k + 1].

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Ascending times in seconds.
    speed_rpm, load_n, ambient_c : ndarray, shape (n,)
        What the shaft, the hydraulics and the air really do; the last row holds at no time.
    condition : Condition
        How the machine itself changes meanwhile; default not at all.
    """

    time_s: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
    condition: Condition | None = None


@dataclass(frozen=True, slots=True)
class Truth:
    """True temperatures of a run, at the times of its profile.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times in seconds.
    temperatures_c : ndarray, shape (n, 28)
        All nodes in the order of `NODE_NAMES`, degC.
    paper_nodes_c : ndarray, shape (n, 13)
        The same averaged into the 13 nodes of the paper.
    power_w : ndarray, shape (n,)
        Friction power just before each time; 0 at the first.
    preload : ndarray, shape (n,)
        Factor of thermal preload on the friction load.
    run_in, oil : ndarray, shape (n,)
        Running-in state of the grease and the oil left in it; 1 is fresh.
    """

    time_s: NDArray[np.float64]
    temperatures_c: NDArray[np.float64]
    paper_nodes_c: NDArray[np.float64]
    power_w: NDArray[np.float64]
    preload: NDArray[np.float64]
    run_in: NDArray[np.float64]
    oil: NDArray[np.float64]

    @property
    def t_inner_ring_c(self) -> NDArray[np.float64]:
        """Inner surface of the inner ring, where T_ir is measured."""
        return self.temperatures_c[:, INNER_BORE]

    @property
    def t_outer_ring_c(self) -> NDArray[np.float64]:
        """Outer surface of the outer ring, where T_or is measured."""
        return self.temperatures_c[:, OUTER_SURFACE]


class PlantRows(NamedTuple):
    """States of the plant, one per row.

    Attributes
    ----------
    temperatures_c : ndarray, shape (n, 28)
        All nodes in degC.
    grease : ndarray, shape (n, 2)
        Running-in state and oil left.
    power_w, preload : ndarray, shape (n,)
        Friction power and factor of thermal preload.
    """

    temperatures_c: NDArray[np.float64]
    grease: NDArray[np.float64]
    power_w: NDArray[np.float64]
    preload: NDArray[np.float64]


class Plant:
    """A bench whose physics are advanced piece by piece.

    Parameters
    ----------
    parameters : BenchParameters
        The bench.
    start_c : float
        Temperature of everything at the start in degC.
    """

    def __init__(self, parameters: BenchParameters, start_c: float) -> None:
        self.model = build_model(parameters)
        self.temperatures_c = np.full(NODE_COUNT, start_c)
        self.grease = np.array([parameters.run_in_state, 1.0])  # running-in state, oil left
        self.weights = paper_node_weights(self.model.network)

    def advance(
        self,
        duration_s: NDArray[np.float64],
        speed_rpm: NDArray[np.float64],
        load_n: NDArray[np.float64],
        ambient_c: NDArray[np.float64],
        condition: Condition,
        *,
        max_step_s: float = MAX_STEP_S,
    ) -> PlantRows:
        """Hold each operating point for its duration.

        Parameters
        ----------
        duration_s, speed_rpm, load_n, ambient_c : ndarray, shape (n,)
            Rows to run through.
        condition : Condition
            The same rows.
        max_step_s : float
            Longest integration step in seconds.

        Returns
        -------
        PlantRows
            State at the end of every row.
        """
        rows = duration_s.size
        out = PlantRows(
            np.empty((rows, NODE_COUNT)), np.empty((rows, 2)), np.empty(rows), np.empty(rows)
        )
        integrate(
            self.temperatures_c,
            self.grease,
            duration_s,
            speed_rpm,
            load_n,
            ambient_c,
            condition.oil_loss,
            condition.cooling,
            max_step_s,
            self.model,
            *out,
        )
        return out


def simulate(
    profile: BenchProfile,
    parameters: BenchParameters,
    *,
    start_c: float | None = None,
    max_step_s: float = MAX_STEP_S,
) -> Truth:
    """Run a profile on a bench, offline.

    Parameters
    ----------
    profile : BenchProfile
        True speed, load and ambient.
    parameters : BenchParameters
        The bench.
    start_c : float, optional
        Temperature of everything at the start; default the first ambient temperature.
    max_step_s : float
        Longest integration step in seconds.

    Returns
    -------
    Truth
        One row per row of the profile; the first is the initial state.
    """
    start = float(profile.ambient_c[0]) if start_c is None else start_c
    plant = Plant(parameters, start)
    condition = profile.condition or Condition.unchanged(profile.time_s.size)
    fresh = plant.grease.copy()
    speed, load, ambient = (
        np.ascontiguousarray(values[:-1], dtype=np.float64)
        for values in (profile.speed_rpm, profile.load_n, profile.ambient_c)
    )
    rows = plant.advance(
        np.diff(profile.time_s),
        speed,
        load,
        ambient,
        Condition(condition.oil_loss[:-1], condition.cooling[:-1]),
        max_step_s=max_step_s,
    )
    temperatures = np.vstack([np.full(NODE_COUNT, start), rows.temperatures_c])
    grease = np.vstack([fresh, rows.grease])
    return Truth(
        time_s=profile.time_s,
        temperatures_c=temperatures,
        paper_nodes_c=temperatures @ plant.weights.T,
        power_w=np.concatenate([[0.0], rows.power_w]),
        preload=np.concatenate([[1.0], rows.preload]),
        run_in=grease[:, 0],
        oil=grease[:, 1],
    )
