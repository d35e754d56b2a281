"""How far a machine is from a thermal runaway at one operating point: of a plan, the heaviest."""

from dataclasses import replace

import numpy as np

from twin_core.forecasting.envelope import Envelope, envelope
from twin_core.forecasting.runaway import LIKELY, RunawayDistance, newtons_left
from twin_core.identification.posterior import Posterior
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.operating_points import STANDING_RPM
from twin_core.simulation import OperatingProfile

_LOADS = np.array([0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0])
_HERE, _LAST = 5, _LOADS.size - 1


def runaway_margin(
    model: ThermalModel,
    posterior: Posterior,
    state: MachineState,
    speed_rpm: float,
    load_n: float,
) -> RunawayDistance:
    """Return how far a machine is from a thermal runaway at one operating point, held for hours.

    For the margin in newtons loads from half to twice that of the point are looked at, no more of
    them than a search for the load needs. Speed not negative, load above 0; raises as
    `twin_core.forecasting.envelope.envelope`.
    """
    loads = load_n * _LOADS

    def held(*rows: int) -> Envelope:
        return envelope(model, posterior, state, [speed_rpm], loads[list(rows)], {})

    found = held(_HERE, _LAST)
    probability = dict(zip((_HERE, _LAST), found.runaway_probability[:, 0].tolist(), strict=True))
    low, high = _HERE, _LAST
    if probability[_HERE] >= LIKELY:
        low, high = 0, _HERE
        probability[low] = float(held(low).runaway_probability[0, 0])
    while high - low > 1 and probability[low] < LIKELY <= probability[high]:
        middle = (low + high) // 2
        probability[middle] = float(held(middle).runaway_probability[0, 0])
        low, high = (low, middle) if probability[middle] >= LIKELY else (middle, high)
    rows = sorted(probability)
    left_n = newtons_left(loads[rows], np.array([[probability[row]] for row in rows]))
    return RunawayDistance(
        speed_rpm=speed_rpm,
        load_n=load_n,
        probability=probability[_HERE],
        loop_gain=float(found.loop_gain[0, 0, 0]),
        loop_gain_upper=float(found.loop_gain[1, 0, 0]),
        margin_k=float(found.margin_k[0, 0]),
        margin_n=float(left_n[rows.index(_HERE), 0]),
    )


def heaviest_margin(
    model: ThermalModel, posterior: Posterior, state: MachineState, profile: OperatingProfile
) -> RunawayDistance | None:
    """Return the margin where speed times load of a profile is highest, held for hours.

    Ambient temperature and inputs are those of that row. None for a machine without limits of a
    runaway, and where it only stands or runs without load.
    """
    power = np.abs(profile.speed_rpm) * profile.load_n
    row = int(np.argmax(power))
    speed_rpm, load_n = abs(float(profile.speed_rpm[row])), float(profile.load_n[row])
    if model.runaway is None or speed_rpm < STANDING_RPM or load_n <= 0.0:
        return None
    there = replace(
        state, ambient_c=float(profile.ambient_c[row]), inputs=tuple(profile.inputs[row])
    )
    return runaway_margin(model, posterior, there, speed_rpm, load_n)
