"""The members of an ensemble on their way through a profile."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.forecasting.draws import normal_draws, parameter_draws
from twin_core.forecasting.paths import net_heat_range
from twin_core.identification.posterior import Posterior
from twin_core.kalman import DISTURBANCE_TIME_S
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM
from twin_core.profiles import Point
from twin_core.simulation import (
    OperatingProfile,
    OperatingProfiles,
    heat_balance_w,
    kernels,
    simulate_batch,
)

FloatArray = NDArray[np.float64]


def stands(profile: OperatingProfile) -> NDArray[np.bool_]:
    """In which rows (n,) the machine stands."""
    return np.asarray(np.abs(profile.speed_rpm) < STANDING_RPM)


def goes_on_as(operating_point: Point, profile: OperatingProfile) -> bool:
    """Whether the machine goes on running, or standing, as up to now."""
    return bool(stands(profile)[0] == (abs(operating_point.speed_rpm) < STANDING_RPM))


@dataclass(frozen=True, slots=True, eq=False)
class Members:
    """An ensemble at its start."""

    best: FloatArray  # (p,) the best parameters
    values: FloatArray  # (members, p) parameters of the members
    #: (members, nodes) temperatures in degC, and heats in W beyond the members' models.
    start_c: FloatArray
    heat_w: FloatArray


def draw_members(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    count: int,
    rng: np.random.Generator,
    goes_on: bool = True,
) -> Members:
    """Draw parameters and states, and set every member on the observed course.

    `count` is even: random numbers come in antithetic pairs. Unless the machine `goes_on` as up to
    now there are no heats: what is wrong is mostly friction.

    Raises `ValueError` if posterior and model do not belong together, or ``count`` is odd or below
    2.
    """
    posterior.check(model)
    if count < 2 or count % 2:
        raise ValueError(f"members is {count}, expected an even number of at least 2")
    parameters = model.parameters
    z = np.clip(parameter_draws(rng, count, posterior), parameters.z_lower, parameters.z_upper)
    values = parameters.values_from_z(z)
    start_c = state.temperatures_c + rng.permutation(normal_draws(rng, count, state.covariance))
    heat_w = np.zeros(start_c.shape)
    best = parameters.values_from_z(posterior.z)
    if state.heat_disturbance_w is not None and goes_on:
        heat_w += state.heat_disturbance_w
    if state.operating_point is not None and goes_on:
        heat_w += state.course_known * imbalance_w(
            model,
            best,
            state.temperatures_c,
            values,
            start_c,
            state.operating_point,
            state.revolutions,
        )
    return Members(best, values, start_c, heat_w)


def beyond_load(load_n: FloatArray, trained_n: float) -> FloatArray:
    """How far, ln(F / trained), loads lie beyond the trained ones; zero without any of these.

    The prior's spread is for all loads.
    """
    if trained_n <= 0.0:
        return np.zeros(np.shape(load_n))
    return np.asarray(np.log(np.maximum(load_n / trained_n, 1.0)))


def member_paths(
    model: ThermalModel,
    values: FloatArray,
    ahead: OperatingProfile | OperatingProfiles,
    start_c: FloatArray,
    revolutions: ArrayLike,
    heat_w: FloatArray,
) -> FloatArray:
    """Temperatures (members, n, nodes) of members that begin with heats beyond their model's.

    The heats fade, and end when the machine stops or starts: what is wrong is mostly friction. NaN
    throughout where a member runs away.

    `values` (members, p) the members' parameters; `ahead`: n rows for all, or each member's own;
    `start_c`, `heat_w` (members, nodes) temperatures in degC and heats in W at the first row;
    `revolutions` since the grease was fresh, for all or (members,).
    """
    standing = np.abs(ahead.speed_rpm) < STANDING_RPM
    changed = standing != standing[..., :1]
    change = np.where(changed.any(axis=-1), changed.argmax(axis=-1), changed.shape[-1])
    return simulate_batch(
        model,
        values,
        ahead,
        start_c,
        revolutions,
        disturbance_w=heat_w,
        disturbance_time_s=DISTURBANCE_TIME_S,
        disturbance_rows=change,
    )


def imbalance_w(
    model: ThermalModel,
    best: FloatArray,
    state_c: FloatArray,
    values: FloatArray,
    start_c: FloatArray,
    operating_point: Point,
    revolutions: float,
) -> FloatArray:
    """Heats (members, nodes) that set each member, in its own start, on the observed course.

    dT/dt of every node shall be what it is with the best parameters in the observed state.
    """
    model = model.holding(operating_point.inputs)
    capacity = kernels.bind_network(model.compiled, best)[0]
    point = operating_point.speed_rpm, operating_point.load_n, operating_point.ambient_c
    net_w = heat_balance_w(model, best, state_c, *point, revolutions)[0]
    own_w, own_capacity = np.empty(start_c.shape), np.empty(start_c.shape)
    speed_rpm, load_n, ambient_c = point
    net_heat_range(
        model.compiled,
        values,
        start_c,
        abs(float(speed_rpm)),
        max(float(load_n), 0.0),
        float(ambient_c),
        float(revolutions),
        own_w,
        own_capacity,
    )
    return np.asarray(net_w * own_capacity / capacity - own_w)
