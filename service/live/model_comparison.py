"""Compares one machine with its model: the model alone, and what the observer did not expect."""

from collections.abc import Callable, Mapping

from service.live.estimate import LiveEstimate
from service.live.kept import KeptWatch
from service.live.reference import Reference
from service.live.residuals import Residuals
from twin_core.models import ThermalModel
from twin_core.windows import MEASURED_TOLERANCE, LowRiskRegion


class ModelComparison:
    """What the model alone expects, and the sequential tests of the observer's innovations.

    - ``temperatures``: the measured ones.
    - ``residuals``: the tests; they run while the machine does.
    """

    def __init__(
        self, estimate: LiveEstimate, temperatures: tuple[str, ...], residuals: Residuals
    ) -> None:
        self.temperatures = temperatures
        self.residuals = residuals
        self._estimate = estimate
        self._reference = Reference()
        self._version = estimate.active.version
        self._model: ThermalModel | None = None
        self._known: tuple[str, ...] = ()
        self._stepped_us: int | None = None
        # Of the present step: how long it is and whether it lies in the low-risk region, or what
        # failed; None where there is no estimate.
        self._followed: tuple[float, bool] | Exception | None = None
        self._comparable = False

    def follow(self, now_us: int, region: LowRiskRegion) -> Reference | None:
        """Let the model alone go on before a `step`; gives it where it must be advanced.

        Its `advance_together` comes before the step. What fails is raised by the step.
        """
        try:
            return self._reference if self._goes_on(now_us, region) else None
        except Exception as error:
            self._followed = error
            return None

    def _goes_on(self, now_us: int, region: LowRiskRegion) -> bool:
        estimate, since_us = self._estimate, self._stepped_us
        self._stepped_us = now_us
        self._followed = None
        point = estimate.point
        if not estimate.started or point is None:
            self._reference.stop()
            return False
        if estimate.active.version != self._version:
            self._version = estimate.active.version
            self.residuals.restart()
            self._reference.stop()
        is_low_risk = bool(region.contains(point.speed_rpm, point.load_n, MEASURED_TOLERANCE))
        duration_s = 0.0 if since_us is None else max(now_us - since_us, 0) / 1e6
        self._followed = duration_s, is_low_risk
        # Outside the region of its data the model alone is no judge; it starts again inside.
        if is_low_risk and self._reference.started:
            return self._reference.hold(estimate.active, duration_s, point)
        self._reference.start(estimate.observer)
        return False

    def step(self, turns: bool) -> None:
        """Test what the observer did not expect of a step; ``turns``: the machine does."""
        if isinstance(self._followed, Exception):
            raise self._followed
        if self._followed is None:
            return
        duration_s, self._comparable = self._followed
        if not self._estimate.active.identified:
            return
        self.residuals.expect(self._known_to(self._estimate.active.model))
        if turns:
            self.residuals.add(self._estimate.innovations, duration_s, self._comparable)

    def clock_set(self, by_us: int) -> None:
        """Go on without a gap: the clock was set by so much."""
        if self._stepped_us is not None:
            self._stepped_us += by_us

    def stop(self) -> None:
        """Let the model alone start again from the estimate."""
        self._reference.stop()

    def differences_k(self, good_value: Callable[[str], float | None]) -> dict[str, float | None]:
        """Measured minus the model alone, for every sensor that the model knows."""
        active = self._estimate.active
        differences: dict[str, float | None] = dict.fromkeys(self._known_to(active.model))
        if active.identified and self._comparable:
            for channel in differences:
                value = good_value(channel)
                expected_c = self._reference.expected_c(active.model, channel)
                if value is not None and expected_c is not None:
                    differences[channel] = round(value - expected_c, 3)
        return differences

    def _known_to(self, model: ThermalModel) -> tuple[str, ...]:
        """The measured temperatures that a model knows."""
        if model is not self._model:
            known = {*model.sensor_names, *model.node_names}
            self._model = model
            self._known = tuple(name for name in self.temperatures if name in known)
        return self._known

    def to_dict(self) -> KeptWatch:
        """Return what was learned of the model, as plain JSON types."""
        return {
            "version": self._version,
            "reference": self._reference.to_dict(),
            "residuals": self.residuals.to_dict(),
        }

    def restore(self, kept: KeptWatch) -> None:
        """Take up what `to_dict` gave, if it is of the same version."""
        if kept.get("version") != self._version:
            return
        reference, residuals = kept.get("reference"), kept.get("residuals")
        if isinstance(reference, Mapping):
            self._reference.restore(self._estimate.active.model, reference)
        if isinstance(residuals, Mapping):
            self.residuals.restore(residuals)
