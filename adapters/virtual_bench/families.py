"""Families of virtual benches: other friction, other housings, other clearances.

A prior or a method that is good on one family only has learned that family. Nothing of the twin may
be chosen by looking at all of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from adapters.virtual_bench.parameters import BenchParameters, FrictionLaw

_LIGHT_LOAD_N = 2650.0


@dataclass(frozen=True, slots=True)
class BenchFamily:
    """How the benches of a family differ from those of `BenchParameters.random`."""

    friction_law: FrictionLaw = "skf"  # see `BenchParameters`
    #: Of the SKF law; the rolling moment at 2650 N stays what it is.
    rolling_load_exponent: float = 0.54
    #: Factors on random parameters, by name.
    factors: Mapping[str, float] = field(default_factory=dict)
    clearance_um: float = 0.0  # what is added to the radial clearance


FAMILIES: Mapping[str, BenchFamily] = {
    "catalogue": BenchFamily(),
    # Load-independent viscous drag; a heavy housing, a wide clearance, little air around it.
    "palmgren": BenchFamily(
        friction_law="palmgren",
        factors={
            "joint_scale": 1.4,
            "capacity_scale": 1.2,
            "film_scale": 1.3,
            "outside_scale": 0.8,
        },
        clearance_um=12.0,
    ),
    # Friction that grows faster with load than the catalogue says; a light housing, a bare shaft.
    "steep": BenchFamily(
        rolling_load_exponent=0.75,
        factors={
            "sliding_scale": 1.2,
            "joint_scale": 0.8,
            "capacity_scale": 0.85,
            "contact_scale": 1.3,
            "shaft_scale": 1.4,
        },
        clearance_um=6.0,
    ),
}


def random_bench(seed: int, bearing: str = "6311", family: str = "catalogue") -> BenchParameters:
    """Draw a plausible bench of a family. Raises `ValueError` if it or the bearing is unknown."""
    if family not in FAMILIES:
        raise ValueError(f"family {family!r}: expected one of {', '.join(FAMILIES)}")
    of = FAMILIES[family]
    bench = BenchParameters.random(seed, bearing)
    held = _LIGHT_LOAD_N ** (bench.rolling_load_exponent - of.rolling_load_exponent)
    scaled = {name: getattr(bench, name) * factor for name, factor in of.factors.items()}
    return replace(
        bench,
        friction_law=of.friction_law,
        rolling_load_exponent=of.rolling_load_exponent,
        rolling_scale=bench.rolling_scale * held,
        clearance_um=bench.clearance_um + of.clearance_um,
        **scaled,
    )
