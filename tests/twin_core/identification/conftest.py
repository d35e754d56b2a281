"""Synthetic data from the model itself: they test the algorithms, not how true the model is."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.models import ThermalModel
from twin_core.simulation import OperatingProfile, simulate
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]
Stage = tuple[int, float, float]

LOW_RISK: tuple[Stage, ...] = (
    (3, 0.0, 2650.0),
    (40, 1500.0, 2650.0),
    (40, 4200.0, 2650.0),
    (40, 4200.0, 3300.0),
)


@pytest.fixture(scope="session")
def true_z(model: ThermalModel) -> FloatArray:
    """A machine well off the prior's centre, with more friction."""
    z = np.random.default_rng(11).normal(0.0, 0.7, model.parameters.size)
    z[model.parameters.index("M0")] = 1.0
    return np.asarray(z)


Synthesise = Callable[..., MinuteData]


@pytest.fixture(scope="session")
def synthesise(model: ThermalModel) -> Synthesise:
    """Rows of a simulated machine; noise-free unless told otherwise."""

    def make(
        z: FloatArray,
        stages: Sequence[Stage] = LOW_RISK,
        *,
        noise_k: float = 0.0,
        initial_c: FloatArray | None = None,
        seed: int = 0,
    ) -> MinuteData:
        speed = np.concatenate([np.full(count, rpm) for count, rpm, _ in stages])
        load = np.concatenate([np.full(count, newton) for count, _, newton in stages])
        time_s = 60.0 * np.arange(speed.size, dtype=np.float64)
        ambient = np.full(speed.size, 22.0)
        start = np.full(13, 22.0) if initial_c is None else initial_c
        path = simulate(
            model,
            model.parameters.values_from_z(z),
            OperatingProfile(time_s, speed, load, ambient),
            start,
        )
        rng = np.random.default_rng(seed)
        return MinuteData(
            time_s,
            speed,
            load,
            ambient,
            {
                name: path.temperatures_c @ model.sensor_row(name)
                + noise_k * rng.standard_normal(speed.size)
                for name in model.sensor_names
            },
            np.ones(speed.size, dtype=np.bool_),
        )

    return make


@pytest.fixture(scope="session")
def cold_start(synthesise: Synthesise, true_z: FloatArray) -> IdentificationData:
    """Two hours from rest with two speeds and two loads, 0.1 K noise."""
    minutes = synthesise(true_z, noise_k=0.1)
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))
