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

    ``oil_loss``: (n,) how fast the grease loses its oil, in multiples of the rate that its life is
    stated for; ``cooling``: (n,) factor on the heat that housing and base plate give to the air.
    """

    oil_loss: NDArray[np.float64]
    cooling: NDArray[np.float64]

    @classmethod
    def unchanged(cls, rows: int) -> "Condition":
        """A machine that stays as it is."""
        return cls(np.zeros(rows), np.ones(rows))


@dataclass(frozen=True, slots=True)
class BenchProfile:
    """True operating point of the bench; row k holds from time_s[k] to time_s[k + 1]."""

    time_s: NDArray[np.float64]  # (n,) ascending times in seconds
    #: (n,) what the shaft, the hydraulics and the air really do; the last row holds at no time.
    speed_rpm: NDArray[np.float64]
    load_n: NDArray[np.float64]
    ambient_c: NDArray[np.float64]
    #: How the machine itself changes meanwhile; default not at all.
    condition: Condition | None = None


@dataclass(frozen=True, slots=True)
class Truth:
    """True temperatures of a run, at the times of its profile."""

    time_s: NDArray[np.float64]  # (n,) times in seconds
    temperatures_c: NDArray[np.float64]  # (n, 28) all nodes in the order of `NODE_NAMES`, degC
    paper_nodes_c: NDArray[np.float64]  # (n, 13) the same averaged into the 13 nodes of the paper
    power_w: NDArray[np.float64]  # (n,) friction power just before each time; 0 at the first
    preload: NDArray[np.float64]  # (n,) factor of thermal preload on the friction load
    #: (n,) running-in state of the grease and the oil left in it; 1 is fresh.
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
    """States of the plant, one per row."""

    temperatures_c: NDArray[np.float64]  # (n, 28) all nodes in degC
    grease: NDArray[np.float64]  # (n, 2) running-in state and oil left
    #: (n,) friction power and factor of thermal preload.
    power_w: NDArray[np.float64]
    preload: NDArray[np.float64]


class Plant:
    """A bench whose physics are advanced piece by piece."""

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
        """Hold each operating point (n,) for its duration; returns the state at the end of each."""
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
    """Run a profile on a bench, offline; a row of the result per row, the first the initial state.

    Everything has the first ambient temperature at the start unless ``start_c`` is given.
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
