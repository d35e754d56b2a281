"""What is known about a model's parameters after (or before) an identification."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin_core.identification.family import SisterKnowledge
from twin_core.identification.identifiability import (
    Identifiability,
    Verdict,
    identifiability,
    of_covariance,
    verdict,
)
from twin_core.identification.problem import SENSOR_LAG_S, IdentificationProblem
from twin_core.identification.sampling import posterior_samples
from twin_core.models import ThermalModel
from twin_core.operating_points import NEW_LOAD, NEW_SPEED, OperatingSpan, taught_values

FloatArray = NDArray[np.float64]

# As near to a bound as this, in standard deviations of the prior, a parameter lies on it.
_ON_BOUND_Z = 0.02


@dataclass(frozen=True, slots=True)
class TrainedRange:
    """Which operation a posterior was identified from."""

    operating_points: tuple[OperatingSpan, ...] = ()  # in time order
    minutes: int = 0  # number of rows
    from_rest: bool = False  # whether any window began on a machine at standstill
    revolutions: float = 0.0  # revolutions since the grease was fresh, at the first row
    ambient_c: float | None = None  # mean ambient temperature in degC; None where it is not known
    #: Where the machine ran while it was held nowhere; see `twin_core.operating_points`.
    duty: tuple[OperatingSpan, ...] = ()
    #: What the size of an input that drives a loss exceeds in one row of twenty, by name.
    drives: Mapping[str, float] = field(default_factory=dict)

    @property
    def points(self) -> tuple[OperatingSpan, ...]:
        """Where the machine ran: operating points and varying duty."""
        return (*self.operating_points, *self.duty)

    @property
    def speed_rpm_max(self) -> float:
        """Highest speed, 0 without any."""
        return max((point.speed_rpm for point in self.points), default=0.0)

    @property
    def load_n_max(self) -> float:
        """Highest load, 0 without any."""
        return max((point.load_n for point in self.points), default=0.0)

    @property
    def distinct_loads(self) -> int:
        """Number of loads that differ by more than 8 % and lasted 20 minutes.

        In one go each; on a machine whose duty varies, in all.
        """
        return len(taught_values(self.operating_points, self.duty, "load_n", NEW_LOAD))

    @property
    def distinct_speeds(self) -> int:
        """Number of speeds that differ by more than 10 % and lasted 20 minutes, also."""
        return len(taught_values(self.operating_points, self.duty, "speed_rpm", NEW_SPEED))


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """What is known of a model's standard coordinates, and where it comes from."""

    #: Which model it belongs to; *bearing* names its machine.
    model_name: str
    bearing: str
    z: FloatArray  # (p,) most probable standard coordinates
    covariance: FloatArray  # (p, p) Laplace approximation around them
    #: (k, p) samples of the posterior, which follow it better than the Laplace approximation where
    #: that matters: in forecasts. k is 0 before any identification; the prior is normal.
    samples: FloatArray
    sensor_lag_s: float  # lag of the temperature sensors in s
    train_rms_k: Mapping[str, float]  # root mean square error in the training data per sensor, K
    cost_per_residual: float  # mean squared whitened residual; about 1 or less for a good fit
    #: Of the whitened sensitivities, lag and initial states eliminated; see `Identifiability`. 0
    #: and 1 before any identification.
    rank: int
    condition: float
    informed_combinations: int  # parameter combinations with the verdict ``"informed"``
    trained: TrainedRange  # the data
    evaluations: int  # simulations of the data set that the identification took
    #: Whose posteriors the prior was made of; None for the literature's prior.
    sisters: SisterKnowledge | None = None

    @property
    def known_load_n(self) -> float:
        """Heaviest load in N that the machine, or at least half of its sisters, has seen."""
        return max(self.trained.load_n_max, self.sisters.usual_load_n if self.sisters else 0.0)

    @property
    def identified(self) -> bool:
        """Whether any data went into it."""
        return self.trained.minutes > 0

    @property
    def std(self) -> FloatArray:
        """(p,) standard deviations of the standard coordinates; 1 is the literature's prior's."""
        return np.sqrt(np.diag(self.covariance))

    def verdicts(self) -> list[Verdict]:
        """What data and sisters say of each parameter, by posterior over literature's deviation."""
        return [verdict(float(ratio)) for ratio in self.std]

    def at_bound(self, model: ThermalModel) -> list[Literal["lower", "upper"] | None]:
        """Which bound of its range each parameter lies on, as a rule none.

        Such a value is the bound's, whatever the verdict says: the data would have it further out.
        """
        low = self.z <= model.parameters.z_lower + _ON_BOUND_Z
        high = self.z >= model.parameters.z_upper - _ON_BOUND_Z
        return [
            "lower" if lower else "upper" if upper else None
            for lower, upper in zip(low, high, strict=True)
        ]

    def identifiability(self, model: ThermalModel) -> Identifiability:
        """Return the combinations of parameters that the data inform, and those they do not.

        Raises `ValueError` if the model is another one.
        """
        self.check(model)
        return of_covariance(model.parameters.names, self.covariance)

    def identifiability_document(self, model: ThermalModel) -> dict[str, Any]:
        """Return `identifiability` as plain JSON types, with rank and condition as measured."""
        document = self.identifiability(model).to_dict()
        return document | {"rank": self.rank, "condition": self.condition}

    def parameters(self, model: ThermalModel) -> dict[str, dict[str, Any]]:
        """Return value, unit, 95 % interval, verdict and informed share of every parameter.

        The informed share is how much of the literature's variance the data, and the sisters if
        there are any, have taken away, 0 to 1.
        ``at_bound`` is ``"lower"`` or ``"upper"`` where the value lies on a bound, else None.

        Raises `ValueError` if the model is another one.
        """
        self.check(model)
        half = 1.959964 * self.std
        shares = np.clip(1.0 - self.std**2, 0.0, 1.0)
        value = model.parameters.values_from_z(self.z)
        low = model.parameters.values_from_z(self.z - half)
        high = model.parameters.values_from_z(self.z + half)
        return {
            parameter.name: {
                "value": float(value[k]),
                "unit": parameter.unit,
                "low": float(low[k]),
                "high": float(high[k]),
                "verdict": said,
                "at_bound": bound,
                "informed_share": float(shares[k]),
                "description": parameter.description,
            }
            for k, (parameter, said, bound) in enumerate(
                zip(
                    model.parameters.parameters,
                    self.verdicts(),
                    self.at_bound(model),
                    strict=True,
                )
            )
        }

    def check(self, model: ThermalModel) -> None:
        """Raise ValueError unless this posterior belongs to the model."""
        if (model.name, model.machine, model.parameters.size) != (
            self.model_name,
            self.bearing,
            self.z.size,
        ):
            raise ValueError(
                f"posterior of model {self.model_name!r} on bearing {self.bearing!r} with "
                f"{self.z.size} parameters does not belong to model {model.name!r} on bearing "
                f"{model.machine!r} with {model.parameters.size}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {
            "model": self.model_name,
            "bearing": self.bearing,
            "z": self.z.tolist(),
            "covariance": self.covariance.tolist(),
            "samples": np.round(self.samples, 4).tolist(),
            "sensor_lag_s": self.sensor_lag_s,
            "train_rms_k": dict(self.train_rms_k),
            "cost_per_residual": self.cost_per_residual,
            "rank": self.rank,
            "condition": self.condition,
            "informed_combinations": self.informed_combinations,
            "trained": {
                "operating_points": [p.to_dict() for p in self.trained.operating_points],
                "minutes": self.trained.minutes,
                "from_rest": self.trained.from_rest,
                "revolutions": self.trained.revolutions,
                "ambient_c": self.trained.ambient_c,
                "duty": [p.to_dict() for p in self.trained.duty],
                "drives": dict(self.trained.drives),
            },
            "evaluations": self.evaluations,
        } | ({} if self.sisters is None else {"sisters": self.sisters.to_dict()})

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> "Posterior":
        """Take back what `to_dict` gave."""
        trained = document["trained"]
        return cls(
            model_name=str(document["model"]),
            bearing=str(document["bearing"]),
            z=np.array(document["z"], dtype=np.float64),
            covariance=np.array(document["covariance"], dtype=np.float64),
            samples=np.array(document["samples"], dtype=np.float64).reshape(-1, len(document["z"])),
            sensor_lag_s=float(document["sensor_lag_s"]),
            train_rms_k={name: float(rms) for name, rms in document["train_rms_k"].items()},
            cost_per_residual=float(document["cost_per_residual"]),
            rank=int(document["rank"]),
            condition=float(document["condition"]),
            informed_combinations=int(document["informed_combinations"]),
            trained=TrainedRange(
                tuple(OperatingSpan.from_dict(point) for point in trained["operating_points"]),
                int(trained["minutes"]),
                bool(trained["from_rest"]),
                float(trained["revolutions"]),
                None if trained.get("ambient_c") is None else float(trained["ambient_c"]),
                tuple(OperatingSpan.from_dict(point) for point in trained.get("duty", ())),
                {name: float(most) for name, most in trained.get("drives", {}).items()},
            ),
            evaluations=int(document["evaluations"]),
            sisters=None
            if document.get("sisters") is None
            else SisterKnowledge.from_dict(document["sisters"]),
        )


def prior_posterior(model: ThermalModel) -> Posterior:
    """Return what is known before any identification: the prior."""
    p = model.parameters.size
    return Posterior(
        model.name,
        model.machine,
        np.zeros(p),
        np.eye(p),
        np.empty((0, p)),
        SENSOR_LAG_S,
        {},
        0.0,
        0,
        1.0,
        0,
        TrainedRange(),
        0,
    )


def posterior_at(
    problem: IdentificationProblem, unknowns: FloatArray, sample_count: int = 0, seed: int = 0
) -> Posterior:
    """Describe the posterior around the optimum ``unknowns`` (d,): Laplace approximation, samples.

    `sample_count`: even, 0 for none.
    """
    p, m = problem.parameter_count, problem.measurement_count
    residuals = problem.residuals(unknowns)[0]
    informed = identifiability(problem, unknowns)
    windows = problem.data.windows
    return Posterior(
        model_name=problem.model.name,
        bearing=problem.model.machine,
        z=unknowns[:p].copy(),
        covariance=informed.covariance_with(problem.prior.factor),
        samples=posterior_samples(problem, unknowns, sample_count, seed),
        sensor_lag_s=problem.lag_s(unknowns),
        train_rms_k=problem.rms_k(unknowns),
        cost_per_residual=float(np.mean(residuals[:m] ** 2)),
        rank=informed.rank,
        condition=informed.condition,
        informed_combinations=informed.count("informed"),
        trained=TrainedRange(
            problem.data.operating_points,
            sum(int(window.minutes.good.sum()) for window in windows),
            any(window.at_rest for window in windows),
            float(windows[0].revolutions),
            _mean_ambient(problem),
            problem.data.duty,
            _drives(problem),
        ),
        evaluations=problem.evaluations,
    )


def _drives(problem: IdentificationProblem) -> dict[str, float]:
    """Size that each drive of a loss exceeds in one good row of twenty."""
    network = problem.model.network
    minutes = [window.minutes for window in problem.data.windows]
    return {
        name: float(
            np.quantile(np.abs(np.concatenate([of.inputs[name][of.good] for of in minutes])), 0.95)
        )
        for name in network.inputs
        if name not in network.boundaries
    }


def _mean_ambient(problem: IdentificationProblem) -> float:
    """Mean ambient temperature of all good rows in degC."""
    minutes = [window.minutes for window in problem.data.windows]
    return float(np.mean(np.concatenate([rows.ambient_c[rows.good] for rows in minutes])))
