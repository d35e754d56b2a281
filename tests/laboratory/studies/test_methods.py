"""The optimisers on the paper's inverse problem, from few seeds."""

import pytest

from bearing_twin_laboratory.studies.inverse import CountedSearch, simple_network_problem
from bearing_twin_laboratory.studies.methods import METHODS, run

pytestmark = pytest.mark.laboratory


def _search(method: str, seed: int, budget: int | None = None) -> CountedSearch:
    search = CountedSearch(simple_network_problem(), budget or METHODS[method].budget)
    run(METHODS[method], search, seed)
    return search


@pytest.mark.parametrize("seed", [0, 1, 20, 21, 22, 23])
def test_the_default_method_takes_at_most_800_simulations(seed: int) -> None:
    search = _search("noa+refine", seed)
    assert search.reached is not None
    assert search.reached <= 800


def test_noa_alone_takes_at_most_30_000() -> None:
    search = _search("noa", 0)
    assert search.reached is not None
    assert search.reached <= 30_000


@pytest.mark.parametrize(("method", "most"), [("trf", 600), ("cma-es", 10_000), ("de", 15_000)])
def test_baselines_are_as_good_as_their_libraries(method: str, most: int) -> None:
    """A baseline that is set up badly would flatter NOA."""
    search = _search(method, 0)
    assert search.reached is not None
    assert search.reached <= most


def test_particle_swarm_improves_far_beyond_its_first_swarm() -> None:
    search = _search("pso", 0, budget=5_000)
    assert search.evaluations == 5_000
    first = search.problem.residuals_of(search.trace[0].values)
    last = search.problem.residuals_of(search.trace[-1].values)
    assert (last**2).sum() < 1e-3 * (first**2).sum()


@pytest.mark.parametrize("method", METHODS)
def test_budgets_are_kept_and_seeds_decide(method: str) -> None:
    def ends(seed: int) -> list[float]:
        search = _search(method, seed, budget=130)
        assert search.evaluations <= 130
        return [float(value) for best in search.trace for value in best.values]

    assert ends(3) == ends(3)
    assert ends(3) != ends(4)
