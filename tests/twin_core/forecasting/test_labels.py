"""What must be said along with a forecast."""

from dataclasses import replace

import numpy as np
import pytest

from twin_core.bearings import bearing
from twin_core.forecasting.heat_laws import Law
from twin_core.forecasting.labels import (
    LOAD_LAW,
    NOT_IDENTIFIED,
    RUNAWAY,
    SPEED_LAW,
    doubtful_start,
    forecast_labels,
)
from twin_core.identification.identifiability import Verdict
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.models import build_model
from twin_core.network_model import RunawayLimits
from twin_core.operating_points import OperatingSpan
from twin_core.simulation import OperatingProfile


def trained_at(*points: tuple[float, float]) -> Posterior:
    prior = prior_posterior(build_model(bearing=bearing("6311")))
    return replace(
        prior,
        trained=TrainedRange(
            tuple(OperatingSpan(rpm, newton, 3600.0, 0.0) for rpm, newton in points), minutes=60
        ),
    )


def ahead(speed_rpm: float, load_n: float) -> OperatingProfile:
    return OperatingProfile(
        np.array([0.0, 60.0]),
        np.array([1000.0, speed_rpm]),
        np.array([1000.0, load_n]),
        np.full(2, 22.0),
    )


@pytest.mark.parametrize(
    ("points", "speed_rpm", "load_n", "expected"),
    [
        ([(1500, 2650), (4200, 2650)], 6200.0, 2650.0, ()),
        ([(1500, 2650), (4200, 2650)], 4200.0, 2900.0, ()),
        ([(1500, 2650), (4200, 2650)], 4200.0, 2950.0, (LOAD_LAW,)),
        ([(1500, 2650), (4200, 2650)], 4200.0, 4000.0, (LOAD_LAW, RUNAWAY)),
        ([(4200, 2650), (4200, 3300)], 4200.0, 4000.0, ()),
        ([(4200, 2650), (4200, 3300)], 4200.0, 5000.0, (RUNAWAY,)),
        ([(4200, 2650), (4200, 3300)], 6200.0, 2650.0, (SPEED_LAW,)),
        ([(1500, 2650)], 6200.0, 5500.0, (LOAD_LAW, SPEED_LAW, RUNAWAY)),
    ],
)
def test_labels_by_what_was_trained(points, speed_rpm, load_n, expected) -> None:  # type: ignore[no-untyped-def]
    assert forecast_labels(trained_at(*points), ahead(speed_rpm, load_n), 80.0, 0.0) == expected


def test_hot_upper_edge_and_runaway_members() -> None:
    posterior = trained_at((1500, 2650), (4200, 2650))
    point = ahead(4200.0, 2650.0)
    assert forecast_labels(posterior, point, 99.0, 0.0) == ()
    assert forecast_labels(posterior, point, 100.1, 0.0) == (RUNAWAY,)
    assert forecast_labels(posterior, point, 80.0, 0.01) == (RUNAWAY,)


def test_a_stage_that_taught_nothing_does_not_count() -> None:
    """Two loads in the data, yet the law of load is still the prior's; likewise for speed."""
    posterior = trained_at((1500, 2650), (4200, 3300))
    heavier, faster = ahead(4200.0, 4000.0), ahead(6200.0, 3300.0)

    def labels(profile: OperatingProfile, load: Verdict, speed: Verdict) -> tuple[str, ...]:
        return forecast_labels(posterior, profile, 80.0, 0.0, {"load": load, "speed": speed})

    assert labels(heavier, "prior only", "weak") == (LOAD_LAW,)
    assert labels(heavier, "weak", "prior only") == ()
    assert labels(faster, "weak", "prior only") == (SPEED_LAW,)
    assert labels(faster, "prior only", "weak") == ()


def test_a_law_of_the_network_itself_is_no_priors() -> None:
    posterior = trained_at((1500, 2650), (4200, 2650))
    heavier = ahead(4200.0, 3800.0)
    assert forecast_labels(posterior, heavier, 80.0, 0.0) == (LOAD_LAW,)
    stated: dict[Law, Verdict | None] = {"load": None, "speed": "weak"}
    assert forecast_labels(posterior, heavier, 80.0, 0.0, stated) == ()


def test_varying_duty_is_judged_by_what_its_data_say() -> None:
    """Loads that never lasted: taught if the data inform the law, or hold several and say a bit."""
    brief = tuple(OperatingSpan(3000.0, load, 300.0, 0.0) for load in (1000.0, 2000.0, 3000.0))
    long = tuple(replace(point, duration_s=1500.0) for point in brief)
    heavier = ahead(3000.0, 4000.0)

    def labels(duty: tuple[OperatingSpan, ...], load: Verdict) -> tuple[str, ...]:
        posterior = trained_at()
        varied = replace(posterior.trained, duty=duty)
        laws: dict[Law, Verdict | None] = {"load": load, "speed": "informed"}
        return forecast_labels(replace(posterior, trained=varied), heavier, 80.0, 0.0, laws)

    assert labels(brief, "informed") == ()
    assert labels(brief, "weak") == (LOAD_LAW,)
    assert labels(long, "weak") == ()
    assert labels(long, "prior only") == (LOAD_LAW,)


def test_before_any_identification() -> None:
    prior = prior_posterior(build_model(bearing=bearing("6311")))
    assert forecast_labels(prior, ahead(1500.0, 2650.0), 50.0, 0.0) == (NOT_IDENTIFIED,)


def test_load_on_a_standing_machine_teaches_and_threatens_nothing() -> None:
    posterior = trained_at((1500, 2650), (4200, 2650))
    assert forecast_labels(posterior, ahead(0.0, 9000.0), 50.0, 0.0) == ()


def test_a_doubtful_start_is_named_by_its_widest_band() -> None:
    names = ("t_inner_ring_c", "t_cage_c", "t_shaft_c")
    bands_c = np.array([[49.0, 40.0, 44.0], [50.0, 50.0, 50.0], [51.0, 64.0, 56.0]])
    assert doubtful_start(names, bands_c) == ("initial state of t_cage_c known to ±12 K only",)
    assert doubtful_start(names[:1], bands_c[:, :1]) == ()
    assert doubtful_start(names, bands_c, scale=3.0) == ()


def test_the_limits_of_a_runaway_are_the_networks() -> None:
    posterior = trained_at((1500, 2650), (4200, 3300))
    heavier = ahead(4200.0, 9000.0)
    assert RUNAWAY in forecast_labels(posterior, heavier, 140.0, 0.0)
    assert forecast_labels(posterior, heavier, 140.0, 0.0, limits=None) == ()
    assert forecast_labels(posterior, heavier, 140.0, 0.01, limits=None) == (RUNAWAY,)
    wide = RunawayLimits(hot_c=155.0, load_factor=4.0, lost_c=180.0)
    assert forecast_labels(posterior, heavier, 154.0, 0.0, limits=wide) == ()
    assert forecast_labels(posterior, heavier, 156.0, 0.0, limits=wide) == (RUNAWAY,)
    with pytest.raises(ValueError, match=r"lost_c is 90\.0, expected at least hot_c = 100\.0"):
        RunawayLimits(lost_c=90.0)
