"""What the twin makes of the measurements: too hot for the model, too fast, or not as expected."""

from collections.abc import Iterator, Mapping

from service.alarms import AlarmCondition
from service.domain.channels import label
from service.live.residuals import ResidualChart
from service.live.rules.scene import Scene


def twin_difference(
    scene: Scene, differences_k: Mapping[str, float | None]
) -> Iterator[AlarmCondition]:
    """Measured temperature hotter than the model alone says.

    Parameters
    ----------
    scene : Scene
        What is known.
    differences_k : mapping of str to float or None
        Measured minus the model alone by channel; None where that cannot be told.
    """
    rule = scene.rules.twin_difference
    for channel, difference_k in differences_k.items():
        yield from scene.over_limits(
            rule,
            "twin difference",
            channel,
            difference_k,
            rule.limits,
            "{limit:g} K hotter than the model alone ({level})",
            deadband=rule.deadband_k,
            unit="K",
        )


def rate_of_rise(scene: Scene, rates: Mapping[str, float | None]) -> Iterator[AlarmCondition]:
    """Measured temperature that rises faster than any healthy operation makes it.

    Parameters
    ----------
    scene : Scene
        What is known.
    rates : mapping of str to float or None
        K/min by channel; None where that cannot be told.
    """
    rule = scene.rules.rate_of_rise
    for channel, rate in rates.items():
        yield from scene.over_limits(
            rule,
            "rate of rise",
            channel,
            rate,
            rule.limits,
            "rises by more than {limit:g} K/min ({level})",
            deadband=rule.deadband_k_per_min,
            unit="K/min",
        )


def twin_residual(
    scene: Scene, charts: Mapping[str, ResidualChart], threshold: float
) -> Iterator[AlarmCondition]:
    """Readings that fall to one side of what the twin expects, again and again.

    Parameters
    ----------
    scene : Scene
        What is known.
    charts : mapping of str to ResidualChart
        The sequential test of each channel.
    threshold : float
        Above it a test says that something has changed.
    """
    for channel, chart in charts.items():
        cusum = chart.cusum
        side = "hotter" if cusum.high >= cusum.low else "colder"
        yield scene.condition(
            scene.rules.twin_residual,
            "twin residual",
            channel,
            "",
            cusum.value > threshold,
            f"{label(channel)} repeatedly {side} than the twin expects",
            value=round(cusum.value, 2),
            limit_value=threshold,
            deadband=0.5 * threshold,
        )
