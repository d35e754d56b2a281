"""Identification of many machines in batches: what goes to a worker, and what comes back.

A batch is bytes, there and back: the same for a process of this machine and for a worker of a
cluster. So arrays arrive as the worker's own; others would make the kernels compile again.
"""

import pickle
import platform
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Final

import numba

from service import __version__
from service.domain.errors import ServiceError
from service.jobs.comparison import EarlierVersion
from service.jobs.relatives import NO_RELATIVES, Relatives
from service.jobs.worker import JobResult, assessed, fitness_of
from service.site.machines.machine import Machine, shared_model
from twin_core.identification.data import IdentificationData
from twin_core.identification.identify import FitSettings, Method, identify
from twin_core.identification.posterior import Posterior

#: What the bits of a result depend on.
_SOFTWARE = ("llvmlite", "numba", "numpy", "scipy")

_FULL: Final[Method] = "noa+refine"


class OtherSoftwareError(ServiceError):
    """A worker has other versions of what the results depend on."""


@dataclass(frozen=True, slots=True, eq=False)
class MachineOrder:
    """One machine to identify; no worker ever sees the store.

    Attributes
    ----------
    asset : str
        Whose machine it is.
    machine : Machine
        What the model is built of.
    data : IdentificationData
        Low-risk windows.
    active : Posterior
        Of the active version. The search begins there if it was identified from data.
    earlier : sequence of EarlierVersion
        Versions that the result is compared with, oldest first.
    seed : int
        Same seed, same result.
    relatives : Relatives
        The other machines of its family.
    """

    asset: str
    machine: Machine
    data: IdentificationData
    active: Posterior
    earlier: Sequence[EarlierVersion]
    seed: int = 0
    relatives: Relatives = NO_RELATIVES


@dataclass(frozen=True, slots=True, eq=False)
class MachineResult:
    """What came of one machine.

    Attributes
    ----------
    asset : str
        Whose machine it is.
    found : JobResult or None
        None where the computation failed.
    error : str
        Why it failed.
    method : str
        ``"refine"`` after a warm start, ``"noa+refine"`` after a full search.
    seconds, processor_seconds : float
        What it took in the worker.
    """

    asset: str
    found: JobResult | None
    error: str
    method: Method
    seconds: float
    processor_seconds: float


def packed_orders(orders: Sequence[MachineOrder]) -> bytes:
    """Pack a batch for `run_batch`."""
    return pickle.dumps((_software(), list(orders)), protocol=pickle.HIGHEST_PROTOCOL)


def unpacked_results(content: bytes) -> list[MachineResult]:
    """Unpack what `run_batch` gave; only of a worker that one trusts with one's own code."""
    results: list[MachineResult] = pickle.loads(content)
    return results


def run_batch(content: bytes) -> bytes:
    """Identify the machines of a batch one after the other, on one core.

    Parameters
    ----------
    content : bytes
        From `packed_orders`.

    Returns
    -------
    bytes
        For `unpacked_results`.

    Raises
    ------
    OtherSoftwareError
        If the sender has other versions than this worker.
    """
    theirs, orders = pickle.loads(content)
    ours = _software()
    if ours != theirs:
        other = ", ".join(f"{name} {ours[name]}" for name in ours if ours[name] != theirs[name])
        expected = ", ".join(
            f"{name} {theirs[name]}" for name in ours if ours[name] != theirs[name]
        )
        raise OtherSoftwareError(f"worker {platform.node()}: has {other}; expected {expected}")
    # As many workers as cores: what more threads took would be another worker's.
    numba.set_num_threads(1)
    results = [_result(order) for order in orders]
    return pickle.dumps(results, protocol=pickle.HIGHEST_PROTOCOL)


def identify_machine(order: MachineOrder) -> tuple[JobResult, Method]:
    """Identify one machine: from the active version, if the gates accept what comes of that.

    Otherwise, and for a machine that has never been identified, with a full search.
    """
    model = shared_model(order.machine)
    active_fitness = fitness_of(model, order.data, order.active)
    if order.active.identified:
        try:
            fit = identify(
                model,
                order.data,
                FitSettings(method="refine", seed=order.seed),
                guess_z=order.active.z,
                warm=True,
            )
        except ValueError:  # the simulation fails there: the machine is another one by now
            pass
        else:
            found = assessed(
                model,
                order.data,
                fit,
                bearing=order.machine.bearing,
                active=order.active,
                active_fitness=active_fitness,
                earlier=order.earlier,
                relatives=order.relatives,
                seed=order.seed,
            )
            if found.gates.accepted:
                return found, "refine"
    fit = identify(model, order.data, FitSettings(method=_FULL, seed=order.seed))
    found = assessed(
        model,
        order.data,
        fit,
        bearing=order.machine.bearing,
        active=order.active,
        active_fitness=active_fitness,
        earlier=order.earlier,
        relatives=order.relatives,
        seed=order.seed,
    )
    return found, _FULL


def _result(order: MachineOrder) -> MachineResult:
    began_s, processor_s = time.perf_counter(), time.process_time()
    found: JobResult | None = None
    error, method = "", _FULL
    try:
        found, method = identify_machine(order)
    except Exception as failure:
        # A machine that fails is no reason to leave the others.
        error = f"{type(failure).__name__}: {failure}"
    return MachineResult(
        order.asset,
        found,
        error,
        method,
        time.perf_counter() - began_s,
        time.process_time() - processor_s,
    )


def _software() -> dict[str, str]:
    return {"Python": platform.python_version(), "bearing-twin": __version__} | {
        name: version(name) for name in _SOFTWARE
    }
