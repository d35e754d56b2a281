"""The least-squares problem: residuals, derivatives, elimination of what is not asked for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from twin_core.identification.data import IdentificationData, IdentificationWindow
from twin_core.identification.problem import IdentificationProblem
from twin_core.models import ThermalModel
from twin_core.windows import MinuteData

NO_LAG = -1.5


def unknowns_of(problem: IdentificationProblem, z: np.ndarray) -> np.ndarray:
    """The given parameters, no sensor lag, initial states as guessed."""
    unknowns = np.zeros(problem.unknown_count)
    unknowns[: z.size] = z
    unknowns[z.size] = NO_LAG
    return unknowns


def at_rest(minutes: MinuteData) -> IdentificationData:
    return IdentificationData((IdentificationWindow(minutes, at_rest=True),))


def test_true_parameters_leave_only_the_prior_residuals(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, at_rest(synthesise(true_z)))
    unknowns = unknowns_of(problem, true_z)
    residuals = problem.residuals(unknowns)[0]
    assert residuals.size == 2 * 123 + problem.unknown_count
    assert_allclose(residuals[: 2 * 123], 0.0, atol=1e-9)
    assert_allclose(residuals[2 * 123 :], unknowns)
    assert max(problem.rms_k(unknowns).values()) < 1e-10


def test_missing_rows_and_missing_values_are_skipped_not_filled(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    whole = synthesise(true_z)
    keep = np.ones(whole.size, dtype=np.bool_)
    keep[[20, 21, 70]] = False
    holed = whole.take(keep)
    holed.temperatures_c["t_outer_ring_c"][50:60] = np.nan
    holed.temperatures_c["t_inner_ring_c"][10] = 999.0
    holed.good[10] = False
    problem = IdentificationProblem(model, at_rest(holed))
    assert problem.measurement_count == (123 - 4) + (123 - 4 - 10)
    unknowns = unknowns_of(problem, true_z)
    assert max(problem.rms_k(unknowns).values()) < 1e-9


def test_a_lagging_sensor_is_explained_by_the_lag(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    minutes = synthesise(true_z)
    for values in minutes.temperatures_c.values():
        values[1:] += 25.0 / 60.0 * (values[:-1] - values[1:])
    problem = IdentificationProblem(model, at_rest(minutes))
    unknowns = unknowns_of(problem, true_z)
    assert max(problem.rms_k(unknowns).values()) > 0.1
    unknowns[true_z.size] = 1.0  # 15 s + 10 s
    assert max(problem.rms_k(unknowns).values()) < 1e-9


def test_jacobian_is_that_of_the_residuals(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    minutes = synthesise(true_z)
    windows = (
        IdentificationWindow(minutes, at_rest=True),
        IdentificationWindow(minutes.take(slice(60, None)), at_rest=False),
    )
    problem = IdentificationProblem(model, IdentificationData(windows))
    assert problem.unknown_count == model.parameters.size + 1 + 1 + 13
    unknowns = 0.3 * np.ones(problem.unknown_count)
    jacobian = problem.jacobian(unknowns)
    rng = np.random.default_rng(0)
    direction = rng.standard_normal(problem.unknown_count)
    step = 1e-4
    ends = problem.residuals(np.stack([unknowns + step * direction, unknowns - step * direction]))
    slope = (ends[0] - ends[1]) / (2.0 * step)
    assert_allclose(jacobian @ direction, slope, atol=1e-6 * np.max(np.abs(slope)))


def test_jacobian_at_a_bound_looks_inwards(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, at_rest(synthesise(true_z)))
    p = model.parameters.size
    unknowns = np.clip(np.zeros(problem.unknown_count), problem.lower, problem.upper)
    inside = problem.jacobian(unknowns)
    unknowns[0] = problem.upper[0]
    at_bound = problem.jacobian(unknowns)
    assert np.linalg.norm(at_bound[: problem.measurement_count, 0]) > 1.0
    assert np.all(np.isfinite(at_bound))
    assert np.linalg.norm(inside[: problem.measurement_count, :p]) > 1.0


def test_costs_do_not_blame_a_candidate_for_an_unknown_initial_state(
    model: ThermalModel,
    true_z,
    synthesise,  # type: ignore[no-untyped-def]
) -> None:
    """A window that begins on a warm machine: the truth must win although nobody knew its state."""
    warm = synthesise(true_z).take(slice(90, None))
    data = IdentificationData((IdentificationWindow(warm, at_rest=False),))
    problem = IdentificationProblem(model, data)
    stiff = np.zeros(problem.unknown_count)
    stiff[: true_z.size] = true_z
    without = float(np.sum(problem.residuals(stiff)[0] ** 2))
    eliminated = float(problem.costs(true_z[None])[0])
    found = problem.with_nuisance(true_z)
    refined = float(np.sum(problem.residuals(found)[0] ** 2))
    prior = float(true_z @ true_z)
    assert without > 4.0 * prior
    assert eliminated < without / 2.0
    assert refined < without / 2.0
    assert refined >= prior


def test_a_failing_candidate_is_infinitely_bad_and_harms_no_other(
    model: ThermalModel,
    true_z,
    synthesise,  # type: ignore[no-untyped-def]
) -> None:
    problem = IdentificationProblem(model, at_rest(synthesise(true_z)))
    batch = np.stack([true_z, np.full(true_z.size, np.nan), np.zeros(true_z.size)])
    costs = problem.costs(batch)
    assert np.isinf(costs[1])
    assert np.isfinite(costs[[0, 2]]).all()
    alone = IdentificationProblem(model, at_rest(synthesise(true_z))).costs(true_z[None])
    assert costs[0] == pytest.approx(alone[0], rel=1e-12)


def test_a_simulation_with_its_derivatives_counts_once(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    problem = IdentificationProblem(model, at_rest(synthesise(true_z)))
    unknowns = np.zeros(problem.unknown_count)
    problem.residuals(np.stack([unknowns, unknowns]))
    assert problem.evaluations == 2
    problem.jacobian(unknowns)
    assert problem.evaluations == 3


def test_where_the_simulation_fails_only_the_priors_have_derivatives(
    model: ThermalModel,
    true_z,
    synthesise,  # type: ignore[no-untyped-def]
) -> None:
    problem = IdentificationProblem(model, at_rest(synthesise(true_z)))
    jacobian = problem.jacobian(np.full(problem.unknown_count, np.nan))
    assert not jacobian[: problem.measurement_count].any()
    assert_allclose(jacobian[problem.measurement_count :], np.eye(problem.unknown_count))


def test_data_without_content_are_refused(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="no windows"):
        IdentificationData(())
    minutes = synthesise(true_z)
    minutes.good[:] = False
    with pytest.raises(ValueError, match="window 0: 0 good rows"):
        at_rest(minutes)


def test_a_sensor_that_the_model_does_not_have_is_named(model, true_z, synthesise) -> None:  # type: ignore[no-untyped-def]
    minutes = synthesise(true_z)
    minutes.temperatures_c["t_oil_c"] = minutes.temperatures_c["t_inner_ring_c"]
    with pytest.raises(ValueError, match="t_oil_c"):
        IdentificationProblem(model, at_rest(minutes))
