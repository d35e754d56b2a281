"""What a bench truly is at a reference point, for scoring what is inferred from outside."""

from adapters.virtual_bench.bearings import BEARINGS
from adapters.virtual_bench.friction import (
    friction_constants,
    frictional_moment,
    grease_condition,
    oil_viscosity,
)
from adapters.virtual_bench.parameters import BenchParameters


def friction_moment_nmm(
    parameters: BenchParameters,
    *,
    speed_rpm: float,
    load_n: float,
    oil_temperature_c: float,
    run_in: float = 0.0,
    oil: float = 1.0,
) -> float:
    """True frictional moment of a bench in N.mm, without what thermal preload adds.

    `oil_temperature_c` is that at both contacts; `run_in`, `oil` as in `Truth`, run in and fresh.
    """
    constants = friction_constants(BEARINGS[parameters.bearing], parameters)
    thicker, dry_share = grease_condition(oil, parameters.thickening)
    viscosity = thicker * oil_viscosity(oil_temperature_c, constants.walther_a, constants.walther_b)
    rolling, sliding = frictional_moment(speed_rpm, load_n, viscosity, constants, dry_share)
    return 1e3 * float(rolling * (1.0 + parameters.run_in_amplitude * run_in) + sliding)
