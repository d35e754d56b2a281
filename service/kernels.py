"""The twin's compiled kernels, made ready before process time counts."""

from collections.abc import Callable

import numpy as np
from numba.core import event

from twin_core.bearings import bearing
from twin_core.forecasting import forecast
from twin_core.forecasting.envelope import envelope
from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import prior_posterior
from twin_core.initial_state import initial_state
from twin_core.machine_state import MachineState
from twin_core.models import ThermalModel, build_model
from twin_core.observer import Observer
from twin_core.simulation import OperatingProfile, simulate
from twin_core.windows import MinuteData


def compile_kernels() -> None:
    """Run every kernel once; takes about a minute on the first run, half a second afterwards."""
    model, profile, state = compile_live_kernels()
    posterior = prior_posterior(model)
    limits = dict.fromkeys(model.sensor_names, (90.0,))
    envelope(model, posterior, state, [1500.0], [2650.0], limits, members=2)
    values = model.parameters.values_from_z(posterior.z)
    nodes_c = simulate(model, values, profile, np.full(13, 22.0)).temperatures_c
    minutes = MinuteData(
        profile.time_s,
        profile.speed_rpm,
        profile.load_n,
        profile.ambient_c,
        {name: nodes_c @ model.sensor_row(name) for name in model.sensor_names},
        np.ones(profile.size, dtype=np.bool_),
    )
    data = IdentificationData((IdentificationWindow(minutes, at_rest=True),))
    identify(model, data, FitSettings(budget=50))


class _Compiling(event.Listener):  # type: ignore[misc]
    """Is called whenever numba begins to compile a function."""

    def __init__(self, begins: Callable[[], None]) -> None:
        self._begins = begins

    def on_start(self, _: event.Event) -> None:
        self._begins()

    def on_end(self, _: event.Event) -> None: ...


class _NotCompiledError(Exception):
    """A kernel is not in the cache."""


def load_live_kernels() -> bool:
    """Load the kernels of the live twin; False where one must be compiled first."""

    def refuse() -> None:
        raise _NotCompiledError

    try:
        compile_live_kernels(refuse)
    except _NotCompiledError:
        return False
    return True


def compile_live_kernels(
    begins: Callable[[], None] = lambda: None,
) -> tuple[ThermalModel, OperatingProfile, MachineState]:
    """Run the kernels of the live twin once: observer and forecast.

    Compiling must not happen later, in the middle of polling. What maps and identification need
    more is compiled in processes of their own.

    Parameters
    ----------
    begins : callable
        Called whenever a function begins to be compiled, so not for those in the cache.

    Returns
    -------
    model, profile, state
        What they ran on.
    """
    with event.install_listener("numba:compile", _Compiling(begins)):
        return _run_live_kernels()


def _run_live_kernels() -> tuple[ThermalModel, OperatingProfile, MachineState]:
    model = build_model("default", bearing=bearing("6311"))
    posterior = prior_posterior(model)
    values = model.parameters.values_from_z(posterior.z)
    time_s = np.arange(0.0, 2400.0, 60.0)
    speed_rpm, load_n = np.where(time_s < 300.0, 0.0, 1500.0), np.full(time_s.size, 2650.0)
    profile = OperatingProfile(time_s, speed_rpm, load_n, np.full(time_s.size, 22.0))
    simulate(model, values, profile, np.full(13, 22.0))
    observer = Observer(
        model, values, *initial_state(model, values, {"t_inner_ring_c": 22.0}, 22.0, 0.0, 0.0, True)
    )
    observer.predict(5.0, 1500.0, 2650.0, 22.0)
    observer.update({"t_inner_ring_c": 22.1})
    state = observer.state()
    forecast(model, posterior, state, profile, members=4)
    return model, profile, state
