"""Thermal plant of the virtual bench: 28 nodes, integrated in small implicit steps.

`simulate` runs a whole profile offline; `Plant` advances the same equations piece by piece for the
live process. Both give the same numbers for the same rows.
"""

from dataclasses import dataclass

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
class BenchProfile:
    """True operating point of the bench; row k holds from time_s[k] to time_s[k + 1].

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Ascending times in seconds.
    speed_rpm, load_n, ambient_c : ndarray, shape (n,)
        What the shaft, the hydraulics and the air really do; the last row holds at no time.
    """

    time_s: NDArray[np.float64]
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]


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
    """

    time_s: NDArray[np.float64]
    temperatures_c: NDArray[np.float64]
    paper_nodes_c: NDArray[np.float64]
    power_w: NDArray[np.float64]
    preload: NDArray[np.float64]

    @property
    def t_inner_ring_c(self) -> NDArray[np.float64]:
        """Inner surface of the inner ring, where T_ir is measured."""
        return self.temperatures_c[:, INNER_BORE]

    @property
    def t_outer_ring_c(self) -> NDArray[np.float64]:
        """Outer surface of the outer ring, where T_or is measured."""
        return self.temperatures_c[:, OUTER_SURFACE]


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
        self.run_in = parameters.run_in_state
        self.weights = paper_node_weights(self.model.network)

    def advance(
        self,
        duration_s: NDArray[np.float64],
        speed_rpm: NDArray[np.float64],
        load_n: NDArray[np.float64],
        ambient_c: NDArray[np.float64],
        *,
        max_step_s: float = MAX_STEP_S,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Hold each operating point for its duration.

        Parameters
        ----------
        duration_s, speed_rpm, load_n, ambient_c : ndarray, shape (n,)
            Rows to run through.
        max_step_s : float
            Longest integration step in seconds.

        Returns
        -------
        tuple of ndarray
            Temperatures (n, 28) in degC, friction power (n,) in W and preload factor (n,) at the
            end of every row.
        """
        rows = duration_s.size
        temperatures = np.empty((rows, NODE_COUNT))
        power, preload = np.empty(rows), np.empty(rows)
        self.run_in = integrate(
            self.temperatures_c,
            self.run_in,
            duration_s,
            speed_rpm,
            load_n,
            ambient_c,
            max_step_s,
            self.model,
            temperatures,
            power,
            preload,
        )
        return temperatures, power, preload


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
    temperatures, power, preload = plant.advance(
        np.diff(profile.time_s),
        np.ascontiguousarray(profile.speed_rpm[:-1], dtype=np.float64),
        np.ascontiguousarray(profile.load_n[:-1], dtype=np.float64),
        np.ascontiguousarray(profile.ambient_c[:-1], dtype=np.float64),
        max_step_s=max_step_s,
    )
    temperatures = np.vstack([np.full(NODE_COUNT, start), temperatures])
    return Truth(
        time_s=profile.time_s,
        temperatures_c=temperatures,
        paper_nodes_c=temperatures @ plant.weights.T,
        power_w=np.concatenate([[0.0], power]),
        preload=np.concatenate([[1.0], preload]),
    )
