"""How fast a model's sensors answer: the time constants that its data must resolve."""

import numpy as np

from twin_core.network_model import NetworkModel
from twin_core.simulation import kernels

RELEVANT_SHARE = 0.01
"""A mode counts where it carries this part of a sensor's steady answer to heat at some node."""


def fastest_time_s(model: NetworkModel) -> float:
    """Return the shortest time constant in s that shows in a standard sensor.

    That of the modes at the model's reference point, with the parameters at the prior's centre, so
    that it belongs to the network and not to what was identified.
    """
    held = model.at_reference(0.0)
    values = held.parameters.centre
    capacity, coefficient, _, _ = kernels.bind_network(held.compiled, values)
    rate, modes, _, _ = kernels.decompose(
        held.compiled, capacity, coefficient, *(float(one) for one in held.reference_point)
    )
    seen = held.sensor_matrix(held.sensor_names) @ modes
    # Steady answer (sensors, nodes, modes) of the sensors to heat at the nodes.
    answer = np.abs(seen[:, None, :] * modes[None, :, :]) / np.maximum(rate, 1e-12)
    share = np.max(answer / np.maximum(answer.sum(axis=2, keepdims=True), 1e-300), axis=(0, 1))
    relevant = share >= RELEVANT_SHARE
    return float(1.0 / np.max(rate[relevant]))
