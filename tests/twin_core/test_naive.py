"""Naive forecasts recover the laws that they are able to express."""

import json

import numpy as np
import pytest

from twin_core.naive import NAIVE_KINDS, NaiveForecasts, fit_naive, naive_rms
from twin_core.simulation.profile import OperatingProfile
from twin_core.windows import MinuteData


def first_order_machine(stages: list[tuple[int, float, float]]) -> MinuteData:
    """A machine that is exactly ARX: excess relaxes towards 4 krpm + 3 kN + 2 with 30 min."""
    speed = np.concatenate([np.full(count, rpm) for count, rpm, _ in stages])
    load = np.concatenate([np.full(count, newton) for count, _, newton in stages])
    n = speed.size
    decay = np.exp(-60.0 / 1800.0)
    excess = np.zeros(n)
    target = 2.0 + 4.0 * speed / 1e3 + 3.0 * load / 1e3
    for k in range(n - 1):
        excess[k + 1] = decay * excess[k] + (1 - decay) * target[k]
    return MinuteData(
        time_s=60.0 * np.arange(n, dtype=np.float64),
        speed_rpm=speed,
        load_n=load,
        ambient_c=np.full(n, 21.0),
        temperatures_c={"t_inner_ring_c": 21.0 + excess, "t_outer_ring_c": 21.0 + 0.6 * excess},
        good=np.ones(n, dtype=np.bool_),
    )


STAGES = [(300, 1500.0, 2650.0), (300, 2400.0, 2650.0), (300, 2400.0, 3300.0)]


def profile_of(rows: MinuteData) -> OperatingProfile:
    return OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)


def test_arx_and_static_model_recover_a_first_order_machine() -> None:
    models = fit_naive([first_order_machine(STAGES)])
    ahead = first_order_machine([(1, 2400.0, 3300.0), (600, 6000.0, 5500.0)])
    forecasts = models.forecast(profile_of(ahead), {"t_inner_ring_c": 21.0, "t_outer_ring_c": 21.0})
    assert tuple(forecasts) == NAIVE_KINDS
    truth = ahead.temperatures_c["t_inner_ring_c"]
    np.testing.assert_allclose(forecasts["arx"]["t_inner_ring_c"], truth, atol=0.05)
    static = forecasts["static_linear"]["t_inner_ring_c"]
    assert static[-1] == pytest.approx(truth[-1], abs=0.1)
    assert static[10] > truth[10] + 10.0  # it knows no inertia
    assert np.all(forecasts["persistence"]["t_outer_ring_c"] == 21.0)


def test_what_is_kept_of_them_forecasts_the_same() -> None:
    models = fit_naive([first_order_machine(STAGES)])
    again = NaiveForecasts.from_dict(json.loads(json.dumps(models.to_dict())))
    ahead = profile_of(first_order_machine([(60, 2400.0, 3300.0)]))
    now_c = {"t_inner_ring_c": 25.0, "t_outer_ring_c": 24.0}
    for kind, by_sensor in models.forecast(ahead, now_c).items():
        for name, values in again.forecast(ahead, now_c)[kind].items():
            np.testing.assert_array_equal(values, by_sensor[name])


@pytest.mark.parametrize("damage", ["sensors", "static", "transition", "spacing_s"])
def test_what_is_kept_of_them_is_read_with_care(damage: str) -> None:
    document = fit_naive([first_order_machine(STAGES)]).to_dict()
    with pytest.raises(ValueError, match=f"naive forecasts: KeyError.*{damage}"):
        NaiveForecasts.from_dict({k: v for k, v in document.items() if k != damage})
    with pytest.raises(ValueError, match="naive forecasts: shapes"):
        NaiveForecasts.from_dict(document | {"static": [[1.0]]})


def test_irregular_rows_ahead_are_interpolated() -> None:
    models = fit_naive([first_order_machine(STAGES)])
    ahead = first_order_machine([(120, 4000.0, 2650.0)])
    rows = ahead.take(np.isin(np.arange(120), [0, 7, 30, 31, 119]))
    forecasts = models.forecast(profile_of(rows), {"t_inner_ring_c": 21.0, "t_outer_ring_c": 21.0})
    np.testing.assert_allclose(
        forecasts["arx"]["t_inner_ring_c"], rows.temperatures_c["t_inner_ring_c"], atol=0.05
    )


def test_what_does_not_vary_gets_no_coefficient() -> None:
    models = fit_naive([first_order_machine([(200, 1500.0, 2650.0), (200, 2400.0, 2650.0)])])
    assert np.all(models.static[2] == 0.0)
    assert np.all(models.drive[2] == 0.0)
    assert np.all(np.abs(models.static[1]) > 1.0)


def test_gaps_and_missing_values_do_not_disturb_the_fit() -> None:
    data = first_order_machine(STAGES)
    keep = np.ones(data.size, dtype=np.bool_)
    keep[100:130] = False
    holed = data.take(keep)
    holed.temperatures_c["t_outer_ring_c"][200:260] = np.nan
    holed.good[50:55] = False
    whole, part = fit_naive([data]), fit_naive([holed])
    np.testing.assert_allclose(part.static, whole.static, atol=0.05)
    # one sensor follows the other exactly here, so only what they do together is determined
    np.testing.assert_allclose(
        np.linalg.eigvals(part.transition).max(),
        np.linalg.eigvals(whole.transition).max(),
        atol=1e-4,
    )


def test_a_fit_that_would_run_away_is_damped() -> None:
    data = first_order_machine([(60, 1500.0, 2650.0)])
    data.temperatures_c["t_inner_ring_c"][:] = 21.0 + 1.05 ** np.arange(60)
    data.temperatures_c["t_outer_ring_c"][:] = 21.0
    transition = fit_naive([data]).transition
    assert np.max(np.abs(np.linalg.eigvals(transition))) < 1.0


def test_rms_over_a_test_span_and_sensors_without_values() -> None:
    train, test = first_order_machine(STAGES), first_order_machine([(240, 2000.0, 3000.0)])
    scores = naive_rms([train], test)
    assert scores["arx"]["t_inner_ring_c"] == pytest.approx(0.0, abs=0.02)
    persistence = scores["persistence"]["t_inner_ring_c"]
    assert persistence is not None
    assert persistence > 10.0
    test.temperatures_c["t_outer_ring_c"][:] = np.nan
    assert naive_rms([train], test)["persistence"]["t_outer_ring_c"] is None


def test_windows_must_share_their_sensors() -> None:
    data = first_order_machine(STAGES)
    other = MinuteData(data.time_s, data.speed_rpm, data.load_n, data.ambient_c, {}, data.good)
    with pytest.raises(ValueError, match="differ in their sensors"):
        fit_naive([data, other])
    with pytest.raises(ValueError, match="no windows"):
        fit_naive([])
