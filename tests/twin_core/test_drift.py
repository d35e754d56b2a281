"""Comparison of two posteriors: its statistics on linear problems, and what it names."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_core.bearings import bearing
from twin_core.drift import (
    CANDIDATES,
    FALSE_ALARM_RATE,
    compare,
    difference_covariance,
    difference_of,
    usual_point,
)
from twin_core.identification.posterior import Posterior, TrainedRange, prior_posterior
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.quantities import ReferencePoint, evaluate, parameter_groups, quantities
from twin_core.similarity import Similarity, nearest, similarity

FloatArray = NDArray[np.float64]
HOUR = 3600.0
POINT = ReferencePoint(3600.0, 2650.0, 50.0)
DAY = ((2400.0, 2650.0, 5.0), (3600.0, 2650.0, 5.0), (4200.0, 3300.0, 3.0))


def trained(
    day: tuple[tuple[float, float, float], ...] = DAY, start_s: float = 0.0, run_in: bool = True
) -> TrainedRange:
    points = []
    for speed_rpm, load_n, hours in day:
        points.append(OperatingSpan(speed_rpm, load_n, hours * HOUR, start_s))
        start_s += hours * HOUR
    return TrainedRange(tuple(points), 780, False, 1e8 if run_in else 0.0)


class Bench:
    """A linear machine: what is measured is a matrix times its standard coordinates, plus noise."""

    def __init__(self, model: ThermalModel, seed: int, informed: int = 9) -> None:
        self.model = model
        self.rng = np.random.default_rng(seed)
        p = model.parameters.size
        size = np.concatenate((np.geomspace(30.0, 3.0, informed), np.full(p - informed, 0.1)))
        axes, _ = np.linalg.qr(self.rng.normal(size=(p, p)))
        self.sensitivity = size[:, None] * axes.T
        self.z = self.rng.normal(size=p)

    def posterior(self, z: FloatArray, scale: float = 1.0, **changes: object) -> Posterior:
        """Posterior from new data of a machine at z; its noise is scaled by a root."""
        noise = np.sqrt(scale) * self.rng.normal(size=z.size)
        covariance = np.linalg.inv(np.eye(z.size) + self.sensitivity.T @ self.sensitivity)
        seen = self.sensitivity.T @ (self.sensitivity @ z + noise)
        return replace(
            prior_posterior(self.model),
            z=covariance @ seen,
            covariance=covariance,
            trained=changes.get("trained", trained()),
        )


# --- statistics --------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [0.0, 0.5, 1.0])
def test_covariance_of_the_difference_is_that_of_simulated_estimates(shared: float) -> None:
    """Prior drawn anew, data drawn anew: the later data hold a part of the earlier."""
    rng = np.random.default_rng(3)
    p, count = 5, 40_000
    old = rng.normal(size=(8, p))  # rows of data of the first window, half of them shared twice
    old = np.concatenate((old, old))
    new = 0.7 * rng.normal(size=(6, p))
    kept = old[: round(shared * 16)]
    later = np.concatenate((kept, new))
    a = np.linalg.inv(np.eye(p) + old.T @ old)
    b = np.linalg.inv(np.eye(p) + later.T @ later)
    z = rng.normal(size=(count, p))
    noise = rng.normal(size=(count, len(old)))
    first = (z @ old.T + noise) @ old @ a
    fresh = z @ new.T + rng.normal(size=(count, len(new)))
    again = (z @ kept.T + noise[:, : len(kept)]) @ kept + fresh @ new
    difference = again @ b - first
    expected = difference_covariance(a, b, shared)
    found = difference.T @ difference / count
    assert np.abs(found - expected).max() < 0.03 * np.abs(expected).max()


def test_what_only_repeats_the_prior_may_not_differ() -> None:
    loose = difference_covariance(np.eye(3), np.eye(3))
    assert np.abs(loose).max() <= 1.1e-3  # the least variance only
    firm = difference_covariance(1e-2 * np.eye(3), 1e-2 * np.eye(3))
    assert np.diag(firm) == pytest.approx(2e-2, rel=0.02)


def test_false_alarms_are_as_rare_as_stated(model: ThermalModel) -> None:
    probabilities, ratios = [], []
    for seed in range(300):
        bench = Bench(model, seed)
        # other points altogether: the comparison multiplies the covariance by its factor
        before = bench.posterior(bench.z)
        after = bench.posterior(bench.z, trained=trained(((1500.0, 2000.0, 10.0),), start_s=1e5))
        found = difference_of(before, after)
        assert found.similarity == Similarity(0.0, 0.0)
        probabilities.append(found.probability)
        ratios.append(found.statistic * found.similarity.scale / found.value.size)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.12)  # chi squared without the factor
    assert np.mean(np.array(probabilities) < 10 * FALSE_ALARM_RATE) <= 10 * FALSE_ALARM_RATE
    assert np.mean(np.array(probabilities) < FALSE_ALARM_RATE) <= FALSE_ALARM_RATE


# --- what moved --------------------------------------------------------------------------------


@pytest.mark.parametrize("group", CANDIDATES)
def test_the_group_that_moved_is_named_with_its_change(model: ThermalModel, group: str) -> None:
    groups = parameter_groups(model)
    own = [k for k, name in enumerate(model.parameters.names) if groups[name] == group]
    row = [quantity.group for quantity in quantities(model, POINT)].index(group)
    named, covered, seen = 0, 0, 0
    for seed in range(8):
        bench = Bench(model, seed, informed=22)
        bench.z *= 0.2  # the truth of a large change is not linear at the edges of the prior
        later = bench.z.copy()
        later[own] += bench.rng.normal(size=len(own))
        before, after = (
            bench.posterior(bench.z, 0.7),
            bench.posterior(later, 0.7, trained=trained(DAY[::-1], start_s=1e5)),
        )
        drift = compare(model, before, after, point=POINT)
        if not drift.changed:
            continue
        seen += 1
        named += next(iter(drift.groups)) == group
        assert sum(drift.groups.values()) == pytest.approx(1.0)
        assert list(drift.groups.values()) == sorted(drift.groups.values(), reverse=True)
        assert [move.quantity.group for move in drift.moves] == list(drift.groups)
        move = next(move for move in drift.moves if move.quantity.group == group)
        truth = evaluate(model, later, POINT)[row] / evaluate(model, bench.z, POINT)[row] - 1.0
        covered += move.low - 0.03 < truth < move.high + 0.03
    assert seen >= 6
    assert named >= seen - 1
    assert covered >= seen - 2


def test_text_says_what_moved_or_that_nothing_did(model: ThermalModel) -> None:
    bench = Bench(model, 1, informed=22)
    later = bench.z.copy()
    later[model.parameters.index("hext")] -= 2.0
    moved = compare(model, bench.posterior(bench.z), bench.posterior(later), point=POINT)
    assert moved.changed
    assert moved.text.startswith("convection outside moved, conductance from the outside")
    assert " % (95 %: -" in moved.text
    # the same run again: a tenth of the variance is left, so says the factor
    calm = compare(model, bench.posterior(bench.z, 0.1), bench.posterior(bench.z, 0.1), point=POINT)
    assert not calm.changed
    assert calm.text.startswith("no change beyond what noise and model error explain (p = ")


def test_doubt_about_the_group_is_said(model: ThermalModel) -> None:
    bench = Bench(model, 4, informed=3)  # three directions cannot tell six groups apart
    later = bench.z + 0.08 * np.linalg.svd(bench.sensitivity)[2][0]
    drift = compare(model, bench.posterior(bench.z), bench.posterior(later), point=POINT)
    assert drift.changed
    assert "not excluded: " in drift.text


# --- how alike the data are --------------------------------------------------------------------


def _with(model: ThermalModel, data: TrainedRange) -> Posterior:
    return replace(prior_posterior(model), trained=data)


def test_the_same_run_again_is_told_from_the_same_points_in_another_order(
    model: ThermalModel,
) -> None:
    first = _with(model, trained())
    again = _with(model, trained(start_s=86_400.0))
    reversed_ = _with(model, trained(DAY[::-1], start_s=86_400.0))
    longer = _with(model, trained((*DAY, (3000.0, 2000.0, 13.0)), start_s=86_400.0))
    assert similarity(first, again) == Similarity(1.0, 1.0)
    assert similarity(first, again).same_run
    assert similarity(first, reversed_).points == 1.0
    assert similarity(first, reversed_).sequence < 0.5
    assert similarity(first, longer).points == pytest.approx(0.5)
    assert similarity(first, longer).scale > similarity(first, reversed_).scale
    assert similarity(first, reversed_).scale > similarity(first, again).scale


def test_a_bearing_that_runs_in_is_like_no_other(model: ThermalModel) -> None:
    fresh = _with(model, trained(run_in=False))
    assert similarity(fresh, _with(model, trained())) == Similarity(0.0, 0.0)
    assert similarity(fresh, fresh).same_run


def test_a_start_at_rest_is_another_run(model: ThermalModel) -> None:
    cold = _with(model, replace(trained(), from_rest=True))
    assert similarity(cold, _with(model, trained())) == Similarity(1.0, 0.0)


def test_a_colder_hall_is_allowed_for(model: ThermalModel) -> None:
    warm, cold, unknown = (
        _with(model, replace(trained(), ambient_c=ambient)) for ambient in (24.0, 16.0, None)
    )
    assert similarity(warm, cold).ambient_k == 8.0
    assert similarity(warm, unknown).ambient_k == 0.0
    assert similarity(warm, cold).same_run
    assert similarity(warm, cold).scale > 10.0 * similarity(warm, warm).scale
    assert similarity(warm, cold).text == "the same run again, ambient 8 K apart"


def test_nearest_takes_the_same_runs_or_else_the_nearest(model: ThermalModel) -> None:
    first, second = _with(model, trained()), _with(model, trained(start_s=1e5))
    other = _with(model, trained(DAY[:1], start_s=2e5))
    assert nearest([first, other, second], _with(model, trained(start_s=3e5))) == [0, 2]
    assert nearest([first, other], _with(model, trained(DAY[1:], start_s=3e5))) == [0]
    assert nearest([], first) == []


def test_usual_point_is_where_the_data_lasted_longest(model: ThermalModel) -> None:
    twice = _with(model, trained((*DAY, (4210.0, 3310.0, 3.0))))
    point = usual_point(model, twice)
    assert (point.speed_rpm, point.load_n) == (4200.0, 3300.0)
    assert usual_point(model, prior_posterior(model)).speed_rpm == model.reference_point[0]


# --- errors ------------------------------------------------------------------------------------


def test_what_cannot_be_compared_is_refused(model: ThermalModel) -> None:
    bench = Bench(model, 1)
    good = bench.posterior(bench.z)
    with pytest.raises(ValueError, match="nothing but the prior"):
        compare(model, prior_posterior(model), good)
    with pytest.raises(ValueError, match=r"shared is 1\.5, expected 0 to 1"):
        compare(model, good, good, shared=1.5)
    other = build_model(bearing=bearing("6016"))
    with pytest.raises(ValueError, match="does not belong"):
        compare(other, good, good)
