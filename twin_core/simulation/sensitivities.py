"""One simulation together with its derivatives by parameters and initial temperatures."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.network_model import NetworkModel
from twin_core.simulation.compiling import kernel_array
from twin_core.simulation.profile import OperatingProfile, SimulationError
from twin_core.simulation.simulate import inputs_of
from twin_core.simulation.tangents import tangent_kernel


class Sensitivities(NamedTuple):
    """What :func:`simulate_sensitivities` gives."""

    #: Shape (n, r): temperatures of the r outputs at the profile's rows.
    temperatures_c: NDArray[np.float64]
    #: Shape (n, r, p): their derivatives by the parameters, in K per the parameter's unit.
    by_value: NDArray[np.float64]
    #: Shape (n, r, e): by the coordinates of the initial temperatures.
    by_initial: NDArray[np.float64]


def simulate_sensitivities(
    model: NetworkModel,
    values: ArrayLike,
    profile: OperatingProfile,
    initial_temperatures_c: ArrayLike,
    revolutions: float = 0.0,
    *,
    initial_directions: ArrayLike | None = None,
    outputs: ArrayLike | None = None,
) -> Sensitivities:
    """Simulate one parameter vector and differentiate what is simulated.

    The derivatives are those of the discrete scheme that :func:`simulate` computes, not a
    discretisation of the sensitivity equations: they agree with differences of simulations as far
    as those are exact. All together they cost a few simulations, whatever their number.

    `values` (p,), physical units; bounds are not enforced; `initial_temperatures_c` (nodes,), at
    the first row; `revolutions` since greasing at the first row; `initial_directions` (nodes, e):
    what one unit of each coordinate of the initial state adds to the initial temperatures; default
    none; `outputs` (r, nodes): weights of the nodes in each output, such as
    :meth:`~twin_core.network_model.NetworkModel.sensor_matrix`; default the nodes themselves.
    Raises `SimulationError` if the temperatures do not stay finite, `ValueError` if a shape is
    wrong.
    """
    nodes, size = len(model.node_names), model.parameters.size
    vector = kernel_array(values)
    initial = kernel_array(initial_temperatures_c)
    if initial_directions is None:
        initial_directions = np.empty((nodes, 0))
    directions = kernel_array(initial_directions)
    rows = kernel_array(np.eye(nodes) if outputs is None else outputs)
    for name, array, expected in (
        ("values", vector, (size,)),
        ("initial_temperatures_c", initial, (nodes,)),
        ("initial_directions", directions, (nodes, *directions.shape[-1:])),
        ("outputs", rows, (len(rows), nodes)),
    ):
        if array.shape != expected:
            raise ValueError(f"{name} has shape {array.shape}, expected {expected}")
    out = np.empty((profile.size, len(rows)))
    derivative = np.empty((profile.size, len(rows), size + directions.shape[1]))
    inputs = inputs_of(model, profile)
    failed = tangent_kernel(
        model.compiled,
        vector,
        (profile.time_s, profile.speed_rpm, profile.load_n, profile.ambient_c, inputs),
        initial,
        directions,
        float(revolutions),
        rows,
        out,
        derivative,
    )
    if failed >= 0:
        raise SimulationError(
            f"simulation of model {model.name!r} ran away before "
            f"time_s = {profile.time_s[failed]:g}"
        )
    return Sensitivities(out, derivative[..., :size], derivative[..., size:])
