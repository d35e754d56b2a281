import numpy as np
import pytest

from twin_core.simulation import OperatingProfile, hold_operating_point, total_revolutions


def _profile(speed: np.ndarray, load: np.ndarray | float = 2650.0) -> OperatingProfile:
    n = len(speed)
    return OperatingProfile(
        np.arange(n) * 60.0, np.asarray(speed, float), np.broadcast_to(load, n), np.full(n, 22.6)
    )


def _points(profile: OperatingProfile) -> int:
    pairs = np.column_stack((profile.speed_rpm, profile.load_n))
    return 1 + int((np.diff(pairs, axis=0) != 0.0).any(axis=1).sum())


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("speed_rpm", [1.0, 2.0], r"speed_rpm has shape \(2,\)"),
        ("load_n", [1.0, np.nan, 1.0], r"load_n\[1\] is nan, expected a finite number"),
        ("time_s", [0.0, 60.0, 60.0], r"time_s\[2\] = 60.0 does not come after time_s\[1\]"),
    ],
)
def test_bad_profiles_name_the_field(field: str, value: list[float], message: str) -> None:
    arrays = {
        "time_s": [0.0, 60.0, 120.0],
        "speed_rpm": [1.0, 1.0, 1.0],
        "load_n": [1.0, 1.0, 1.0],
        "ambient_c": [20.0, 20.0, 20.0],
    }
    with pytest.raises(ValueError, match=message):
        OperatingProfile(**{name: np.array(v) for name, v in {**arrays, field: value}.items()})


def test_an_empty_profile_is_refused() -> None:
    with pytest.raises(ValueError, match="non-empty"):
        OperatingProfile(*(np.empty(0),) * 4)


def test_revolutions_count_either_sense_of_rotation() -> None:
    profile = _profile(np.array([3000.0, -1500.0, 0.0]))
    assert total_revolutions(profile, 10.0).tolist() == [10.0, 3010.0, 4510.0]
    assert total_revolutions(profile, np.array([0.0, 5.0])).tolist() == [
        [0.0, 3000.0, 4500.0],
        [5.0, 3005.0, 4505.0],
    ]


def test_noise_is_held_at_its_mean() -> None:
    rng = np.random.default_rng(2)
    speed = np.repeat([1500.0, 2400.0, 4200.0], 90) + rng.normal(0.0, 2.0, 270)
    load = 2650.0 + rng.normal(0.0, 10.0, 270)
    held = hold_operating_point(_profile(speed, load))
    assert _points(held) == 3
    assert held.speed_rpm[:90] == pytest.approx(speed[:90].mean())
    assert held.load_n[90:180] == pytest.approx(load[90:180].mean())
    assert held.ambient_c.tolist() == [22.6] * 270


def test_steps_stay_where_they_are() -> None:
    speed = np.repeat([3000.0, 3040.0, 3000.0, 0.0], 10)
    held = hold_operating_point(_profile(speed))
    assert held.speed_rpm.tolist() == speed.tolist()
    load = np.repeat([2650.0, 2770.0], 10)
    assert (
        hold_operating_point(_profile(np.full(20, 3000.0), load)).load_n.tolist() == load.tolist()
    )


def test_a_ramp_stays_within_the_tolerance_everywhere() -> None:
    speed = np.linspace(1000.0, 6000.0, 200)
    load = np.linspace(1000.0, 5000.0, 200)
    held = hold_operating_point(_profile(speed, load))
    assert (np.abs(held.speed_rpm - speed) <= 0.005 * speed + 5.0 + 0.2).all()
    assert (np.abs(held.load_n - load) <= 0.015 * load + 20.0 + 0.5).all()


def test_a_slow_creep_is_not_smeared_over_hours() -> None:
    """Every neighbour is alike, the ends are not."""
    speed = 3000.0 + 0.5 * np.arange(400)
    held = hold_operating_point(_profile(speed))
    assert np.abs(held.speed_rpm - speed).max() <= 0.005 * speed.max() + 5.1
    assert _points(held) >= 4


def test_weights_are_durations() -> None:
    profile = OperatingProfile(
        np.array([0.0, 30.0, 120.0, 121.0]),
        np.array([1000.0, 1004.0, 2000.0, 2000.0]),
        np.full(4, 100.0),
        np.full(4, 20.0),
    )
    assert hold_operating_point(profile).speed_rpm == pytest.approx(
        [1003.0, 1003.0, 2000.0, 2000.0]
    )


def test_a_single_row() -> None:
    assert hold_operating_point(_profile(np.array([7.0]))).speed_rpm.tolist() == [7.0]
