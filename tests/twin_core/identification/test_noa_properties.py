"""What holds for every NOA run, whatever box, variant, failures and interruptions."""

import json
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.noa_moves import FloatArray


@st.composite
def set_ups(draw: st.DrawFn) -> dict[str, Any]:
    dimensions = draw(st.integers(1, 5))
    number = st.floats(-1e6, 1e6, allow_nan=False)
    lower = np.array([draw(number) for _ in range(dimensions)])
    width = np.array([draw(st.floats(1e-3, 1e6)) for _ in range(dimensions)])
    population = draw(st.integers(2, 12))
    return {
        "lower": lower,
        "upper": lower + width,
        "budget": draw(st.integers(population, 200)),
        "seed": draw(st.integers(0, 2**32)),
        "settings": NutcrackerSettings(
            population=population,
            variant=draw(st.sampled_from(("released", "printed"))),
            jump_probability=draw(st.floats(0.0, 1.0)),
            recovery_threshold=draw(st.floats(0.0, 1.0)),
            mask_probability=draw(st.floats(0.0, 1.0)),
        ),
    }


def _objective(run: Nutcracker, fails: float) -> Any:
    """A bowl whose centre is at a third of the box, and which fails in a part of it."""
    centre = run.lower + (run.upper - run.lower) / 3.0

    def fitness(points: FloatArray) -> FloatArray:
        scaled = (points - centre) / (run.upper - run.lower)
        values = np.sum(scaled**2, axis=1)
        part = np.modf(1000.0 * np.abs(scaled[:, 0]))[0]
        return np.where(part < fails, np.nan, values)

    return fitness


@given(set_up=set_ups(), fails=st.floats(0.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_budget_bounds_and_best_whatever_fails(set_up: dict[str, Any], fails: float) -> None:
    run = Nutcracker(**set_up)
    fitness = _objective(run, fails)
    seen: list[float] = []
    while not run.finished:
        points = run.ask()
        assert np.all((points >= run.lower) & (points <= run.upper))
        values = fitness(points)
        seen += [float(value) for value in values]
        run.tell(values)
        assert np.all((run.positions >= run.lower) & (run.positions <= run.upper))
    assert len(seen) == run.evaluations == run.budget
    sound = [value for value in seen if np.isfinite(value)]
    assert run.best_fitness == (min(sound) if sound else np.inf)
    if sound:
        assert fitness(run.best_position[None])[0] == run.best_fitness


@given(set_up=set_ups(), cuts=st.sets(st.integers(0, 20), max_size=6), waiting=st.booleans())
@settings(max_examples=40, deadline=None)
def test_cut_anywhere_and_resumed_it_is_the_same_run(
    set_up: dict[str, Any], cuts: set[int], waiting: bool
) -> None:
    whole, part = Nutcracker(**set_up), Nutcracker(**set_up)
    fitness = _objective(whole, 0.2)
    whole.minimize(fitness)
    sweep = 0
    while not part.finished:
        if sweep in cuts:
            if waiting:
                part.ask()  # asked, but the answer never came
            part = Nutcracker.from_state(json.loads(json.dumps(part.state_dict())))
        part.tell(fitness(part.ask()))
        sweep += 1
    assert part.state_dict() == whole.state_dict()
    assert_array_equal(part.positions, whole.positions)
