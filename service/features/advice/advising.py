"""Excitation advice for a running machine."""

from collections.abc import Sequence

from service.clock import rfc3339
from service.domain.errors import NotIdentifiedError
from service.features.advice.documents import AdviceDocument, advice_document
from service.live.estimate import EstimatedState
from service.site.asset_section import AssetSection
from twin_core.forecasting.advice import NothingIdentifiedError, advise
from twin_core.profiles import Step


def give_advice(
    settings: AssetSection,
    state: EstimatedState,
    measured: Sequence[str],
    target: Step,
    half_width_k: float | None = None,
) -> AdviceDocument:
    """Rank low-risk steps by what they would teach about a point, and name the next.

    `settings`: low-risk region and limits; `state`: the machine at this moment; `measured`: its
    channels; `target`: the point to be learned about; `half_width_k`: how narrow its forecast is to
    become. Raises `NotIdentifiedError` while the active model is not identified.
    """
    active = state.active
    sensors = active.model.sensor_names
    limits = {name: pair for name, pair in settings.limits.items() if name in sensors}
    region = settings.low_risk.region
    try:
        advice = advise(
            active.model,
            active.posterior,
            state.machine,
            target,
            region,
            {name: pair.warning for name, pair in limits.items()},
            alarm_limits={name: pair.alarm for name, pair in limits.items()},
            measured=measured,
            half_width_k=half_width_k,
        )
    except NothingIdentifiedError as error:
        raise NotIdentifiedError(str(error)) from error
    return advice_document(
        advice, region, made_at=rfc3339(state.time_us), model_version=active.version
    )
