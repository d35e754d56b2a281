"""Global searches of well-kept libraries: each can take NOA's place in an identification.

PSO comes from pymoo, CMA-ES from cma, differential evolution and trust-region least squares from
scipy. Every search takes a search space and a seed and goes on until the space ends it.
"""

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.searching import Search, SearchSpace

FloatArray = NDArray[np.float64]

PSO_PARTICLES = 25
CONSTRICTION, ATTRACTION = 0.7298, 1.49618
DE_MEMBERS_PER_DIMENSION = 5
CMA_SPREAD = 0.3


def trust_region(search: SearchSpace, seed: int) -> None:
    """Least squares from one random point after the other."""
    rng = np.random.default_rng(seed)
    while True:
        refine_locally(search, rng.random(search.dimensions))


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


def refine_locally(search: SearchSpace, start: FloatArray) -> FloatArray:
    """Bounded trust-region least squares to its end; finite differences are counted."""
    from scipy.optimize import least_squares

    found = least_squares(
        lambda unit: search.residuals(unit[None])[0], start, bounds=(0.0, 1.0), method="trf"
    )
    return np.asarray(found.x)


OTHER_SEARCHES: dict[str, tuple[Search, str | None]] = {
    "pso": (particle_swarm, "pymoo"),
    "de": (differential_evolution, None),
    "cma-es": (cma_es, "cma"),
    "trf": (trust_region, None),
}
"""By the name of its method; with the library of the extra ``bench`` that it needs."""
