"""The optimisers that are compared, all on the same interface: a unit box with costs and a budget.

Every method takes a search space and a seed and goes on until the space ends it. The baselines are
those that ``bearing-twin identify --method`` offers in NOA's place.
"""

from dataclasses import dataclass

import numpy as np

from service.offline.searches import (
    CMA_SPREAD,
    DE_MEMBERS_PER_DIMENSION,
    PSO_PARTICLES,
    FloatArray,
    cma_es,
    constricted_swarm,
    differential_evolution,
    particle_swarm,
    refine_locally,
    trust_region,
)
from twin_core.identification.noa import Nutcracker, NutcrackerSettings
from twin_core.identification.searching import Search, SearchEnd, SearchSpace

NOA_POPULATION = 13
"""Of 8 to 25 tried on seeds of their own; with 8 it fails, with 25 it takes half as long again."""

NOA_BUDGET = 30_000
BASELINE_BUDGET = 100_000
EXPLORATION = 300
"""Evaluations of NOA before the refinement; as always with NOA they are its schedule too."""


@dataclass(frozen=True, slots=True)
class Method:
    """A method with the budget and settings that it is compared at.

    - ``search``: goes on until the space raises `SearchEnd`, or returns early when nothing is left
      to do.
    - ``budget``: simulations it may take.
    - ``settings``: for the table.
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
    refine_locally(search, _explore(search, seed, EXPLORATION))


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
