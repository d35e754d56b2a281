"""Identification as a whole, on data from the model itself (not a test of the model's truth)."""

import numpy as np
import pytest

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.identify import (
    FitSettings,
    IdentificationProgress,
    default_budget,
    identify,
)
from twin_core.identification.problem import IdentificationProblem
from twin_core.identification.refinement import IdentificationCancelled
from twin_core.models import ThermalModel
from twin_core.simulation import steady_state


def at_rest(minutes) -> IdentificationData:  # type: ignore[no-untyped-def]
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))


def steady_inner_ring(model: ThermalModel, z: np.ndarray, speed_rpm: float, load_n: float) -> float:
    values = model.parameters.values_from_z(z)
    temperatures = steady_state(model, values, speed_rpm, load_n, 22.0, 1e6)
    return float(model.sensor_row("t_inner_ring_c") @ temperatures)


@pytest.fixture(scope="module")
def result(model, cold_start):  # type: ignore[no-untyped-def]
    told: list[IdentificationProgress] = []
    found = identify(model, cold_start, FitSettings(budget=300, seed=3), progress=told.append)
    return found, told


def test_the_fit_explains_the_data_and_predicts_beyond_them(model, true_z, result) -> None:  # type: ignore[no-untyped-def]
    found, _ = result
    assert found.status == "converged"
    assert max(found.posterior.train_rms_k.values()) < 0.15
    for speed_rpm, load_n, allowed_k in ((4200.0, 2650.0, 0.8), (5000.0, 3300.0, 2.5)):
        truth = steady_inner_ring(model, true_z, speed_rpm, load_n)
        predicted = steady_inner_ring(model, found.posterior.z, speed_rpm, load_n)
        prior = steady_inner_ring(model, np.zeros(true_z.size), speed_rpm, load_n)
        assert abs(predicted - truth) < allowed_k
        assert abs(prior - truth) > 2.0 * allowed_k


def test_truth_lies_within_the_posterior(true_z, result) -> None:  # type: ignore[no-untyped-def]
    posterior = result[0].posterior
    assert np.max(np.abs(true_z - posterior.z) / posterior.std) < 3.5
    assert np.min(posterior.std) < 0.5  # the data said something


def test_every_start_ends_in_the_same_optimum(result) -> None:  # type: ignore[no-untyped-def]
    found, _ = result
    assert set(found.starts) == {"search", "prior", "random 1"}
    assert max(found.starts.values()) < min(found.starts.values()) * 1.01
    assert found.best_fitness == pytest.approx(min(found.starts.values()))


def test_progress_never_falls_and_ends_at_one(result) -> None:  # type: ignore[no-untyped-def]
    found, told = result
    fractions = [progress.fraction for progress in told]
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    phases = [progress.phase for progress in told]
    assert list(dict.fromkeys(phases)) == ["search", "refinement", "sampling", "done"]
    fitness = [progress.best_fitness for progress in told]
    assert fitness == sorted(fitness, reverse=True)
    assert told[-1].evaluations == found.evaluations > 300
    assert len(told) > 20


def test_same_seed_same_result(model, cold_start, result) -> None:  # type: ignore[no-untyped-def]
    again = identify(model, cold_start, FitSettings(budget=300, seed=3))
    np.testing.assert_array_equal(again.unknowns, result[0].unknowns)
    np.testing.assert_array_equal(again.posterior.samples, result[0].posterior.samples)
    assert again.history == result[0].history


def test_samples_scatter_like_the_posterior(model, result) -> None:  # type: ignore[no-untyped-def]
    posterior = result[0].posterior
    assert posterior.samples.shape == (200, model.parameters.size)
    assert np.all(posterior.samples >= model.parameters.z_lower - 1e-12)
    assert np.all(posterior.samples <= model.parameters.z_upper + 1e-12)
    ratio = posterior.samples.std(axis=0) / posterior.std
    assert np.all((ratio > 0.4) & (ratio < 1.6))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.2)


def test_search_alone_uses_its_budget_and_refinement_beats_it(model, cold_start, result) -> None:  # type: ignore[no-untyped-def]
    searched = identify(model, cold_start, FitSettings(method="noa", budget=300, seed=3, samples=0))
    assert searched.posterior.samples.shape == (0, model.parameters.size)
    assert list(searched.starts) == ["search"]
    assert searched.best_fitness > 2.0 * result[0].best_fitness


def test_the_fitness_is_that_of_the_unknowns_found(model, cold_start, result) -> None:  # type: ignore[no-untyped-def]
    searched = identify(model, cold_start, FitSettings(method="noa", budget=300, seed=3, samples=0))
    problem = IdentificationProblem(model, cold_start)
    for found in (searched, result[0]):
        residuals = problem.residuals(found.unknowns)[0]
        assert found.best_fitness == pytest.approx(float(residuals @ residuals))


def test_a_search_that_nothing_follows_takes_longer_by_default() -> None:
    assert default_budget("noa") > 10 * default_budget("noa+refine")


def test_refinement_without_search(model, cold_start, result) -> None:  # type: ignore[no-untyped-def]
    refined = identify(
        model, cold_start, FitSettings(method="refine", samples=0), guess_z=np.zeros(24)
    )
    assert set(refined.starts) == {"prior", "guess", "random 1", "random 2"}
    assert refined.best_fitness == pytest.approx(result[0].best_fitness, rel=1e-3)


def test_a_window_that_begins_warm_needs_no_assumption_about_ambient(
    model,
    true_z,
    synthesise,  # type: ignore[no-untyped-def]
) -> None:
    """The first hour is cut off; assuming ambient temperature instead must be far worse."""
    warm = synthesise(true_z, noise_k=0.1).take(slice(60, None))
    honest = identify(
        model,
        IdentificationData((IdentificationWindow(warm, at_rest=False, revolutions=1.0e5),)),
        FitSettings(method="refine", samples=0),
    )
    wrong = identify(
        model,
        IdentificationData((IdentificationWindow(warm, at_rest=True, revolutions=1.0e5),)),
        FitSettings(method="refine", samples=0),
    )
    assert honest.status == "converged"
    assert max(honest.posterior.train_rms_k.values()) < 0.15
    assert wrong.best_fitness > 2.0 * honest.best_fitness
    truth = steady_inner_ring(model, true_z, 4200.0, 2650.0)
    assert steady_inner_ring(model, honest.posterior.z, 4200.0, 2650.0) == pytest.approx(
        truth, abs=1.0
    )


def test_two_windows_inform_more_than_one(model, true_z, synthesise, result) -> None:  # type: ignore[no-untyped-def]
    first = synthesise(true_z, noise_k=0.1)
    second = synthesise(true_z, ((3, 0.0, 2650.0), (60, 3000.0, 2000.0)), noise_k=0.1, seed=1)
    both = identify(
        model,
        IdentificationData(
            (IdentificationWindow(first, at_rest=True), IdentificationWindow(second, at_rest=True))
        ),
        FitSettings(method="refine", samples=0),
    )
    assert both.status == "converged"
    one = np.linalg.slogdet(result[0].posterior.covariance)[1]
    assert np.linalg.slogdet(both.posterior.covariance)[1] < one - 1.0


def test_data_that_no_machine_gives_are_a_failed_fit(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    minutes = synthesise(true_z)
    minutes.temperatures_c["t_outer_ring_c"][:] = minutes.temperatures_c[
        "t_inner_ring_c"
    ] + 12.0 * np.sin(minutes.time_s / 600.0)
    found = identify(model, at_rest(minutes), FitSettings(method="refine", samples=0))
    assert found.status == "failed fit"
    assert "expected at most" in found.reason


def test_cancellation_in_search_and_in_refinement(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    for phase in ("search", "refinement"):
        seen: list[IdentificationProgress] = []
        with pytest.raises(IdentificationCancelled):
            identify(
                model,
                cold_start,
                FitSettings(budget=200),
                progress=seen.append,
                cancelled=lambda seen=seen, phase=phase: bool(seen) and seen[-1].phase == phase,
            )
        assert seen[-1].phase == phase


def test_senseless_orders_are_refused(model, cold_start) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="noa\\+refine"):
        identify(model, cold_start, FitSettings(method="pso"))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least the population"):
        identify(model, cold_start, FitSettings(budget=10))


def test_the_papers_model_is_identified_too(cold_start) -> None:  # type: ignore[no-untyped-def]
    from twin_core.bearings import bearing
    from twin_core.models import build_model

    paper = build_model("paper", bearing=bearing("6311"))
    found = identify(paper, cold_start, FitSettings(budget=200, samples=20))
    assert found.posterior.z.size == 15
    assert found.posterior.samples.shape == (20, 15)
    assert max(found.posterior.train_rms_k.values()) < 2.0
