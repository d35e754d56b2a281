"""Excitation advice for a running machine."""

from collections.abc import Sequence

from service.clock import rfc3339
from service.documents.advice import AdviceDocument, advice_document
from service.live.estimate import EstimatedState
from service.site.settings import AssetSection
from twin_core.forecasting.advice import advise
from twin_core.forecasting.design import Level


def give_advice(
    settings: AssetSection, state: EstimatedState, measured: Sequence[str], target: Level
) -> AdviceDocument:
    """Compute the advice; takes some tenths of a second, so not in the event loop.

    Parameters
    ----------
    settings : AssetSection
        Low-risk region and limits.
    state : EstimatedState
        The machine at this moment.
    measured : sequence of str
        Its channels.
    target : Level
        The point to be learned about.

    Raises
    ------
    NothingIdentifiedError
        Before the first identification.
    """
    active = state.active
    sensors = active.model.sensor_names
    limits = {name: pair for name, pair in settings.limits.items() if name in sensors}
    region = settings.low_risk.region
    advice = advise(
        active.model,
        active.posterior,
        state.machine,
        target,
        region,
        {name: pair.warning for name, pair in limits.items()},
        alarm_limits={name: pair.alarm for name, pair in limits.items()},
        measured=measured,
    )
    return advice_document(
        advice, region, made_at=rfc3339(state.time_us), model_version=active.version
    )
