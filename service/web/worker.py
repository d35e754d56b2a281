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
    from service.reports.files import ReportFormat
    from service.site.asset_section import AssetSection
    from service.site.settings import Settings
    from service.store import Run, Store
    from service.store.forecast_records import IssuedForecast


@dataclass(frozen=True, slots=True)
class Model:
    """A model version of an asset, its posterior and its simple forecasts as JSON text."""

    asset: str
    version: int
    posterior: bytes
    created_at_us: int
    naive: bytes = b"null"


_settings: "Settings | None" = None
# What is kept of each asset, and the revisions or the section that it was made of.
_sections: "dict[str, tuple[tuple[int, int], AssetSection]]" = {}
_models: "dict[str, tuple[AssetSection, ActiveModel]]" = {}
_keepers: "dict[str, tuple[AssetSection, EnvelopeKeeper]]" = {}
_histories: "dict[str, tuple[AssetSection, AssetHistory]]" = {}


def prepare(settings: "Settings") -> None:
    """Take the configuration; called once in each worker."""
    from service.jobs.executor import prepare_worker

    global _settings
    _settings = settings
    prepare_worker()


def warm_up() -> None:
    """Load the compiled twin, as far as what-ifs need it."""
    from service.kernels import compile_live_kernels

    compile_live_kernels()


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


def what_if_to_keep(
    model: Model,
    machine: PresentMachine,
    profile: Sequence[ProfileStep],
    step_s: float | None,
    nodes: Sequence[str] | None,
) -> "tuple[WhatIf, IssuedForecast | None]":
    """Forecast a profile, and give what is kept of the forecast."""
    from service.live.forecasting import what_if_to_keep

    section, state = _asset(model.asset), _state(model, machine)
    return what_if_to_keep(section, state, profile, step_s, nodes, machine.measured_c)


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


def report(asset: str, run: "Run", format: "ReportFormat", now_us: int) -> bytes:
    """Make the report of a run."""
    from service.reports.files import report_file
    from service.reports.run_limits import asset_of_run

    section = asset_of_run(_prepared(), _store(), run)
    if section is None:
        raise NotReadyError(f"asset {asset!r} was removed, or does not fit the configuration")
    return report_file(_store(), section, run, format, now_us)


def _asset(name: str) -> "AssetSection":
    """Section of an asset with its limits in effect; the same object until one of them changes."""
    from service.site.alarmed_assets import asset_in_effect
    from service.store import StoreUnavailableError

    settings, store = _prepared(), _store()
    in_file = any(asset.id == name for asset in settings.assets)
    try:
        overlays = store.alarm_settings.revision()
        stored = None if in_file else store.assets.get(name)
    except StoreUnavailableError:
        if name not in _sections:
            raise
        return _sections[name][1]  # while the store is away nobody changes anything
    if not in_file and (stored is None or stored.table is None):
        raise NotReadyError(f"asset {name!r} was removed")
    revisions = overlays, stored.revision if stored else 0
    known = _sections.get(name)
    if known is None or known[0] != revisions:
        overlay = store.alarm_settings.present({name}).get(name, {})
        section = asset_in_effect(settings, name, stored.table if stored else None, overlay)
        if section is None:
            raise NotReadyError(f"asset {name!r} does not fit the configuration")
        if known is not None and known[1] == section:  # of another asset: keep what is computed
            section = known[1]
        known = _sections[name] = revisions, section
    return known[1]


def _prepared() -> "Settings":
    if _settings is None:
        raise RuntimeError("the worker has no configuration")
    return _settings


@functools.cache
def _store() -> "Store":
    from service.store import Store

    settings = _prepared()
    return Store.open(settings.service.database_url, settings.data_dir)


def _state(model: Model, machine: PresentMachine) -> "EstimatedState":
    from service.live.estimate import EstimatedState

    if machine.estimate is None:
        raise NotReadyError("the twin waits for the first good temperatures, speed and load")
    return EstimatedState.read(_active(model), machine.estimate)


def _active(model: Model) -> "ActiveModel":
    """The model of a version; the same object as long as the version is the same."""
    from service.jobs.models import naive_of, thermal_model
    from service.live.estimate import ActiveModel
    from twin_core.identification.posterior import Posterior

    section = _asset(model.asset)
    known = _models.get(model.asset)
    if known is None or known[0] is not section or known[1].version != model.version:
        posterior = Posterior.from_dict(from_json(model.posterior))
        active = ActiveModel(
            model.version,
            thermal_model(section),
            posterior,
            model.created_at_us if posterior.identified else None,
            naive=naive_of({"naive_models": from_json(model.naive)}),
        )
        known = _models[model.asset] = section, active
    return known[1]


def _envelopes(asset: str) -> "EnvelopeKeeper":
    from service.live.envelope import EnvelopeKeeper

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
        settings = _prepared()
        clock = ProcessClock.resume(settings.clock.rate, settings.data_dir)
        known = _histories[asset] = section, AssetHistory(section, _store(), clock)
    return known[1]
