"""Live forecasts as they are issued, for what follows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from adapters.samples import PlannedProfile
from service.live.estimate import EstimatedState
from service.live.profiles import StepAhead
from twin_core.forecasting import Forecast


@dataclass(frozen=True, slots=True)
class LiveIssue:
    """A forecast as it was issued, with all that it stands on.

    - ``state``: where it begins.
    - ``steps``: what it assumes.
    - ``plan``: the controller's, where it follows that.
    """

    state: EstimatedState
    steps: Sequence[StepAhead]
    result: Forecast
    plan: PlannedProfile | None


class ForecastFollower(Protocol):
    """Follows the live forecasts of one asset; see `AssetRuntime.follow_forecasts`.

    - ``name``: of what it knows in the kept state of the asset.
    """

    @property
    def name(self) -> str:
        """Of what it knows."""

    def issued(self, issue: LiveIssue) -> None:
        """Note a forecast of a known operation; what is raised is logged and ends nothing."""

    def record(self, channel: str, lead_time_s: float | None) -> str:
        """Say how such forecasts have done so far, in a few words; empty where that is unknown."""

    def to_dict(self) -> Any:
        """Return what the next start must know, as plain JSON types; None where nothing."""

    def restore(self, kept: Any) -> None:
        """Take up what `to_dict` gave, also of another release; what does not fit is left out."""
