"""The Nutcracker Optimization Algorithm (NOA) with ask/tell and batch evaluation.

Source: Abdel-Basset, Mohamed, Jameel, Abouhawwash, Knowledge-Based Systems 262 (2023) 110248,
doi 10.1016/j.knosys.2022.110248. Two variants, which differ where the authors' released program
and the printed equations do:

=====================  ====================================  =====================================
point                  ``released``                          ``printed``
=====================  ====================================  =====================================
exploration or storage explore where rand < P_a1 (early)     explore where rand > P_a1 (late)
recovery or search     recover where rand < P_a2 = 0.2       recover where rand > P_a2
mu of Eq. 2            two coins; uniform again for storage   r1 < r2, r2 < r3, else
storage around best    half of the coordinates               all coordinates
l of Eq. 3             rand (1 - t/T)                        1 - t/T
jump of Eq. 10         U                                     (U - L) tau + L
=====================  ====================================  =====================================

In both, t and T count objective evaluations, the initial population included, so T is the budget
and also the schedule: a run that is stopped early has not converged.

Deviation from the asynchronous original, for the sake of batch evaluation: all trials of a sweep
are built from the positions and the best point as they are when the sweep begins, and members,
best and t are brought up to date when its fitness values are told. P_a1 and the half of the budget
are nevertheless those of the member's own evaluation (t + its index in the sweep). In a sweep of
strategy II both reference points of a searching member are evaluated in the same batch. The branch
theta = pi/2 of Eqs. 9 and 10 is left out: it needs an exact floating-point hit.

Best used on log-scaled parameters in the unit box: three of the moves depend on where the
coordinate origin lies, so units matter. The caller does that scaling.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin_core.identification import noa_moves as moves
from twin_core.identification.noa_moves import FloatArray, Variant


@dataclass(frozen=True, slots=True)
class NutcrackerSettings:
    """Settings of the algorithm; the defaults are the authors'."""

    population: int = 25  # number of members N
    #: ``"released"`` (the authors' program) or ``"printed"`` (the equations as published).
    variant: Variant = "released"
    #: delta of Eq. 1: share of the coordinates with a wide jump in the second half.
    jump_probability: float = 0.05
    recovery_threshold: float = 0.2  # P_a2 of Eq. 18.
    #: P_rb of Eq. 10: share of the coordinates that the second reference point moves.
    mask_probability: float = 0.2

    def __post_init__(self) -> None:
        if self.population < 2:
            raise ValueError(f"population is {self.population}; NOA needs at least 2 members")
        if self.variant not in ("released", "printed"):
            raise ValueError(f"variant is {self.variant!r}; expected 'released' or 'printed'")


@dataclass(frozen=True, slots=True)
class _Batch:
    """Trials that wait for their fitness, and the member that each belongs to."""

    candidates: FloatArray
    owners: np.ndarray[Any, np.dtype[np.intp]]


class Nutcracker:
    """NOA as an ask/tell machine: one ``ask`` is one sweep over the population.

    A fitness that is NaN or infinite counts as the worst possible: it costs that candidate one
    evaluation and nothing else. Smaller is better.

    `lower`, `upper` (d,) finite box, lower < upper; `budget`: number of objective evaluations T, at
    least the population size. Raises `ValueError` for a box or budget that makes no sense.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        budget: int,
        seed: int = 0,
        settings: NutcrackerSettings | None = None,
    ) -> None:
        self.lower: FloatArray = np.array(lower, dtype=np.float64)
        self.upper: FloatArray = np.array(upper, dtype=np.float64)
        self.settings = settings or NutcrackerSettings()
        if self.lower.ndim != 1 or self.lower.shape != self.upper.shape:
            raise ValueError(f"lower {self.lower.shape} and upper {self.upper.shape} must be (d,)")
        if not np.all(np.isfinite(self.upper - self.lower) & (self.lower < self.upper)):
            raise ValueError("every lower bound must be finite and below its upper bound")
        if budget < self.settings.population:
            raise ValueError(
                f"budget is {budget} evaluations; expected at least the population of "
                f"{self.settings.population}"
            )
        self.budget = int(budget)
        self.evaluations = 0
        self.history: list[tuple[int, float]] = []
        self._rng = np.random.default_rng(seed)
        self._rng_before_ask = self._rng.bit_generator.state
        members, dimensions = self.settings.population, self.lower.size
        self._positions: FloatArray = np.empty((members, dimensions))
        self._fitness: FloatArray = np.full(members, np.inf)
        self._best: FloatArray = np.empty(dimensions)
        self._best_fitness = np.inf
        self._pending: _Batch | None = None

    @property
    def finished(self) -> bool:
        """Whether the budget is used up."""
        return self.evaluations >= self.budget

    @property
    def best_position(self) -> FloatArray:
        """The best point so far, (d,), a copy.

        Raises `RuntimeError` before the first fitness is known.
        """
        if self.evaluations == 0:
            raise RuntimeError("no candidate has been evaluated yet")
        return self._best.copy()

    @property
    def best_fitness(self) -> float:
        """The smallest fitness so far; infinite while every candidate failed."""
        return float(self._best_fitness)

    @property
    def positions(self) -> FloatArray:
        """The members' best positions, (N, d), a copy."""
        return self._positions.copy()

    @property
    def spread(self) -> float:
        """Largest extent of the members' best positions as a share of the box; 1 before any."""
        if self.evaluations == 0:
            return 1.0
        return float(np.max(np.ptp(self._positions, axis=0) / (self.upper - self.lower)))

    def ask(self) -> FloatArray:
        """Return the (n, d) candidates of the next sweep; the same ones until they are told.

        Empty once the budget is used up. The last sweep is cut so that it fits.
        """
        if self._pending is None:
            self._rng_before_ask = self._rng.bit_generator.state
            batch = self._next_sweep()
            left = self.budget - self.evaluations
            self._pending = _Batch(batch.candidates[:left], batch.owners[:left])
        return self._pending.candidates.copy()

    def tell(self, fitness: ArrayLike) -> None:
        """Take the (n,) fitness values of the candidates that `ask` returned, in their order.

        Raises `RuntimeError` without a preceding `ask`, `ValueError` if the number of values is
        wrong.
        """
        if self._pending is None:
            raise RuntimeError("tell() needs a preceding ask()")
        batch = self._pending
        values = np.array(fitness, dtype=np.float64)
        if values.shape != (len(batch.candidates),):
            raise ValueError(
                f"fitness has shape {values.shape}; expected ({len(batch.candidates)},)"
            )
        values[~np.isfinite(values)] = np.inf
        first = self.evaluations == 0
        for candidate, owner, value in zip(batch.candidates, batch.owners, values, strict=True):
            if first or value < self._fitness[owner]:
                self._positions[owner] = candidate
                self._fitness[owner] = value
            if (first and owner == 0) or value < self._best_fitness:
                self._best = candidate.copy()
                self._best_fitness = float(value)
        self.evaluations += len(values)
        self._pending = None
        if len(values):
            self.history.append((self.evaluations, self.best_fitness))

    def minimize(self, objective: Callable[[FloatArray], ArrayLike]) -> FloatArray:
        """Run to the end of the budget with a batch ``objective`` (n, d) -> (n,)."""
        while not self.finished:
            self.tell(objective(self.ask()))
        return self.best_position

    # ------------------------------------------------------------------ sweeps
    def _next_sweep(self) -> _Batch:
        members, dimensions = self._positions.shape
        if self.evaluations == 0:
            uniform = self._rng.random((members, dimensions))
            return _Batch(self.lower + uniform * (self.upper - self.lower), np.arange(members))
        levy = moves.levy_steps(self._rng, (members, dimensions))
        shrink = 1.0 - self.evaluations / self.budget
        if self.settings.variant == "released":
            shrink *= self._rng.random()
        rising, foraging = self._coin((2,))
        if foraging:
            return self._foraging_sweep(levy, shrink)
        return self._cache_sweep(bool(rising))

    def _foraging_sweep(self, levy: FloatArray, shrink: float) -> _Batch:
        """Strategy I: foraging and storage, one trial per member."""
        rng, variant = self._rng, self.settings.variant
        members = len(self._positions)
        clock = self.evaluations + np.arange(members)
        explore_probability = (self.budget - clock) / self.budget
        phi = rng.random(members)
        explores = phi < explore_probability if variant == "released" else phi > explore_probability
        members_uniform: FloatArray = rng.random((members,))
        members_normal: FloatArray = rng.standard_normal((members,))
        mu = moves.step_factor(
            variant,
            rng.random((members, 4)),
            members_uniform,
            members_normal,
            np.full(members, levy[0, 0]),
        )[:, None]
        others = [self._random_members() for _ in range(3)]
        foraged = self._foraged(clock, others, levy, mu)
        stored = self._stored(others, levy, mu, shrink)
        trial = np.where(explores[:, None], foraged, stored)
        return _Batch(self._repair(trial), np.arange(members))

    def _foraged(
        self,
        clock: NDArray[np.int64],
        others: list[FloatArray],
        levy: FloatArray,
        mu: FloatArray,
    ) -> FloatArray:
        """Foraging, in the first half of the budget and after it."""
        rng, (members, dimensions) = self._rng, self._positions.shape
        member_a, member_b, member_c = others
        return np.where(
            (clock <= self.budget / 2)[:, None],
            moves.forage_early(
                self._positions,
                self._positions.mean(axis=0),
                member_a,
                member_b,
                levy,
                mu,
                rng.random((members, 1)),
                self.lower,
                self.upper,
                self._coin((members, dimensions)),
            ),
            moves.forage_late(
                self._positions,
                member_a,
                member_b,
                member_c,
                mu,
                rng.random((members, 1)),
                rng.random((members, dimensions)) < self.settings.jump_probability,
                self.lower,
                self.upper,
                self._coin((members, dimensions)),
            ),
        )

    def _stored(
        self, others: list[FloatArray], levy: FloatArray, mu: FloatArray, shrink: float
    ) -> FloatArray:
        """Storage: towards the best, around it, or towards the origin."""
        rng, variant = self._rng, self.settings.variant
        members, dimensions = self._positions.shape
        member_a, member_b, _ = others
        storage_mu = rng.random((members, 1)) if variant == "released" else mu
        every = np.ones((members, dimensions), dtype=np.bool_)
        masked = self._coin((members, dimensions))
        return np.where(
            self._coin((members, 1)),
            moves.store_towards_best(
                self._positions,
                self._best,
                member_a,
                member_b,
                levy,
                storage_mu,
                rng.random((members, 1)),
            ),
            np.where(
                self._coin((members, 1)),
                moves.store_around_best(
                    self._positions,
                    self._best,
                    member_a,
                    member_b,
                    storage_mu,
                    masked if variant == "released" else every,
                ),
                moves.store_towards_origin(self._best, np.full((members, 1), shrink)),
            ),
        )

    def _cache_sweep(self, rising: bool) -> _Batch:
        """Strategy II: one trial per recovering member, both reference points of a searching one.

        The batch is in member order, with a searching member's near point first.
        """
        rng, settings = self._rng, self.settings
        members, dimensions = self._positions.shape
        alpha = moves.cache_step(self.evaluations / self.budget, self.evaluations, rising)
        reach = alpha * np.cos(np.pi * rng.random((members, 1)))
        member_a, member_b, member_c = (self._random_members() for _ in range(3))
        near = self._repair(moves.reference_point_near(self._positions, member_a, member_b, reach))
        far = self._repair(
            moves.reference_point_far(
                settings.variant,
                self._positions,
                reach,
                rng.random((members, dimensions)),
                rng.random((members, dimensions)) < settings.mask_probability,
                self.lower,
                self.upper,
            )
        )
        recovered = self._repair(
            moves.recover_cache(
                self._positions,
                self._best,
                np.where(self._coin((members, 1)), near, far),
                member_c,
                rng.random((members, dimensions)),
                rng.random((members, dimensions)),
                self._coin((members, dimensions)),
            )
        )
        phi: FloatArray = rng.random((members,))
        if settings.variant == "released":
            recovers = phi < settings.recovery_threshold
        else:
            recovers = phi > settings.recovery_threshold
        first = np.where(recovers[:, None], recovered, near)
        both = np.stack([first, far], axis=1).reshape(2 * members, dimensions)
        used = np.stack([np.ones(members, dtype=np.bool_), ~recovers], axis=1).ravel()
        return _Batch(both[used], np.repeat(np.arange(members), 2)[used])

    def _coin(self, shape: tuple[int, ...]) -> moves.BoolArray:
        return np.asarray(self._rng.random(shape) < 0.5)

    def _random_members(self) -> FloatArray:
        members = len(self._positions)
        return np.asarray(self._positions[self._rng.integers(members, size=members)])

    def _repair(self, trial: FloatArray) -> FloatArray:
        redraw = self._coin((len(trial), 1))
        return moves.repair(trial, self.lower, self.upper, redraw, self._rng.random(trial.shape))

    # ------------------------------------------------------------- save and resume
    def state_dict(self) -> dict[str, Any]:
        """Return the whole state as plain JSON types; infinite fitness values become None.

        Candidates that wait for their fitness are not part of it: the resumed run asks for the
        very same ones again.
        """
        settings = self.settings
        waiting = self._pending is not None
        return {
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "budget": self.budget,
            "settings": {
                "population": settings.population,
                "variant": settings.variant,
                "jump_probability": settings.jump_probability,
                "recovery_threshold": settings.recovery_threshold,
                "mask_probability": settings.mask_probability,
            },
            "evaluations": self.evaluations,
            "positions": self._positions.tolist() if self.evaluations else None,
            "fitness": [_finite_or_none(value) for value in self._fitness],
            "best_position": self._best.tolist() if self.evaluations else None,
            "best_fitness": _finite_or_none(self._best_fitness),
            "history": [[count, _finite_or_none(value)] for count, value in self.history],
            "generator": self._rng_before_ask if waiting else self._rng.bit_generator.state,
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> "Nutcracker":
        """Continue a run from `state_dict`, bit for bit as if it had not been interrupted."""
        run = cls(
            state["lower"],
            state["upper"],
            budget=state["budget"],
            settings=NutcrackerSettings(**state["settings"]),
        )
        run.evaluations = int(state["evaluations"])
        run._fitness = np.array([_infinite_if_none(value) for value in state["fitness"]])
        run._best_fitness = _infinite_if_none(state["best_fitness"])
        run.history = [(int(count), _infinite_if_none(value)) for count, value in state["history"]]
        if state["positions"] is not None:
            run._positions = np.array(state["positions"], dtype=np.float64)
            run._best = np.array(state["best_position"], dtype=np.float64)
        run._rng.bit_generator.state = state["generator"]
        return run


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _infinite_if_none(value: float | None) -> float:
    return np.inf if value is None else float(value)
