"""How much a step of operation would teach: Bayesian experimental design, linearised.

With the sensors' sensitivities over a step, whitened by their error model, as the rows of G, the
parameters' covariance C becomes C' = (C^-1 + G'G)^-1 once the step has been identified from, and
the variance of a forecast with the gradient g falls from g'Cg to g'C'g. Nothing of it depends on
what the step will measure, so steps can be compared before any of them is run.
"""

from collections.abc import Collection, Sequence
from dataclasses import astuple
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_core.forecasting.ensemble import (
    LOAD_DEVIATION,
    SENSOR_OFFSET_K,
    SENSOR_RESOLUTION_K,
    SENSOR_WHITE_K,
)
from twin_core.forecasting.runaway import ring_difference_k
from twin_core.identification.posterior import Posterior
from twin_core.identification.whitening import whitening
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel
from twin_core.process_noise import DEVIATION_K
from twin_core.profiles import Step
from twin_core.simulation import (
    OperatingProfile,
    SimulationError,
    heat_balance_w,
    kernels,
    simulate_batch,
    simulate_sensitivities,
)

FloatArray = NDArray[np.float64]

FRICTION_SHIFT = 0.05
"""By how much the friction of a machine may differ between one stage and the next though nothing
was done to it (the grease has moved): standard deviation, relative. Assumed, not measured."""
_LEAST_STATE_K = 0.02
_NOISE_VARIANCE_K2 = (
    DEVIATION_K**2 + SENSOR_OFFSET_K**2 + SENSOR_WHITE_K**2 + SENSOR_RESOLUTION_K**2 / 12.0
)


class Taught(NamedTuple):
    """What a step would bring."""

    std_k: FloatArray  # (sensors,) standard deviation of the forecast after the step
    #: (sensors,) the same if the machine's friction during the step may differ by `FRICTION_SHIFT`
    #: from what it was before and will be.
    shifted_std_k: FloatArray
    shifted_difference_std_k: float  # the same of the difference between the rings
    upper_c: FloatArray  # (rows, sensors) upper edge (97.5 %) of the readings, minute by minute


class Design:
    """Compares steps by what they would teach about a forecast.

    `state`: where steps and forecast begin; its ambient temperature and inputs are held;
    `measured`: names of the sensors and nodes at which the machine has a sensor; others are
    ignored; `target`: what is to be forecast: the reading of every sensor at the end of this level.

    Attributes: `std_k` (sensors,) present standard deviation of that forecast, by the
    linearisation; `difference_std_k`: the same of the difference between the rings at the target.
    """

    def __init__(
        self,
        model: ThermalModel,
        posterior: Posterior,
        state: MachineState,
        sensors: Sequence[str],
        measured: Collection[str],
        target: Step,
    ) -> None:
        posterior.check(model)
        self._model = model = model.holding(state.inputs)
        self._state = state
        self.target = target
        more = [name for name in model.node_names if name in measured and name not in sensors]
        names = [*sensors, *more]
        self._rows = model.sensor_matrix(names)
        self._measured = [index for index, name in enumerate(names) if name in measured]
        self._forecast = slice(len(sensors))
        self._z = posterior.z
        variance, directions = np.linalg.eigh(state.covariance)
        kept = variance > _LEAST_STATE_K**2
        self._state_factor = directions[:, kept] * np.sqrt(variance[kept])
        # Not the samples' covariance: round the curved valley of good fits it takes the directions
        # that the data know best for much less known than they are.
        spread = posterior.covariance
        known = np.linalg.inv(spread + 1e-9 * np.eye(len(spread)))
        # Parameters, directions of the present state, a shift of the friction during the step.
        count = len(spread) + self._state_factor.shape[1]
        self._information: FloatArray = np.eye(count + 1)
        self._information[: len(spread), : len(spread)] = known
        path, gradient = self._sensitivities((target,))
        # The sensors, then the difference between the rings.
        self._target = np.zeros((count + 1, len(sensors) + 1))
        self._target[:count, :-1] = gradient[:, -1, self._forecast]
        self._target[:, -1] = ring_difference_k(sensors, self._target[:, :-1])
        end_c = path[-1, self._forecast]
        rise_c = np.where(np.isfinite(end_c), np.maximum(end_c - state.ambient_c, 0.0), 0.0)
        self._load = target.load_n, posterior.trained.load_n_max
        deviation_k = LOAD_DEVIATION * model.errors.scale * rise_c
        self._deviation_k = np.append(deviation_k, np.linalg.norm(deviation_k))
        self._noise_variance_k2 = np.append(np.full(len(sensors), 1.0), 2.0) * _NOISE_VARIANCE_K2
        now_k = self._std_k(self._information, 0.0)
        self.std_k: FloatArray = now_k[:-1]
        self.difference_std_k = float(now_k[-1])

    def after(self, levels: Sequence[Step]) -> Taught:
        """What a step would bring."""
        path, gradient = self._sensitivities(levels)
        heaviest_n = max(level.load_n for level in levels)
        count = len(gradient)
        time_s = self._profile(levels).time_s[1:]
        white = np.zeros((count + 1, time_s.size * len(self._measured)))
        whiten = whitening(time_s, *astuple(self._model.errors))
        shift = self._shift_k(levels, path)
        for number, sensor in enumerate(self._measured):
            span = slice(number * time_s.size, (number + 1) * time_s.size)
            white[:count, span] = whiten.apply(gradient[:, 1:, sensor])
            white[count, span] = whiten.apply(shift[1:, sensor])
        plain = white.copy()
        plain[count] = 0.0
        covariance = np.linalg.inv(self._information[:count, :count])
        variance = np.einsum("kns,kl,lns->ns", gradient, covariance, gradient, optimize=True)
        upper = (path + 1.96 * np.sqrt(variance + _NOISE_VARIANCE_K2))[:, self._forecast]
        std_k = self._std_k(self._information + plain @ plain.T, heaviest_n)
        shifted_std_k = self._std_k(self._information + white @ white.T, heaviest_n)
        return Taught(std_k[:-1], shifted_std_k[:-1], float(shifted_std_k[-1]), np.asarray(upper))

    def _std_k(self, information: FloatArray, heaviest_n: float) -> FloatArray:
        """Standard deviation (sensors + 1,) of the forecast, once a load has been run."""
        variance = np.sum(self._target * np.linalg.solve(information, self._target), axis=0)
        load_n, trained_n = self._load
        beyond = np.log(max(load_n / max(trained_n, heaviest_n), 1.0)) if trained_n > 0.0 else 0.0
        return np.asarray(
            np.sqrt(variance + self._noise_variance_k2 + (beyond * self._deviation_k) ** 2)
        )

    def _profile(self, levels: Sequence[Step]) -> OperatingProfile:
        return held_profile(levels, self._state.ambient_c, self._state.inputs)

    def _sensitivities(self, levels: Sequence[Step]) -> tuple[FloatArray, FloatArray]:
        """Readings (n, sensors), and their derivatives (d, n, sensors); infinite if it runs away.

        A parameter at its bound counts as one that can still move.
        """
        parameters = self._model.parameters
        z = np.clip(self._z, parameters.z_lower, parameters.z_upper)
        profile = self._profile(levels)
        try:
            found = simulate_sensitivities(
                self._model,
                parameters.values_from_z(z),
                profile,
                self._state.temperatures_c,
                self._state.revolutions,
                initial_directions=self._state_factor,
                outputs=self._rows,
            )
        except SimulationError:
            nowhere = np.full((profile.size, len(self._rows)), np.inf)
            return nowhere, np.zeros((z.size + self._state_factor.shape[1], *nowhere.shape))
        by_z = found.by_value * parameters.slopes_by_z(z)
        along = np.concatenate((by_z, found.by_initial), axis=2)
        return found.temperatures_c, np.ascontiguousarray(np.moveaxis(along, 2, 0))

    def _shift_k(self, levels: Sequence[Step], path: FloatArray) -> FloatArray:
        """Change of the readings (n, sensors) by a little more friction throughout the step."""
        values = self._model.parameters.values_from_z(self._z)
        _, _, _, share = kernels.bind_network(self._model.compiled, values)
        first = levels[0]
        _, friction_w = heat_balance_w(
            self._model,
            values,
            self._state.temperatures_c,
            first.speed_rpm,
            first.load_n,
            self._state.ambient_c,
            self._state.revolutions,
        )
        moved = simulate_batch(
            self._model,
            values[None],
            self._profile(levels),
            self._state.temperatures_c[None],
            self._state.revolutions,
            disturbance_w=FRICTION_SHIFT * friction_w * np.asarray(share),
        )[0]
        shift = moved @ self._rows.T - path
        return np.where(np.isfinite(shift), shift, 0.0)


def held_profile(
    levels: Sequence[Step], ambient_c: float, inputs: Sequence[float] = ()
) -> OperatingProfile:
    """Rows of one minute over levels one after the other; ambient and inputs (k,) are held."""
    ends = np.cumsum([level.duration_s for level in levels])
    time_s = np.unique(np.concatenate((np.arange(0.0, ends[-1], 60.0), ends)))
    index = np.minimum(np.searchsorted(ends, time_s, side="right"), len(levels) - 1)
    return OperatingProfile(
        time_s,
        np.array([level.speed_rpm for level in levels])[index],
        np.array([level.load_n for level in levels])[index],
        np.full(time_s.size, ambient_c),
        np.tile(np.array(inputs, np.float64), (time_s.size, 1)),
    )
