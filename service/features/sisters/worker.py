"""What a worker computes of a machine for its sisters."""

from dataclasses import dataclass

from service.jobs.worker import is_stopped
from service.jobs.workspace import JobFolder
from service.site.machines.machine import Machine
from twin_core.identification.data import IdentificationData
from twin_core.identification.identify import FitSettings, identify
from twin_core.identification.posterior import Posterior
from twin_core.identification.refinement import IdentificationCancelled


@dataclass(frozen=True, slots=True)
class TeachingOrder:
    """A machine that is identified from all that it has run, for its sisters.

    Attributes
    ----------
    folder, machine, seed
        As of `service.jobs.worker.JobOrder`.
    data : IdentificationData
        Windows at any speed and load.
    """

    folder: JobFolder
    machine: Machine
    data: IdentificationData
    seed: int = 0


def run_teaching(order: TeachingOrder) -> Posterior | str | None:
    """Identify a machine from all that it has run.

    Returns
    -------
    Posterior, str or None
        What it teaches its sisters; why it teaches nothing; None when the work was cancelled.
    """
    try:
        fit = identify(
            order.machine.build(),
            order.data,
            FitSettings(method="noa+refine", seed=order.seed),
            cancelled=lambda: is_stopped(order.folder),
        )
    except IdentificationCancelled:
        return None
    except ValueError as error:
        return str(error)
    return fit.posterior if fit.status == "converged" else fit.reason
