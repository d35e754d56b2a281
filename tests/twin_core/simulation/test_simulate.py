from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from twin_core.bearings import bearing
from twin_core.models import ThermalModel, build_model
from twin_core.profiles import Point
from twin_core.simulation import (
    OperatingProfile,
    SimulationError,
    advance,
    heat_balance_w,
    kernels,
    simulate,
    simulate_batch,
    steady_state,
)
from twin_core.simulation.compiling import compiled

AMBIENT = 22.6
STAIRCASE = (1500.0, 2400.0, 4200.0, 4900.0, 5600.0, 6200.0)
COLD = np.full(13, AMBIENT)
# f2 and the 14 K of the paper's equation (27); K12 read as 4.4e+4.
PAPER_P1 = np.array(
    [0.7, 9998, 0.099, 5, 4.4e4, 0.99, 10.66, 2.46, 0.998, 5, 0.057, 0.97, 5, 0.074, 0.99]
)


@pytest.fixture(scope="module")
def default() -> ThermalModel:
    return build_model("default", bearing=bearing("6311"))


@pytest.fixture(scope="module")
def paper() -> ThermalModel:
    return build_model("paper", bearing=bearing("6311"))


def _constant(
    n: int, speed: float, load: float = 2650.0, step: float = 60.0, ambient: float = AMBIENT
) -> OperatingProfile:
    return OperatingProfile(
        np.arange(n) * step, np.full(n, speed), np.full(n, load), np.full(n, ambient)
    )


def _staircase() -> OperatingProfile:
    speed = np.append(np.repeat(STAIRCASE, 90), STAIRCASE[-1])
    return OperatingProfile(
        np.arange(541) * 60.0, speed, np.full(541, 2650.0), np.full(541, AMBIENT)
    )


def _radau(model: ThermalModel, values: np.ndarray) -> np.ndarray:
    """Reference solution of the staircase; exact restarts at the steps."""
    capacity = kernels.bind_network(model.compiled, values)[0]
    rows = [COLD]
    turned = 0.0
    for speed in STAIRCASE:

        def rate(
            t: float, state: np.ndarray, speed: float = speed, turned: float = turned
        ) -> np.ndarray:
            revolutions = turned + speed * t / 60.0
            net, _ = heat_balance_w(model, values, state, speed, 2650.0, AMBIENT, revolutions)
            return net / capacity

        solution = solve_ivp(
            rate,
            (0.0, 5400.0),
            rows[-1],
            method="Radau",
            rtol=1e-8,
            atol=1e-8,
            t_eval=np.arange(1, 91) * 60.0,
        )
        rows.extend(solution.y.T)
        turned += speed * 90.0
    return np.array(rows)


@pytest.mark.parametrize(
    ("name", "values"), [("paper", None), ("paper", PAPER_P1), ("default", None)]
)
def test_staircase_against_radau(name: str, values: np.ndarray | None) -> None:
    model = build_model(name, bearing=bearing("6311"))
    vector = model.parameters.centre if values is None else values
    simulated = simulate(model, vector, _staircase(), COLD).temperatures_c
    error = simulated - _radau(model, vector)
    assert np.abs(error @ model.sensor_matrix(model.sensor_names).T).max() < 0.004
    assert np.abs(error).max() < 0.01


def test_the_papers_parameters_give_its_order_of_temperatures(paper: ThermalModel) -> None:
    """Inner ring hottest, sleeves next, bench coldest; 58 / 53 degC after the last stage."""
    end = simulate(paper, PAPER_P1, _staircase(), COLD).temperatures_c[-1]
    inner, outer = paper.sensor_matrix(paper.sensor_names) @ end
    assert inner == pytest.approx(57.9, abs=1.0)
    assert outer == pytest.approx(52.6, abs=1.0)
    assert end[3] == end.max()
    assert end[12] == end.min()
    assert end[9] > end[0]


def test_reference_vector_of_a_light_oil(paper: ThermalModel) -> None:
    """Levels of an independent implementation of this network: 33.8 ... 68.3 and 26.0 ... 45.6."""
    values = paper.parameters.centre.copy()
    values[0] = 0.7
    path = simulate(paper, values, _staircase(), COLD).temperatures_c
    sensors = path[[90, 540]] @ paper.sensor_matrix(paper.sensor_names).T
    assert sensors[0] == pytest.approx([33.8, 26.0], abs=0.6)
    assert sensors[1] == pytest.approx([68.3, 45.6], abs=0.6)


@pytest.mark.parametrize("designation", ["6311", "6016"])
@pytest.mark.parametrize("name", ["default", "paper"])
def test_a_twin_without_identification_is_plausible(name: str, designation: str) -> None:
    model = build_model(name, bearing=bearing(designation))
    previous = np.array([AMBIENT, AMBIENT])
    for speed in (1500.0, 3000.0, 4500.0, 6200.0):
        light, heavy = (
            model.sensor_matrix(model.sensor_names)
            @ steady_state(model, model.parameters.centre, speed, load, AMBIENT, 1e9)
            for load in (2650.0, 5500.0)
        )
        assert 30.0 < light[0] < 75.0
        assert 25.0 < light[1] < light[0]
        assert (light > previous).all()
        assert (heavy > light + 1.0).all()
        assert heavy[0] < 95.0
        previous = light


@pytest.mark.parametrize("name", ["default", "paper"])
def test_steady_balance_closes(name: str) -> None:
    model = build_model(name, bearing=bearing("6016"))
    rng = np.random.default_rng(3)
    for z in (np.zeros(model.parameters.size), *rng.normal(size=(5, model.parameters.size))):
        values = model.parameters.values_from_z(z)
        state = steady_state(model, values, 5800.0, 4000.0, 20.0, 1e5)
        net, friction = heat_balance_w(model, values, state, 5800.0, 4000.0, 20.0, 1e5)
        assert np.abs(net).max() < 1e-6
        assert friction > 10.0


def test_all_friction_heat_leaves_to_the_ambient(paper: ThermalModel) -> None:
    values = paper.parameters.centre
    state = steady_state(paper, values, 3000.0, 2650.0, AMBIENT)
    _, friction = heat_balance_w(paper, values, state, 3000.0, 2650.0, AMBIENT)
    _, coefficient, _, _ = kernels.bind_network(paper.compiled, values)
    none = paper.compiled.inputs
    _, to_ambient = kernels.conductance_matrix(paper.compiled, coefficient, 3000.0, 2650.0, none)
    assert to_ambient[0] @ (state - AMBIENT) == pytest.approx(friction, abs=1e-6)


def test_a_long_simulation_ends_in_the_steady_state(default: ThermalModel) -> None:
    values = default.parameters.centre.copy()
    values[default.parameters.index("A")] = 1e-9
    end = simulate(default, values, _constant(2, 4200.0, step=60 * 3600.0), COLD).temperatures_c[-1]
    assert end == pytest.approx(steady_state(default, values, 4200.0, 2650.0, AMBIENT), abs=1e-3)


def test_without_heat_the_hold_is_exact_whatever_the_rows(paper: ThermalModel) -> None:
    values = paper.parameters.centre
    start = AMBIENT + np.random.default_rng(4).uniform(0.0, 50.0, 13)
    time = np.array([0.0, 1.0, 47.5, 60.0, 600.0, 601.0, 5000.0])
    profile = OperatingProfile(time, np.zeros(7), np.full(7, 2650.0), np.full(7, AMBIENT))
    path = simulate(paper, values, profile, start).temperatures_c
    capacity, coefficient, _, _ = kernels.bind_network(paper.compiled, values)
    none = paper.compiled.inputs
    matrix, _ = kernels.conductance_matrix(paper.compiled, coefficient, 0.0, 2650.0, none)
    for moment, row in zip(time, path, strict=True):
        exact = AMBIENT + expm(-matrix / capacity[:, None] * moment) @ (start - AMBIENT)
        assert row == pytest.approx(exact, abs=1e-9)


def test_superposition_without_heat(paper: ThermalModel) -> None:
    rng = np.random.default_rng(5)
    first, second = rng.uniform(0.0, 30.0, (2, 13))
    profile = _constant(60, 0.0, ambient=0.0)

    def end(start: np.ndarray) -> np.ndarray:
        return simulate(paper, paper.parameters.centre, profile, start).temperatures_c[-1]

    assert end(first + 2.0 * second) == pytest.approx(end(first) + 2.0 * end(second), abs=1e-9)


def test_ambient_shifts_everything_where_nothing_depends_on_temperature(
    paper: ThermalModel,
) -> None:
    values = paper.parameters.centre
    low = simulate(paper, values, _constant(30, 0.0, ambient=0.0), np.full(13, 5.0))
    high = simulate(paper, values, _constant(30, 0.0, ambient=30.0), np.full(13, 35.0))
    assert high.temperatures_c == pytest.approx(low.temperatures_c + 30.0, abs=1e-9)


def test_rows_of_any_length_agree(default: ThermalModel) -> None:
    values = default.parameters.centre
    minutes = simulate(default, values, _constant(181, 4200.0), COLD).temperatures_c[-1]
    tens = simulate(default, values, _constant(1081, 4200.0, step=10.0), COLD).temperatures_c[-1]
    once = simulate(default, values, _constant(2, 4200.0, step=10800.0), COLD).temperatures_c[-1]
    assert tens == pytest.approx(minutes, abs=2e-3)
    assert once == pytest.approx(minutes, abs=1e-9)


def test_sense_of_rotation_and_sign_of_load_noise_do_not_matter(default: ThermalModel) -> None:
    values = default.parameters.centre
    ahead = simulate(default, values, _constant(10, 3000.0, 0.0), COLD).temperatures_c
    back = simulate(default, values, _constant(10, -3000.0, -5.0), COLD).temperatures_c
    assert back.tolist() == ahead.tolist()


def test_running_in_cools_down_with_the_revolutions(default: ThermalModel) -> None:
    values = default.parameters.centre.copy()
    values[default.parameters.index("A")] = 0.5
    profile = _constant(601, 5600.0)
    inner = default.sensor_row("t_inner_ring_c")
    fresh = simulate(default, values, profile, COLD)
    settled = simulate(default, values, profile, COLD, revolutions=1e9)
    rise = (fresh.temperatures_c - settled.temperatures_c) @ inner
    assert rise[120] > 5.0
    assert 0.0 < rise[-1] < 1.0
    assert fresh.revolutions[-1] == 600 * 5600.0
    assert (fresh.temperatures_c @ inner).argmax() < 300  # the early peak of fresh grease
    held = [
        inner @ steady_state(default, values, 5600.0, 2650.0, AMBIENT, turns)
        for turns in (0.0, 1e6, 1e9)
    ]
    assert held[0] > held[1] > held[2]


@pytest.mark.parametrize("name", ["default", "paper"])
@pytest.mark.parametrize(("speed", "load"), [(0.0, 0.0), (0.0, 2650.0), (1e-6, 0.0), (3.0, 10.0)])
def test_a_standing_or_creeping_machine_cools_down(name: str, speed: float, load: float) -> None:
    model = build_model(name, bearing=bearing("6311"))
    warm = steady_state(model, model.parameters.centre, 6000.0, 2650.0, AMBIENT)
    path = simulate(model, model.parameters.centre, _constant(3000, speed, load), warm)
    inner, outer = (path.temperatures_c @ model.sensor_matrix(model.sensor_names).T).T
    assert np.isfinite(path.temperatures_c).all()
    assert (np.diff(inner[1:]) < 1e-9).all()
    assert inner[-1] == pytest.approx(AMBIENT, abs=0.6)
    assert outer[-1] == pytest.approx(AMBIENT, abs=0.6)
    rest = steady_state(model, model.parameters.centre, speed, load, AMBIENT)
    assert rest == pytest.approx(AMBIENT, abs=0.15)


@pytest.mark.parametrize("name", ["default", "paper"])
def test_batch_equals_single_to_the_last_bit(name: str) -> None:
    model = build_model(name, bearing=bearing("6311"))
    rng = np.random.default_rng(6)
    values = model.parameters.values_from_z(rng.normal(size=(41, model.parameters.size)))
    starts = AMBIENT + rng.uniform(0.0, 20.0, (41, 13))
    turned = rng.uniform(0.0, 1e6, 41)
    profile = _staircase()
    batch = simulate_batch(model, values, profile, starts, turned)
    assert batch.shape == (41, 541, 13)
    for member in range(41):
        single = simulate(model, values[member], profile, starts[member], turned[member])
        assert np.array_equal(batch[member], single.temperatures_c)


def test_each_member_of_a_batch_has_its_own_disturbance(default: ThermalModel) -> None:
    values = np.tile(default.parameters.centre, (3, 1))
    heats = np.zeros((3, 13))
    heats[1, 3], heats[2, 6] = 20.0, -5.0
    together = simulate_batch(default, values, _constant(30, 3000.0), COLD, disturbance_w=heats)
    for member, heat in enumerate(heats):
        alone = simulate_batch(default, values[:1], _constant(30, 3000.0), COLD, disturbance_w=heat)
        np.testing.assert_array_equal(together[member], alone[0])
    assert together[1, -1, 3] > together[0, -1, 3] + 1.0 > together[2, -1, 3]


def test_concurrent_batches_are_safe_and_equal(default: ThermalModel) -> None:
    rng = np.random.default_rng(7)
    values = default.parameters.values_from_z(rng.normal(size=(24, default.parameters.size)))
    profile = _staircase()
    expected = simulate_batch(default, values, profile, COLD)
    with ThreadPoolExecutor(6) as pool:
        for result in pool.map(lambda _: simulate_batch(default, values, profile, COLD), range(24)):
            assert np.array_equal(result, expected)


def test_a_broken_candidate_costs_only_itself(default: ThermalModel) -> None:
    values = np.repeat(default.parameters.centre[None], 4, axis=0)
    values[1, default.parameters.index("Rc")] = np.nan
    values[2, default.parameters.index("Cs")] = -1.0
    batch = simulate_batch(default, values, _staircase(), COLD)
    assert np.isnan(batch[1]).all()
    assert np.isnan(batch[2]).all()
    assert np.array_equal(batch[0], batch[3])
    assert np.isfinite(batch[0]).all()
    with pytest.raises(SimulationError, match="ran away before time_s = 60 at 1500 rpm"):
        simulate(default, values[1], _staircase(), COLD)


def test_advancing_gives_what_simulating_two_rows_gives(default: ThermalModel) -> None:
    values = default.parameters.centre
    temperatures, turned = np.full(len(default.node_names), 30.0), 5e4
    for speed_rpm, load_n, duration_s in ((2400.0, 2650.0, 1.0), (-900.0, -5.0, 150.0)):
        rows = (np.array([0.0, duration_s]), *(np.full(2, x) for x in (speed_rpm, load_n, 22.0)))
        path = simulate(default, values, OperatingProfile(*rows), temperatures, turned)
        # Next to others: one that runs away, and one whose point is not finite.
        point, hot = Point(speed_rpm, load_n, 22.0), np.full(temperatures.shape, 1e6)
        points = [point, point, Point(np.nan, 1.0, 1.0)]
        starts, turns = [temperatures, hot, temperatures], [turned, 0.0, 0.0]
        ends, after = advance(default, [values] * 3, points, [duration_s] * 3, starts, turns)
        temperatures, turned = ends[0], float(after[0])
        np.testing.assert_array_equal(temperatures, path.temperatures_c[-1])
        assert turned == path.revolutions[-1]
        assert np.isnan(ends[1:]).all()
    with pytest.raises(ValueError, match="one per state node"):
        advance(default, [values], [point], [1.0], [hot[1:]], [0.0])
    other = Point(1.0, 1.0, 1.0, (1.0,))
    with pytest.raises(ValueError, match="inputs has 1 columns"):
        advance(default, [values], [other], [1.0], [temperatures], [0.0])


def test_a_run_away_candidate_is_named(default: ThermalModel) -> None:
    """No path for the heat: the house insulated, joints and shaft a hundred million times worse."""
    values = default.parameters.centre.copy()
    for name, value in (("M0", 100.0), ("Rj", 1e8), ("Rs", 1e8)):
        values[default.parameters.index(name)] = value
    with pytest.raises(SimulationError, match="ran away"):
        simulate(default, values, _constant(300, 6000.0), COLD)
    assert np.isnan(simulate_batch(default, values[None], _constant(300, 6000.0), COLD)).all()
    with pytest.raises(SimulationError, match="no steady state at 6000 rpm and 2650 N"):
        steady_state(default, values, 6000.0, 2650.0, AMBIENT)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda m: simulate(m, [1.0], _constant(2, 1.0), COLD),
            r"values has shape \(1,\), expected \(24,\)",
        ),
        (
            lambda m: simulate_batch(m, m.parameters.centre, _constant(2, 1.0), COLD),
            r"values has shape \(24,\), expected \(B, 24\)",
        ),
        (
            lambda m: simulate(m, m.parameters.centre, _constant(2, 1.0), COLD[:4]),
            r"initial_temperatures_c has shape \(4,\), expected \(13,\)",
        ),
        (
            lambda m: simulate(m, m.parameters.centre, _constant(2, 1.0), COLD * np.nan),
            "expected finite numbers",
        ),
        (
            lambda m: simulate_batch(
                m, m.parameters.centre[None], _constant(2, 1.0), np.zeros((3, 13))
            ),
            r"initial_temperatures_c has shape \(3, 13\), expected \(13,\) or \(1, 13\)",
        ),
        (
            lambda m: simulate_batch(
                m, m.parameters.centre[None], _constant(2, 1.0), COLD, np.zeros(2)
            ),
            r"revolutions has shape \(2,\)",
        ),
        (lambda m: m.sensor_row("t_house_c"), "unknown sensor 't_house_c', expected one of t_inn"),
    ],
)
def test_wrong_arguments_are_named(
    default: ThermalModel, call: Callable[[ThermalModel], object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        call(default)


def test_unknown_model() -> None:
    with pytest.raises(ValueError, match="'fast', expected one of default, paper, paper-reduced"):
        build_model("fast", bearing=bearing("6311"))


def test_a_single_row_is_its_initial_state(default: ThermalModel) -> None:
    path = simulate(default, default.parameters.centre, _constant(1, 3000.0), COLD)
    assert path.temperatures_c.tolist() == [COLD.tolist()]


def test_kernels_compile_where_no_cache_folder_exists() -> None:
    """A function without a source file cannot be cached, as on a read-only installation."""
    scope: dict[str, Callable[[float], float]] = {}
    exec("def twice(x):\n    return 2.0 * x\n", scope)
    assert compiled(scope["twice"])(21.0) == 42.0
