"""What a worker computes: a what-if that is kept."""

from collections.abc import Sequence

from service.bus.questions import Question
from service.documents.forecasts import WhatIf
from service.domain.requests import ProfileStep
from service.store.forecast_records import IssuedForecast
from service.web.worker import Asked


@Question(at_once=True, needs_operation="a forecast to keep")
def what_if_to_keep(
    asked: Asked, profile: Sequence[ProfileStep], step_s: float | None, nodes: list[str] | None
) -> tuple[WhatIf, IssuedForecast | None]:
    """Forecast a profile, and give what is kept of the forecast.

    Nothing is where the profile is shorter than the shortest lead time, or without a sensor.
    """
    # Only the worker loads the numerics.
    from service.features.ledger.keeping import issued_forecast
    from service.live.forecasting import issue_what_if

    section = asked.section
    answer, issue = issue_what_if(asked.state, section.limits, profile, step_s, nodes or None)
    region, readings_c = section.low_risk.region, asked.present.measured_c
    return answer, issued_forecast(section.id, issue, "asked", region, section.channels, readings_c)
