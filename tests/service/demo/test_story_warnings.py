"""Which stage of the demo a predicted limit belongs to."""

import numpy as np

from service.clock import rfc3339
from service.demo.score import ScoredForecast, Stage
from service.demo.story import _warning
from service.documents.alarms import AlarmJournalLine
from service.documents.limits import Limits

MINUTE_US = 60_000_000
LIMITS = {"t_inner_ring_c": Limits(warning=70.0, alarm=95.0)}
CALM = Stage("calm", "high", 6200.0, 2650.0, 100 * MINUTE_US, 160 * MINUTE_US)
HEAVY = Stage("heavy", "high", 6200.0, 5500.0, 160 * MINUTE_US, 220 * MINUTE_US)


def forecast(made_min: int) -> ScoredForecast:
    """60 +- 3 degC until minute 160, then 78 +- 5."""
    time_us = np.arange(made_min, 221.0) * MINUTE_US
    heavy = time_us > 160 * MINUTE_US
    median, half = np.where(heavy, 78.0, 60.0), np.where(heavy, 5.0, 3.0)
    quantiles = np.array([median - half, median, median + half])
    return ScoredForecast(made_min * MINUTE_US, 1, time_us, {"t_inner_ring_c": quantiles})


def entry(minute: int, kind: str, to: str) -> AlarmJournalLine:
    return AlarmJournalLine(
        line_class="alarm",
        alarm_id=kind,
        asset="bench-1",
        assets=["bench-1"],
        kind=kind,
        channel="t_inner_ring_c",
        limit_level="warning",
        priority=2,
        time=rfc3339(minute * MINUTE_US),
        event=None,
        from_state=None,
        to_state=to,
        who="service",
        comment=None,
        shelved_until=None,
        value=None,
        unit=None,
        peak=None,
        duration_s=None,
        message="",
    )


JOURNAL = [entry(40, "forecast limit", "UNACK"), entry(175, "measured limit", "UNACK")]


def test_a_prediction_belongs_to_the_stage_in_which_the_band_reaches_the_limit() -> None:
    calm = _warning(CALM, forecast(99), JOURNAL, LIMITS)
    assert calm == {"forecast_limit_at": None, "measured_limit_at": None}
    heavy = _warning(HEAVY, forecast(159), JOURNAL, LIMITS)
    assert heavy == {
        "forecast_limit_at": rfc3339(40 * MINUTE_US),
        "measured_limit_at": rfc3339(175 * MINUTE_US),
    }


def test_a_prediction_that_was_withdrawn_before_the_stage_does_not_count() -> None:
    journal = [*JOURNAL, entry(90, "forecast limit", "RTNUN")]
    assert _warning(HEAVY, forecast(159), journal, LIMITS)["forecast_limit_at"] is None


def test_without_a_forecast_nothing_was_announced() -> None:
    assert _warning(HEAVY, None, JOURNAL, LIMITS)["forecast_limit_at"] is None
