"""What a worker process of the web side computes; only there the compiled twin is loaded.

The functions name what they need where they need it: the web side itself only hands them on.
"""

import asyncio
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic_core import from_json

from service.documents.machine import PresentMachine
from service.domain.errors import NotReadyError
from service.domain.requests import ProfileStep

if TYPE_CHECKING:
    from service.documents.advice import AdviceDocument
    from service.documents.envelope import EnvelopeDocument
    from service.documents.forecasts import WhatIf
    from service.documents.identification import WindowDocument
    from service.jobs.history import AssetHistory
    from service.live.envelope import EnvelopeKeeper
    from service.live.estimate import ActiveModel, EstimatedState
    from service.site.settings import AssetSection, Settings


@dataclass(frozen=True, slots=True)
class Model:
    """A model version of an asset, its posterior as JSON text."""

    asset: str
    version: int
    posterior: bytes
    created_at_us: int


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
    machine: PresentMachine,
    profile: Sequence[ProfileStep],
    step_s: float | None,
    nodes: Sequence[str] | None,
) -> "WhatIf":
    """Forecast a profile from the state of a machine."""
    from service.live.forecasting import what_if_document

    limits = _asset(model.asset).limits
    return what_if_document(_state(model, machine), limits, profile, step_s, nodes, machine.missing)


def envelope(model: Model, machine: PresentMachine) -> "EnvelopeDocument":
    """Give the safe operating envelope; one that still holds is not computed again."""
    kept = _envelopes(model.asset)
    return kept.document(_state(model, machine), machine.planned, machine.measured_c)


def advice(
    model: Model, machine: PresentMachine, target: tuple[float, float, float]
) -> "AdviceDocument":
    """Rank low-risk steps by what they teach about a point."""
    from service.live.advice import give_advice
    from twin_core.forecasting.design import Level

    settings = _asset(model.asset)
    state = _state(model, machine)
    return give_advice(settings, state, list(settings.channels), Level(*target))


def windows(asset: str) -> "Sequence[WindowDocument]":
    """Find the low-risk windows in the store."""
    return asyncio.run(_history(asset).window_documents())


def _asset(name: str) -> "AssetSection":
    if _settings is None:
        raise RuntimeError("the worker has no configuration")
    return next(asset for asset in _settings.assets if asset.id == name)


def _state(model: Model, machine: PresentMachine) -> "EstimatedState":
    from service.live.estimate import EstimatedState

    if machine.estimate is None:
        raise NotReadyError("the twin waits for the first good temperatures, speed and load")
    return EstimatedState.read(_active(model), machine.estimate)


_models: dict[str, "ActiveModel"] = {}


def _active(model: Model) -> "ActiveModel":
    """The model of a version; the same object as long as the version is the same."""
    from service.jobs.models import thermal_model
    from service.live.estimate import ActiveModel
    from twin_core.identification.posterior import Posterior

    asset = model.asset
    known = _models.get(asset)
    if known is None or known.version != model.version:
        posterior = Posterior.from_dict(from_json(model.posterior))
        known = _models[asset] = ActiveModel(
            model.version,
            thermal_model(_asset(asset)),
            posterior,
            model.created_at_us if posterior.identified else None,
        )
    return known


@functools.cache
def _envelopes(asset: str) -> "EnvelopeKeeper":
    from service.live.envelope import EnvelopeKeeper

    return EnvelopeKeeper(_asset(asset))


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
