"""How the forecasts of an asset have done so far, as it stands with a predicted alarm."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from service.features.ledger.documents import Risk, forecast_performance
from service.store.forecast_records import StoredForecast
from twin_core.verification import LEAD_TIMES_S

#: A record is of the forecasts of so many days.
RECORD_DAYS: Final = 30.0

Kind = tuple[str, int, Risk]
"""Channel, lead time in s and risk."""


@dataclass(frozen=True, slots=True)
class Record:
    """Readings that are scored, or interrupted and scored at the last minute that was followed."""

    inside: int
    count: int
    independent_runs: int

    def text(self, lead_s: int, risk: Risk) -> str:
        """Say it in a line: record 1 h ahead, high risk: 31 of 32 inside (4 independent runs)."""
        runs = f"{self.independent_runs} independent run{'s' * (self.independent_runs != 1)}"
        return (
            f"record {_lead_text(lead_s)} ahead, {risk} risk: {self.inside} of {self.count} inside "
            f"({runs})"
        )


def records_of(stored: Sequence[StoredForecast]) -> Mapping[Kind, Record]:
    """Count kept forecasts, labels and model versions together."""
    inside: Counter[Kind] = Counter()
    count: Counter[Kind] = Counter()
    runs: Counter[Kind] = Counter()
    for one in forecast_performance(stored).items:
        kind = one.channel, one.lead_time_s, one.risk
        inside[kind] += round(one.n * (one.coverage_95 or 0.0)) + one.left_inside_95
        count[kind] += one.n + one.left
        runs[kind] += one.independent_runs
    return {kind: Record(inside[kind], count[kind], runs[kind]) for kind in count if count[kind]}


def nearest_leads_s(lead_time_s: float | None) -> list[int]:
    """Lead times of the ledger, the nearest by ratio first; to an hour where it is unknown."""
    asked_s = 3600.0 if lead_time_s is None else max(lead_time_s, 1.0)
    return sorted(LEAD_TIMES_S, key=lambda one: abs(math.log(one / asked_s)))


def _lead_text(lead_s: int) -> str:
    return f"{lead_s // 3600} h" if lead_s >= 3600 else f"{lead_s // 60} min"
