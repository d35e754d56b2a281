"""The optimisers that are compared, all on the same interface: a unit box with costs and a budget.

Every method takes a search space and a seed and goes on until the space ends it. The baselines come
from well-kept libraries: PSO from pymoo, CMA-ES from cma, differential evolution and trust-region
least squares from scipy. ``bearing-twin identify --method`` lets each take NOA's place.
"""

from dataclasses import dataclass

import numpy as np

from service.lab.studies.inverse import FloatArray
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.searching import Search, SearchEnd, SearchSpace

NOA_POPULATION = 13
"""Of 8 to 25 tried on seeds of their own; with 8 it fails, with 25 it takes half as long again."""

NOA_BUDGET = 30_000
BASELINE_BUDGET = 100_000
EXPLORATION = 300
"""Evaluations of NOA before the refinement; as always with NOA they are its schedule too."""

PSO_PARTICLES = 25
CONSTRICTION, ATTRACTION = 0.7298, 1.49618
DE_MEMBERS_PER_DIMENSION = 5
CMA_SPREAD = 0.3


@dataclass(frozen=True, slots=True)
class Method:
    """A method with the budget and settings that it is compared at.

    Parameters
    ----------
    search
        Goes on until the space raises `SearchEnd`, or returns early when nothing is left to do.
    budget
        Simulations it may take.
    settings
        For the table.
    """

    search: Search
    budget: int
    settings: str


def run(method: Method, search: SearchSpace, seed: int) -> None:
    """Let a method search to its end."""
    try:
        method.search(search, seed)
    except SearchEnd:
        return


def noa(search: SearchSpace, seed: int) -> None:
    """Nutcracker search over the whole budget."""
    _explore(search, seed, search.budget)


def noa_then_refine(search: SearchSpace, seed: int) -> None:
    """Nutcracker search first, least squares from its best point."""
    _refine(search, _explore(search, seed, EXPLORATION))


def trust_region(search: SearchSpace, seed: int) -> None:
    """Least squares from one random point after the other."""
    rng = np.random.default_rng(seed)
    while True:
        _refine(search, rng.random(search.dimensions))


def differential_evolution(search: SearchSpace, seed: int) -> None:
    """Differential evolution as scipy has it, best1bin, generation by generation."""
    from scipy.optimize import differential_evolution as minimise

    minimise(
        lambda columns: search.costs(columns.T),
        [(0.0, 1.0)] * search.dimensions,
        popsize=DE_MEMBERS_PER_DIMENSION,
        recombination=0.9,
        maxiter=search.budget,
        tol=0.0,
        polish=False,
        rng=seed,
        updating="deferred",
        vectorized=True,
    )


def cma_es(search: SearchSpace, seed: int) -> None:
    """CMA-ES with a random first mean; restarts double the population."""
    import cma

    dimensions = search.dimensions
    rng = np.random.default_rng(seed)
    population = 4 + int(3 * np.log(dimensions))
    while True:
        evolution = cma.CMAEvolutionStrategy(
            rng.random(dimensions),
            CMA_SPREAD,
            {
                "bounds": [0.0, 1.0],
                "popsize": population,
                "seed": int(rng.integers(1, 2**31)),
                "verbose": -9,
            },
        )
        while not evolution.stop():
            points = evolution.ask()
            evolution.tell(points, search.costs(np.array(points)).tolist())
        population *= 2


def particle_swarm(search: SearchSpace, seed: int) -> None:
    """Particle swarm as pymoo has it, with its adaptive coefficients."""
    _swarm(search, seed)


def constricted_swarm(search: SearchSpace, seed: int) -> None:
    """Particle swarm with the constant coefficients of Clerc and Kennedy (2002)."""
    _swarm(
        search,
        seed,
        adaptive=False,
        w=CONSTRICTION,
        c1=ATTRACTION,
        c2=ATTRACTION,
        pertube_best=False,  # so spelled in pymoo
    )


def _swarm(search: SearchSpace, seed: int, **settings: float) -> None:
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import Problem
    from pymoo.termination import get_termination

    problem = Problem(n_var=search.dimensions, n_obj=1, xl=0.0, xu=1.0)
    swarm = PSO(pop_size=PSO_PARTICLES, **settings)
    swarm.setup(problem, termination=get_termination("n_eval", search.budget), seed=seed)
    while swarm.has_next():
        particles = swarm.ask()
        particles.set("F", search.costs(particles.get("X"))[:, None])
        swarm.tell(infills=particles)


METHODS = {
    "noa": Method(noa, NOA_BUDGET, f"released variant, N {NOA_POPULATION}, T {NOA_BUDGET}"),
    "pso": Method(
        particle_swarm,
        BASELINE_BUDGET,
        f"pymoo, {PSO_PARTICLES} particles, adaptive coefficients",
    ),
    "pso-constant": Method(
        constricted_swarm,
        BASELINE_BUDGET,
        f"pymoo, {PSO_PARTICLES} particles, constriction coefficients",
    ),
    "noa+refine": Method(
        noa_then_refine, 2_000, f"NOA N {NOA_POPULATION}, T {EXPLORATION}, then trust region"
    ),
    "trf": Method(trust_region, 10_000, "scipy least_squares, random starts, 2-point Jacobian"),
    "de": Method(
        differential_evolution,
        BASELINE_BUDGET,
        f"scipy, best1bin, {DE_MEMBERS_PER_DIMENSION} members per parameter, CR 0.9",
    ),
    "cma-es": Method(
        cma_es, BASELINE_BUDGET, f"cma, sigma {CMA_SPREAD}, population doubles at restarts"
    ),
}


def _explore(search: SearchSpace, seed: int, budget: int) -> FloatArray:
    dimensions = search.dimensions
    nutcracker = Nutcracker(
        np.zeros(dimensions),
        np.ones(dimensions),
        budget=budget,
        seed=seed,
        settings=NutcrackerSettings(population=NOA_POPULATION),
    )
    return nutcracker.minimize(search.costs)


def _refine(search: SearchSpace, start: FloatArray) -> FloatArray:
    """Bounded trust-region least squares to its end; finite differences are counted."""
    from scipy.optimize import least_squares

    found = least_squares(
        lambda unit: search.residuals(unit[None])[0], start, bounds=(0.0, 1.0), method="trf"
    )
    return np.asarray(found.x)
