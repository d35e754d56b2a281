"""What can be simulated: any thermal network together with its parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_core.network import CompiledNetwork, Network
from twin_core.parameters import ParameterSet


@dataclass(frozen=True, slots=True, eq=False)
class NetworkModel:
    """A network and its parameters, compiled, ready to simulate.

    Parameters
    ----------
    name
        For reports.
    network
        Nodes, edges, heat source and sensors as data.
    parameters
        What is identified, with priors.
    compiled
        The network as flat arrays.
    """

    name: str
    network: Network
    parameters: ParameterSet
    compiled: CompiledNetwork

    @property
    def node_names(self) -> tuple[str, ...]:
        """Names of the state nodes in order."""
        return self.network.node_names

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the standard sensors."""
        return tuple(sensor.name for sensor in self.network.sensors)

    def sensor_row(self, name: str) -> NDArray[np.float64]:
        """Weights of the nodes in a sensor's reading.

        Parameters
        ----------
        name
            A sensor or a node (a node's own sensor reads that node).

        Returns
        -------
        ndarray
            Shape (nodes,).

        Raises
        ------
        ValueError
            If there is no such sensor or node.
        """
        row = np.zeros(len(self.node_names))
        if name in self.node_names:
            row[self.node_names.index(name)] = 1.0
            return row
        for sensor in self.network.sensors:
            if sensor.name == name:
                for node, weight in sensor.weights:
                    row[self.node_names.index(node)] += weight
                return row
        raise ValueError(
            f"unknown sensor {name!r}, expected one of "
            f"{', '.join((*self.sensor_names, *self.node_names))}"
        )

    def sensor_matrix(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Rows of several sensors, shape (len(names), nodes)."""
        return np.array([self.sensor_row(name) for name in names]).reshape(
            len(names), len(self.node_names)
        )
