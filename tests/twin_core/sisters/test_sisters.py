"""Families made of the model itself: they test the computation, not how true the model is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from twin_core.bearings import bearing
from twin_core.filtering import begin, run_filter
from twin_core.forecasting import Forecast, forecast
from twin_core.identification import (
    FitSettings,
    IdentificationData,
    IdentificationResult,
    IdentificationWindow,
    Posterior,
    identify,
    prior_posterior,
)
from twin_core.identification.family import SisterKnowledge, SisterRun
from twin_core.identification.posterior import TrainedRange
from twin_core.identification.problem import IdentificationProblem
from twin_core.models import ThermalModel, build_model
from twin_core.operating_points import OperatingSpan
from twin_core.simulation import OperatingProfile, simulate
from twin_core.sisters import (
    Sister,
    WithSisters,
    calibration_runs,
    identify_with_sisters,
    population_prior,
    same_run,
    strangers,
)
from twin_core.sisters.blocks import doubted, laws_of
from twin_core.sisters.learning import law_documents
from twin_core.sisters.trust import DOUBT, log_evidence
from twin_core.windows import MinuteData

FloatArray = NDArray[np.float64]

LIGHT = ((3, 0.0, 2650.0), (60, 5800.0, 2650.0))
HEAVY = (*LIGHT, (60, 5800.0, 5500.0))
LOW_ROWS = 63
SISTERS = 8
INNER = "t_inner_ring_c"


@dataclass(frozen=True)
class Family:
    """Sisters that have seen the heavy load, and a target that has not, with what it then did."""

    model: ThermalModel
    sisters: tuple[Sister, ...]
    target: MinuteData
    literature: IdentificationResult

    @property
    def data(self) -> IdentificationData:
        return of_rows(self.target.take(slice(0, LOW_ROWS)))


def of_rows(minutes: MinuteData) -> IdentificationData:
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))


def run(model: ThermalModel, z: FloatArray, seed: int) -> MinuteData:
    """What the sensors of a machine read that is the model with coordinates ``z``."""
    speed = np.concatenate([np.full(count, rpm) for count, rpm, _ in HEAVY])
    load = np.concatenate([np.full(count, newton) for count, _, newton in HEAVY])
    time_s = 60.0 * np.arange(speed.size, dtype=np.float64)
    profile = OperatingProfile(time_s, speed, load, np.full(speed.size, 22.0))
    path = simulate(model, model.parameters.values_from_z(z), profile, np.full(13, 22.0))
    rng = np.random.default_rng(seed)
    read = {
        name: path.temperatures_c @ model.sensor_row(name) + rng.normal(0.0, 0.08, speed.size)
        for name in model.sensor_names
    }
    return MinuteData(time_s, speed, load, profile.ambient_c, read, np.ones(speed.size, np.bool_))


def member(model: ThermalModel, seed: int, load_exponent_z: float) -> FloatArray:
    """Coordinates of a machine of a family whose friction follows the load in its own way."""
    z = np.random.default_rng(seed).normal(0.0, 0.25, model.parameters.size)
    z[model.parameters.index("b")] += load_exponent_z
    return np.asarray(np.clip(z, model.parameters.z_lower, model.parameters.z_upper))


def sister(model: ThermalModel, seed: int, load_exponent_z: float) -> Sister:
    data = of_rows(run(model, member(model, seed, load_exponent_z), seed))
    found = identify(model, data, FitSettings(method="refine", samples=0)).posterior
    return Sister(f"number {seed}", found.z, found.covariance, found.trained, data)


@pytest.fixture(scope="module")
def family() -> Family:
    model = build_model(bearing=bearing("6016"))
    target = run(model, member(model, 99, -1.5), 99)
    low = of_rows(target.take(slice(0, LOW_ROWS)))
    return Family(
        model,
        tuple(sister(model, seed, -1.5) for seed in range(SISTERS)),
        target,
        identify(model, low, FitSettings(method="refine")),
    )


def heavy_forecast(family: Family, posterior: Posterior) -> Forecast:
    """Forecast of the target's heavy load from its last light row."""
    model, rows = family.model, family.target
    profile = OperatingProfile(rows.time_s, rows.speed_rpm, rows.load_n, rows.ambient_c)
    observer = begin(
        model,
        model.parameters.values_from_z(posterior.z),
        rows.readings(0),
        profile.point(0),
        True,
    )
    now = LOW_ROWS - 1
    run_filter(observer, profile.rows(slice(now + 1)), [rows.readings(k) for k in range(now + 1)])
    ahead = profile.rows(slice(now, rows.size))
    return forecast(model, posterior, observer.state(22.0), ahead)


def error_and_width(family: Family, posterior: Posterior) -> tuple[float, float]:
    """Error and width of the band of the inner ring at the end of the heavy load, in K."""
    low, _, median, _, high = heavy_forecast(family, posterior).quantile(INNER)[:, -10:]
    error_k = np.mean(median - family.target.temperatures_c[INNER][-10:])
    return float(abs(error_k)), float(np.mean(high - low))


def test_sisters_teach_the_load_that_they_have_seen(family: Family) -> None:
    found = identify_with_sisters(
        family.model, family.data, family.sisters, family.literature, calibrate=False
    )
    assert found.verdict.accepted, found.verdict.reason
    assert found.verdict.to_dict()["used"] == SISTERS
    assert found.verdict.load_n_max == pytest.approx(5500.0)
    before, after = (
        error_and_width(family, one.posterior) for one in (family.literature, found.result)
    )
    assert after[0] < 0.6 * before[0]
    assert after[1] < 0.6 * before[1]
    labels = heavy_forecast(family, found.result.posterior).labels
    assert "load law from 8 sisters" in labels
    assert "load law from prior only" in heavy_forecast(family, family.literature.posterior).labels
    assert Posterior.from_dict(found.result.posterior.to_dict()).sisters == (
        found.result.posterior.sisters
    )


def test_a_machine_that_was_warm_at_the_first_row_is_judged_alike(family: Family) -> None:
    warm = family.target.take(slice(25, LOW_ROWS))
    data = IdentificationData((IdentificationWindow(warm, at_rest=False),))
    literature = identify(family.model, data, FitSettings(method="refine", samples=0))
    prior = population_prior(family.sisters)

    informed = identify(family.model, data, FitSettings(method="refine", samples=0), prior=prior)

    def gain(guess: FloatArray) -> float:
        """What the sisters gain, with initial states guessed at other parameters."""
        with_sisters = IdentificationProblem(family.model, data, guess, prior=prior)
        without = IdentificationProblem(family.model, data, guess)
        best = informed.posterior.z, literature.posterior.z
        return log_evidence(with_sisters, best[0]) - log_evidence(without, best[1])

    assert gain(literature.posterior.z) > 0.0
    assert gain(literature.posterior.z) == pytest.approx(gain(prior.mean), abs=1.0)


def test_strangers_are_set_aside_and_do_no_harm(family: Family) -> None:
    strange = [replace(sister(family.model, seed, 1.5), name=f"odd {seed}") for seed in (50, 51)]
    mixed = (*family.sisters, *strange)
    assert set(strangers(family.model, mixed)) == {"odd 50", "odd 51"}
    assert strangers(family.model, family.sisters) == {}
    pure, harmed = (
        identify_with_sisters(family.model, family.data, those, family.literature, calibrate=False)
        for those in (family.sisters, mixed)
    )
    assert_array_equal(harmed.result.posterior.z, pure.result.posterior.z)
    assert "friction heat grows" in harmed.verdict.set_aside["odd 50"]


def of_another_kind(family: Family, name: str, shift: float) -> list[Sister]:
    """The sisters with one parameter moved, so that they agree on something else."""
    moved = family.model.parameters.index(name)
    others = []
    for one in family.sisters:
        z = one.z.copy()
        z[moved] += shift
        others.append(replace(one, z=z))
    return others


def learned(family: Family, data: IdentificationData, sisters: Sequence[Sister]) -> WithSisters:
    literature = identify(family.model, data, FitSettings(method="refine"))
    return identify_with_sisters(family.model, data, sisters, literature, calibrate=False)


def test_light_data_leave_the_load_law_untested_and_its_doubt_as_it_was(family: Family) -> None:
    found = identify_with_sisters(
        family.model, family.data, family.sisters, family.literature, calibrate=False
    )
    load = found.verdict.laws["load"]
    assert load.log_bayes_factor == pytest.approx(0.0, abs=0.3)
    assert (load.tested, load.source) == (False, "family")
    assert load.weight_family == pytest.approx(1.0 - DOUBT, abs=0.03)
    assert load.settled_by == "20 min at 3300 N"
    said = "load law: family's, not tested on this machine; 20 min at 3300 N would settle it"
    assert said in found.verdict.reason
    assert said in heavy_forecast(family, found.result.posterior).labels
    assert said not in heavy_forecast(family, family.literature.posterior).labels
    document = law_documents(family.model, found.result.posterior, found.verdict)
    assert document["load"] == load.to_dict()
    assert found.result.posterior.samples.shape == family.literature.posterior.samples.shape


def test_a_wrong_load_law_is_held_by_the_doubt_and_found_by_a_stage_at_another_load(
    family: Family,
) -> None:
    """All sisters share the machine's housing and not its load law."""
    strange = of_another_kind(family, "b", 3.0)
    light = identify_with_sisters(
        family.model, family.data, strange, family.literature, calibrate=False
    )
    assert light.verdict.laws["load"].weight_family == pytest.approx(1.0 - DOUBT, abs=0.05)
    # The family alone would be sure, and wrong. The machine itself is at 1.5 standard deviations
    # of the literature's, too far for a tenth of doubt to reach; but it goes most of the way.
    prior = population_prior(strange)
    sure = identify(family.model, family.data, FitSettings(method="refine"), prior=prior)
    missed_k = []
    for posterior in (sure.posterior, light.result.posterior):
        low = heavy_forecast(family, posterior).quantile(INNER)[0, -10:]
        missed_k.append(float(np.mean(low - family.target.temperatures_c[INNER][-10:])))
    assert missed_k[0] > 3.0
    assert missed_k[1] < 0.5 * missed_k[0]
    staged = of_rows(family.target.take(slice(0, LOW_ROWS + 20)))
    found, right = (learned(family, staged, those) for those in (strange, family.sisters))
    load = found.verdict.laws["load"]
    assert load.tested
    assert load.log_bayes_factor is not None
    assert load.log_bayes_factor < -2.0
    assert load.weight_family < 0.3
    assert load.source != "family"
    assert right.verdict.laws["load"].weight_family > 0.8
    # What is the family's in the other laws stays.
    assert found.verdict.accepted
    assert found.verdict.laws["housing"].weight_family > 0.8


def test_a_strange_housing_takes_nothing_from_the_load_law(family: Family) -> None:
    """Sisters whose friction is everywhere twice as high: their level is refused, no more."""
    found = identify_with_sisters(
        family.model,
        family.data,
        of_another_kind(family, "M0", 2.5),
        family.literature,
        calibrate=False,
    )
    laws = found.verdict.laws
    assert laws["housing"].weight_family < 0.1
    assert laws["load"].weight_family > 0.8
    assert found.verdict.accepted
    assert found.verdict.evidence_gain is not None


def test_sisters_that_the_machines_own_data_contradict_in_everything_are_refused(
    family: Family,
) -> None:
    others = list(family.sisters)
    for name, shift in (("M0", 3.5), ("b", 3.5), ("q", 3.5), ("A", 3.5), ("Nr", -2.5)):
        others = of_another_kind(replace(family, sisters=tuple(others)), name, shift)
    staged = of_rows(family.target)
    literature = identify(family.model, staged, FitSettings(method="refine"))
    found = identify_with_sisters(family.model, staged, others, literature)
    assert not found.verdict.accepted
    assert found.result is literature
    assert found.prior is None
    laws = law_documents(family.model, literature.posterior, found.verdict)
    assert all(law["weight_family"] < 0.5 for law in laws.values())


def test_without_sisters_each_law_is_the_machines_own_or_the_literatures(family: Family) -> None:
    laws = law_documents(family.model, family.literature.posterior, None)
    assert (laws["load"]["source"], laws["load"]["tested"]) == ("literature", False)
    assert laws["housing"]["source"] == "own"
    assert {law["weight_family"] for law in laws.values()} == {0.0}
    never = law_documents(family.model, prior_posterior(family.model), None)
    assert not any(law["tested"] for law in never.values())


def test_each_parameter_belongs_to_one_law(family: Family) -> None:
    names = family.model.parameters.names
    laws = {law: {names[row] for row in rows} for law, rows in laws_of(family.model).items()}
    assert laws["load"] == {"s", "b", "c"}
    assert laws["speed"] == {"p", "p2", "q", "pq"}
    assert laws["start"] == {"A", "Nr"}
    assert sum(len(of) for of in laws.values()) == len(names)


def test_a_doubted_law_is_the_literatures_and_independent_of_the_rest(family: Family) -> None:
    prior = population_prior(family.sisters)
    rows = laws_of(family.model)["load"]
    rest = [k for k in range(prior.mean.size) if k not in rows]
    of = doubted(prior, rows)
    assert_allclose(of.mean[rows], 0.0)
    assert_allclose(of.covariance[np.ix_(rows, rows)], np.eye(len(rows)), atol=1e-12)
    assert_allclose(of.covariance[np.ix_(rows, rest)], 0.0, atol=1e-12)
    assert_allclose(of.covariance[np.ix_(rest, rest)], prior.covariance[np.ix_(rest, rest)])
    assert doubted(prior, []) is prior


def test_each_sister_is_played_as_the_target(family: Family) -> None:
    trained = family.literature.posterior.trained
    played = (*family.sisters[:2], replace(family.sisters[2], data=None), family.sisters[3])
    runs = calibration_runs(family.model, played, trained)
    assert [one.bearing for one in runs] == ["number 0", "number 1", "number 3"]
    for one in runs:
        assert one.load_n_max == 5500.0
        assert 0.0 < one.needed[INNER] < 3.0  # a sister of the same make, in a band for it
        assert 0.0 < one.needed_whole[INNER] < 3.0


def test_a_calibrated_band_is_the_band_times_the_factor(family: Family) -> None:
    needs = [SisterRun(f"{k}", 5500.0, 5800.0, {INNER: 0.08 * k}) for k in range(1, 20)]
    known = SisterKnowledge(("a",) * 19, (5500.0,) * 19, (5800.0,) * 19)
    plain, scaled = (
        heavy_forecast(family, replace(family.literature.posterior, sisters=sisters))
        for sisters in (known, replace(known, calibration=tuple(needs)))
    )
    assert scaled.labels[-1] == "calibrated on 19 runs, 19 bearings"
    before, after = (one.quantile(INNER) - one.quantile(INNER)[2] for one in (plain, scaled))
    assert_allclose(after[:, 1:], 1.52 * before[:, 1:], atol=0.05)  # the largest of 19
    assert_array_equal(after[:, 0], before[:, 0])  # the present row is not beyond
    small = tuple(replace(need, needed={INNER: 0.2 * need.needed[INNER]}) for need in needs)
    confirmed = heavy_forecast(
        family, replace(family.literature.posterior, sisters=replace(known, calibration=small))
    )
    assert_array_equal(confirmed.quantile(INNER), plain.quantile(INNER))  # never narrower
    untouched = "t_outer_ring_c"  # no run says anything of it
    assert_array_equal(plain.quantile(untouched), scaled.quantile(untouched))
    # That sisters stayed cool makes a runaway no less probable, and takes no label away.
    assert 0.0 < plain.runaway_probability == scaled.runaway_probability
    assert set(plain.labels) == set(scaled.labels[:-1])


def test_the_probability_of_a_runaway_is_that_of_the_posterior_with_sisters(
    family: Family,
) -> None:
    alone = family.literature.posterior
    known = identify_with_sisters(
        family.model, family.data, family.sisters, family.literature, calibrate=False
    ).result.posterior
    assert known.sisters is not None
    without, with_sisters = (heavy_forecast(family, one) for one in (alone, known))
    assert "load law from prior only" in without.labels
    assert any("sister" in label for label in with_sisters.labels)
    # They narrow the load law, and with it how much clearance the rings may take up.
    assert with_sisters.runaway_probability < without.runaway_probability
    only_names = heavy_forecast(family, replace(alone, sisters=known.sisters))
    assert only_names.runaway_probability > with_sisters.runaway_probability


def test_the_band_of_the_whole_run_is_calibrated_by_itself(family: Family) -> None:
    needs = [
        SisterRun(f"{k}", 5500.0, 5800.0, {INNER: 0.02 * k}, {INNER: 0.10 * k})
        for k in range(1, 20)
    ]
    known = SisterKnowledge(("a",) * 19, (5500.0,) * 19, (5800.0,) * 19)
    assert SisterKnowledge.from_dict(replace(known, calibration=tuple(needs)).to_dict()) == replace(
        known, calibration=tuple(needs)
    )
    plain, scaled = (
        heavy_forecast(family, replace(family.literature.posterior, sisters=sisters))
        for sisters in (known, replace(known, calibration=tuple(needs)))
    )
    wide, narrow = (one.whole_run(INNER) - one.quantile(INNER)[2] for one in (plain, scaled))
    assert_allclose(narrow[:, 1:], 1.80 * wide[:, 1:], atol=0.1)  # the eighteenth of 19: 90 %
    assert_array_equal(narrow[:, 0], wide[:, 0])
    # Runs of an earlier version say nothing of it: it keeps its ratio to the band of each moment.
    older = tuple(replace(need, needed_whole={}) for need in needs)
    old = heavy_forecast(
        family, replace(family.literature.posterior, sisters=replace(known, calibration=older))
    )
    assert_allclose(old.whole_run_factor, plain.whole_run_factor)


@pytest.mark.parametrize(
    ("bearings", "runs_each", "load_n", "factor", "level"),
    [
        (8, 1, 5500.0, None, None),
        (9, 1, 5500.0, 9.0, 0.90),
        (18, 1, 5500.0, 18.0, 0.90),
        (19, 1, 5500.0, 19.0, 0.95),
        (39, 1, 5500.0, 38.0, 0.95),
        (8, 5, 5500.0, None, None),  # many runs of few bearings are still few bearings
        (19, 2, 5500.0, 19.5, 0.95),
        (19, 1, 7000.0, None, None),  # where none of them has been
    ],
)
def test_bearings_are_the_units_of_a_calibration(
    bearings: int, runs_each: int, load_n: float, factor: float | None, level: float | None
) -> None:
    runs = tuple(
        SisterRun(f"{k}", 5500.0, 5800.0, {INNER: k + 0.5 * again})
        for k in range(1, bearings + 1)
        for again in range(runs_each)
    )
    found = SisterKnowledge(("a",), (5500.0,), (5800.0,), runs).band_factor(load_n, 0.0)
    if factor is None or level is None:
        assert found is None
        return
    assert found is not None
    assert (found.by_sensor[INNER], found.level, found.bearings) == (factor, level, bearings)
    assert ("holds 90% of runs" in found.label) == (level == 0.90)


@settings(max_examples=50, deadline=None)
@given(st.integers(2, 30), st.floats(0.01, 5.0), st.integers(0, 10_000))
def test_no_population_is_wider_than_the_literature(n: int, scatter: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = 12
    sisters = []
    for number in range(n):
        turned, _ = np.linalg.qr(rng.normal(size=(p, p)))
        covariance = (turned * rng.uniform(1e-4, 1.0, p)) @ turned.T
        z = rng.normal(0.0, scatter, p)
        sisters.append(Sister(f"{number}", z, covariance, TrainedRange()))
    prior = population_prior(sisters)
    assert np.linalg.eigvalsh(prior.covariance)[-1] <= 1.0 + 1e-9
    assert_allclose(prior.mean, np.mean([one.z for one in sisters], axis=0))
    own = np.mean([one.covariance for one in sisters], axis=0)
    surplus = prior.covariance - np.minimum(1.0, np.linalg.eigvalsh(own)[0]) * np.eye(p)
    assert np.linalg.eigvalsh(surplus)[0] >= -1e-9  # never surer than the sisters are of themselves


def test_a_machine_is_no_sister_of_itself(family: Family) -> None:
    first, second = family.sisters[:2]
    assert first.data is not None
    assert second.data is not None
    assert same_run(family.data, of_rows(family.target))
    assert same_run(of_rows(family.target), family.data)
    assert not same_run(first.data, second.data)


def test_one_machine_is_no_population(family: Family) -> None:
    with pytest.raises(ValueError, match="1 sisters, expected at least 2"):
        population_prior(family.sisters[:1])


def test_what_sisters_have_seen_is_counted() -> None:
    known = SisterKnowledge(("a", "b", "c"), (2650.0, 5500.0, 4000.0), (1500.0, 6200.0, 6200.0))
    assert [known.with_load(load) for load in (2600.0, 4300.0, 5500.0, 9000.0)] == [3, 2, 1, 0]
    assert known.with_speed(6200.0) == 2
    assert known.usual_load_n == 4000.0
    trained = TrainedRange((OperatingSpan(5800.0, 3000.0, 3600.0, 0.0),))
    model = build_model(bearing=bearing("6016"))
    posterior = replace(
        identify(
            model, of_rows(run(model, np.zeros(24), 1)), FitSettings(method="refine", samples=0)
        ).posterior,
        trained=trained,
        sisters=known,
    )
    assert posterior.known_load_n == 4000.0
