"""Model versions: what is kept of one, and how the live twin takes it up."""

import functools
import json

import structlog

from service.jobs.worker import JobResult
from service.live.estimate import RunningModel
from service.site.asset_section import AssetSection
from service.site.machines.machine import (
    KEPT_MACHINES,
    Machine,
    model_of_parts,
    shared_model,
)
from service.store.records import Job, JsonDocument, ModelVersion
from twin_core.identification.paper_view import paper_view
from twin_core.identification.posterior import Posterior, prior_posterior
from twin_core.models import ThermalModel
from twin_core.naive import NaiveForecasts
from twin_core.sisters import law_documents

_log = structlog.get_logger(__name__)


def machine_of(asset: AssetSection) -> Machine:
    """Return what an asset's model is built of."""
    return Machine(asset.model, asset.bearing, asset.network)


def thermal_model(asset: AssetSection) -> ThermalModel:
    """Give the model that an asset is configured to run; assets of one machine share it."""
    return shared_model(machine_of(asset))


def first_model(asset: AssetSection) -> JsonDocument:
    """Document of the twin before any identification: the priors themselves."""
    return dict(_prior(_parts(asset))[1])


def prior(asset: AssetSection) -> Posterior:
    """What is known of an asset's parameters before any identification."""
    return _prior(_parts(asset))[0]


def _parts(asset: AssetSection) -> str:
    return json.dumps(machine_of(asset).to_dict())


@functools.lru_cache(KEPT_MACHINES)
def _prior(parts: str) -> tuple[Posterior, JsonDocument]:
    model = model_of_parts(parts)
    posterior = prior_posterior(model)
    return posterior, {
        "model": model.name,
        "machine": json.loads(parts),
        "posterior": posterior.to_dict(),
        "parameters": posterior.parameters(model),
        "identifiability": posterior.identifiability_document(model),
        "windows": [],
        "window_records": [],
        "scores": {},
        "naive": {},
        "gates": None,
        "drift": None,
        "sisters": None,
        "job": None,
    }


def identified_document(job: Job, result: JobResult, asset: AssetSection) -> JsonDocument:
    """Document of a model that a job brought."""
    model, posterior = thermal_model(asset), result.posterior
    return {
        "model": model.name,
        "machine": machine_of(asset).to_dict(),
        "posterior": posterior.to_dict(),
        "parameters": posterior.parameters(model),
        "identifiability": posterior.identifiability_document(model),
        "paper_view": paper_view(model, posterior),
        "windows": [
            {
                "start": asked["start"],
                "end": asked["end"],
                "speed_rpm_max": window.speed_rpm_max,
                "load_n_max": window.load_n_max,
            }
            for asked, window in zip(job.request["windows"], result.windows, strict=True)
        ],
        "window_records": [window.to_dict() for window in result.windows],
        "scores": dict(result.gates.scores),
        "naive": dict(result.gates.naive),
        "naive_models": result.naive.to_dict(),
        "gates": result.gates.to_dict(),
        "drift": result.drift.model_dump(),
        "sisters": _sisters(model, result),
        "laws": law_documents(model, posterior, result.sisters),
        "own": None if result.own is None else result.own.to_dict(),
        "job": job.id,
        "method": job.request["method"],
        "seed": job.request["seed"],
        "active_fitness": result.active_fitness,
        "convergence": result.convergence,
    }


def _sisters(model: ThermalModel, result: JobResult) -> JsonDocument | None:
    """What became of the sisters, and what each parameter is without them."""
    if result.sisters is None:
        return None
    own = result.own
    parameters = {} if own is None else own.parameters(model)
    return result.sisters.to_dict() | {
        "without_them": {
            name: {key: row[key] for key in ("value", "low", "high")}
            for name, row in parameters.items()
        },
    }


def active_model(asset: AssetSection, version: ModelVersion) -> RunningModel:
    """What the live twin needs of a stored version."""
    prior, document = _prior(_parts(asset))
    stored = version.document["posterior"]
    posterior = prior if stored == document["posterior"] else Posterior.from_dict(stored)
    return RunningModel(
        version=version.version,
        model=thermal_model(asset),
        posterior=posterior,
        identified_at_us=version.created_at_us if posterior.identified else None,
        drifted=bool((version.document.get("drift") or {}).get("changed")),
        naive=naive_of(version.document),
    )


def naive_of(document: JsonDocument) -> NaiveForecasts | None:
    """Simple forecasts of a stored version; None where none are kept, as of the priors.

    Earlier releases kept none. What cannot be read takes nothing from the version itself.
    """
    stored = document.get("naive_models")
    if stored is None:
        return None
    try:
        return NaiveForecasts.from_dict(stored)
    except ValueError as error:
        _log.warning("naive_forecasts_not_read", reason=str(error))
        return None


def why_not_of_this_asset(asset: AssetSection, version: ModelVersion) -> str | None:
    """Say why a stored version cannot run the asset as it is configured now; None when it can.

    The bearing, the network or the model may have been changed in the configuration, or the model
    may have got other parameters with a newer version of this software.
    """
    try:
        posterior = Posterior.from_dict(version.document["posterior"])
        posterior.check(thermal_model(asset))
        machine = machine_of(asset)
        # Versions of older releases carry no machine: they had no bearings but the catalogue's.
        built = version.document.get("machine", machine.to_dict())
        if built != machine.to_dict():
            return f"the dimensions or the network of {machine.name!r} have been changed since"
    except (KeyError, TypeError, ValueError) as error:
        return f"{error}" if isinstance(error, ValueError) else f"not readable ({error!r})"
    return None
