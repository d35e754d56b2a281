"""What a worker process of the web side computes; only there the compiled twin is loaded.

The functions name what they need where they need it: the web side itself only hands them on.
"""

import asyncio
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic_core import from_json

from service.bus.questions import Question
from service.documents.machine import PresentMachine
from service.domain.errors import NotReadyError
from service.domain.requests import ProfileStep

if TYPE_CHECKING:
    from service.documents.envelope import EnvelopeDocument
    from service.documents.forecasts import WhatIf
    from service.documents.identification import WindowDocument
    from service.jobs.history import AssetHistory
    from service.live.envelope_keeper import EnvelopeKeeper
    from service.live.estimate import EstimatedState, RunningModel
    from service.site.asset_section import AssetSection
    from service.site.settings import Settings
    from service.store import Store


@dataclass(frozen=True, slots=True)
class WorkerModel:
    """A model version of an asset, its posterior and its simple forecasts as JSON text."""

    asset: str
    version: int
    posterior: bytes
    created_at_us: int
    naive: bytes = b"null"


@dataclass(frozen=True, slots=True)
class Asked:
    """What a question is about: an asset, its model, and the machine as it is now."""

    asset: str
    model: WorkerModel | None = None
    machine: PresentMachine | None = None

    @property
    def section(self) -> "AssetSection":
        """The asset's section with its limits in effect."""
        return _asset(self.asset)

    @property
    def present(self) -> PresentMachine:
        """The machine as it is now."""
        if self.machine is None or self.machine.estimate is None:
            raise NotReadyError("the twin waits for the first good temperatures, speed and load")
        return self.machine

    @property
    def state(self) -> "EstimatedState":
        """Where a forecast begins."""
        from service.live.estimate import EstimatedState

        estimate = self.present.estimate
        if self.model is None or estimate is None:
            raise RuntimeError("the question was asked without the state of the machine")
        return EstimatedState.read(_active(self.model), estimate)


_settings: "Settings | None" = None
# What is kept of each asset, and the revisions or the section that it was made of.
_sections: "dict[str, tuple[tuple[int, int], AssetSection]]" = {}
_models: "dict[str, tuple[AssetSection, RunningModel]]" = {}
_keepers: "dict[str, tuple[AssetSection, EnvelopeKeeper]]" = {}
_histories: "dict[str, tuple[AssetSection, AssetHistory]]" = {}


def prepare(configured: "Settings") -> None:
    """Take the configuration; called once in each worker."""
    from service.jobs.executor import prepare_worker

    global _settings
    _settings = configured
    prepare_worker()


def warm_up() -> None:
    """Load the compiled twin, as far as what-ifs need it."""
    from service.kernels import compile_live_kernels

    compile_live_kernels()


@Question(at_once=True)
def what_if(
    asked: Asked, profile: Sequence[ProfileStep], step_s: float | None, nodes: list[str] | None
) -> "WhatIf":
    """Forecast a profile from the present state of a machine."""
    from service.live.forecasting import what_if_document

    state, limits, missing = asked.state, asked.section.limits, asked.present.missing
    return what_if_document(state, limits, profile, step_s, nodes or None, missing)


@Question()
def envelope(asked: Asked) -> "EnvelopeDocument":
    """Give the safe operating envelope; one that still holds is not computed again."""
    machine = asked.present
    return _envelopes(asked.asset).document(asked.state, machine.planned, machine.measured_c)


@Question(of_store=True)
def windows(asked: Asked) -> "Sequence[WindowDocument]":
    """Find the low-risk windows in the store, with operating points and score."""
    return asyncio.run(_history(asked.asset).window_documents())


def _asset(name: str) -> "AssetSection":
    """Section of an asset with its limits in effect; the same object until one of them changes."""
    from service.site.alarmed_assets import asset_in_effect
    from service.store import StoreUnavailableError

    configured, kept = settings(), store()
    in_file = any(asset.id == name for asset in configured.assets)
    try:
        overlays = kept.alarm_overlays.revision()
        stored = None if in_file else kept.assets.get(name)
    except StoreUnavailableError:
        if name not in _sections:
            raise
        return _sections[name][1]  # while the store is away nothing can change
    if not in_file and (stored is None or stored.table is None):
        raise NotReadyError(f"asset {name!r} was removed")
    revisions = overlays, stored.revision if stored else 0
    known = _sections.get(name)
    if known is None or known[0] != revisions:
        overlay = kept.alarm_overlays.present({name}).get(name, {})
        section = asset_in_effect(configured, name, stored.table if stored else None, overlay)
        if section is None:
            raise NotReadyError(f"asset {name!r} does not fit the configuration")
        if known is not None and known[1] == section:  # of another asset: keep what is computed
            section = known[1]
        known = _sections[name] = revisions, section
    return known[1]


def settings() -> "Settings":
    """The configuration."""
    if _settings is None:
        raise RuntimeError("the worker has no configuration")
    return _settings


@functools.cache
def store() -> "Store":
    """The store, opened once in each worker."""
    from service.store import Store

    configured = settings()
    return Store.open(configured.service.database_url, configured.data_dir)


def _active(model: WorkerModel) -> "RunningModel":
    """The model of a version; the same object as long as the version is the same."""
    from service.jobs.models import naive_of, thermal_model
    from service.live.estimate import RunningModel
    from twin_core.identification.posterior import Posterior

    section = _asset(model.asset)
    known = _models.get(model.asset)
    if known is None or known[0] is not section or known[1].version != model.version:
        posterior = Posterior.from_dict(from_json(model.posterior))
        active = RunningModel(
            model.version,
            thermal_model(section),
            posterior,
            model.created_at_us if posterior.identified else None,
            naive=naive_of({"naive_models": from_json(model.naive)}),
        )
        known = _models[model.asset] = section, active
    return known[1]


def _envelopes(asset: str) -> "EnvelopeKeeper":
    from service.live.envelope_keeper import EnvelopeKeeper

    section = _asset(asset)
    known = _keepers.get(asset)
    if known is None or known[0] is not section:
        known = _keepers[asset] = section, EnvelopeKeeper(section)
    return known[1]


def _history(asset: str) -> "AssetHistory":
    from service.clock import ProcessClock
    from service.jobs.history import AssetHistory

    section = _asset(asset)
    known = _histories.get(asset)
    if known is None or known[0] is not section:
        configured = settings()
        clock = ProcessClock.resume(configured.clock.rate, configured.data_dir)
        known = _histories[asset] = section, AssetHistory(section, store(), clock)
    return known[1]
