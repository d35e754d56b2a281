"""What a worker process of the web side computes; only there the compiled twin is loaded.

The functions name what they need where they need it: the web side itself only hands them on.
"""

import asyncio
import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic_core import from_json

from service.domain.requests import ProfileStep

if TYPE_CHECKING:
    from service.documents.advice import AdviceDocument
    from service.documents.envelope import EnvelopeDocument
    from service.documents.forecasts import WhatIf
    from service.documents.identification import WindowDocument
    from service.jobs.history import AssetHistory
    from service.live.estimate import ActiveModel, EstimatedState
    from service.live.planning import Planning
    from service.site.settings import AssetSection, Settings

Model = Mapping[str, Any]
"""A model version: asset, version, posterior as JSON text, and when it was stored."""

_settings: "Settings | None" = None


def prepare(settings: "Settings") -> None:
    """Take the configuration; called once in each worker."""
    from service.jobs.executor import prepare_worker

    global _settings
    _settings = settings
    prepare_worker()


def warm_up() -> None:
    """Load the compiled twin."""
    from service.kernels import compile_kernels

    compile_kernels()


def what_if(
    model: Model,
    machine: Mapping[str, Any],
    profile: Sequence[Mapping[str, Any]],
    step_s: float | None,
    nodes: Sequence[str] | None,
) -> "WhatIf":
    """Forecast a profile from the state of a machine."""
    from service.live.forecasting import what_if_document

    steps = [ProfileStep.model_construct(**step) for step in profile]
    state = _state(model, machine)
    limits = _asset(model["asset"]).limits
    return what_if_document(state, limits, steps, step_s, nodes, machine["missing"])


def envelope(model: Model, machine: Mapping[str, Any]) -> "EnvelopeDocument":
    """Give the safe operating envelope; one that still holds is not computed again."""
    planning, present = _planning(model["asset"])
    present[:] = [_state(model, machine)]
    planned = [tuple(one) for one in machine["planned"]]
    return asyncio.run(planning.envelope(planned, machine["measured_c"]))


def advice(
    model: Model, machine: Mapping[str, Any], target: tuple[float, float, float]
) -> "AdviceDocument":
    """Rank low-risk steps by what they teach about a point."""
    from twin_core.forecasting.design import Level

    planning, present = _planning(model["asset"])
    present[:] = [_state(model, machine)]
    return asyncio.run(planning.advice(Level(*target)))


def windows(asset: str) -> "Sequence[WindowDocument]":
    """Find the low-risk windows in the store."""
    return asyncio.run(_history(asset).window_documents())


def _asset(name: str) -> "AssetSection":
    if _settings is None:
        raise RuntimeError("the worker has no configuration")
    return next(asset for asset in _settings.assets if asset.id == name)


def _state(model: Model, machine: Mapping[str, Any]) -> "EstimatedState":
    from service.live.estimate import EstimatedState

    return EstimatedState.from_dict(_active(model), machine["estimate"])


_models: dict[str, "ActiveModel"] = {}


def _active(model: Model) -> "ActiveModel":
    """The model of a version; the same object as long as the version is the same."""
    from service.jobs.models import thermal_model
    from service.live.estimate import ActiveModel
    from twin_core.identification.posterior import Posterior

    asset = model["asset"]
    known = _models.get(asset)
    if known is None or known.version != model["version"]:
        posterior = Posterior.from_dict(from_json(model["posterior"]))
        known = _models[asset] = ActiveModel(
            model["version"],
            thermal_model(_asset(asset)),
            posterior,
            model["created_at_us"] if posterior.identified else None,
        )
    return known


@functools.cache
def _planning(asset: str) -> "tuple[Planning, list[EstimatedState]]":
    """What plans on an asset, and the place of the state that it begins from."""
    from service.live.planning import Planning

    settings = _asset(asset)
    present: list[EstimatedState] = []
    return Planning(settings, lambda: present[0], list(settings.channels)), present


@functools.cache
def _history(asset: str) -> "AssetHistory":
    from service.clock import ProcessClock
    from service.jobs.history import AssetHistory
    from service.store import Store

    settings = _settings
    if settings is None:
        raise RuntimeError("the worker has no configuration")
    store = Store.open(settings.service.database_url, settings.data_dir)
    clock = ProcessClock.resume(settings.clock.rate, settings.data_dir)
    return AssetHistory(_asset(asset), store, clock)
