"""What distinguishes one virtual bench from another."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from adapters.virtual_bench.bearings import BEARINGS

FrictionLaw = Literal["skf", "palmgren"]

# Levels differ between the two bearings by more than catalogue data explain (grease fill, fits):
# friction scale and mounted clearance were set per bearing, see docs/start/virtual-bench.md.
_MOUNTED: Mapping[str, tuple[float, float]] = {"6311": (1.14, 42.0), "6016": (1.06, 40.0)}


@dataclass(frozen=True, slots=True)
class BenchParameters:
    """Hidden truth of one bench."""

    bearing: str = "6311"  # name in `BEARINGS`
    #: Mean air temperature in degC and the amplitude of its slow swing in K.
    ambient_c: float = 22.6
    ambient_swing_k: float = 0.4
    #: Kinematic viscosity of the grease's base oil at 40 and 100 degC in mm2/s.
    oil_40_mm2_s: float = 96.0
    oil_100_mm2_s: float = 10.5
    #: Factors on the whole frictional moment and on its two parts.
    friction_scale: float = 1.14
    rolling_scale: float = 1.0
    sliding_scale: float = 1.0
    #: ``"skf"``, or ``"palmgren"``: a viscous moment that does not depend on the load, and one that
    #: depends on the load alone, instead of the rolling and the sliding moment.
    friction_law: FrictionLaw = "skf"
    #: Exponent of the load in the rolling frictional moment (SKF: 0.54); of Palmgren's law 0.
    rolling_load_exponent: float = 0.54
    replenishment_constant: float = 6.0e-8  # K_rs of the SKF starvation factor (grease: 6e-8)
    #: Cap of the viscosity inside the starvation factor: a cold greased bearing is not starved.
    replenishment_viscosity_mm2_s: float = 35.0
    #: Shares of the friction heat made at the inner contact; of a contact's heat that enters the
    #: ball; of the rolling friction that is spent in the grease itself.
    inner_share: float = 0.55
    ball_share: float = 0.5
    mixture_share: float = 0.25
    #: Calibrated factors on the conductance of the rolling contacts, of the films between grease
    #: and metal, of the rotating shaft to air and of natural convection outside.
    contact_scale: float = 0.30
    film_scale: float = 0.20
    shaft_scale: float = 0.30
    outside_scale: float = 0.52
    emissivity: float = 0.9  # emissivity of the outer surfaces
    #: Factors on the conductance of housing and shaft joints and on all heat capacities.
    joint_scale: float = 1.0
    shaft_joint_scale: float = 1.0
    capacity_scale: float = 1.0
    #: Radial clearance as made (diametral, micrometres) and what the interference fits take.
    clearance_um: float = 42.0
    fit_um: float = 10.0
    #: How much of the extra rolling-element load of a shrinking clearance counts as friction load.
    preload_share: float = 0.85
    #: Rolling friction is multiplied by 1 + amplitude * state; the state decays by 1/e over the
    #: given number of revolutions.
    run_in_amplitude: float = 1.2
    run_in_state: float = 0.1
    run_in_revolutions: float = 1.08e6
    load_play_n: float = 20.0  # half width of the hysteresis of the hydraulic loading in newtons
    #: Hours at 60 degC in which the grease loses all its oil at an oil loss of 1; half as many 15 K
    #: above. Scenarios of hours run without oil loss.
    grease_life_h: float = 3000.0
    thickening: float = 0.35  # relative rise of the viscosity of what is left when all oil is gone

    def __post_init__(self) -> None:
        if self.bearing not in BEARINGS:
            known = ", ".join(BEARINGS)
            raise ValueError(f"bearing {self.bearing!r}: the virtual bench knows {known}")

    @classmethod
    def for_bearing(cls, bearing: str) -> "BenchParameters":
        """Calibrated default bench with a bearing. Raises `ValueError` if it has none such."""
        friction_scale, clearance_um = _MOUNTED.get(bearing, (1.0, 0.0))
        return cls(bearing=bearing, friction_scale=friction_scale, clearance_um=clearance_um)

    @classmethod
    def random(cls, seed: int, bearing: str = "6311") -> "BenchParameters":
        """Draw a plausible other bench: same construction, other oil, fits, joints and air.

        A few per cent of these benches run away thermally at 6200 rpm and 5500 N; who scores
        forecasts has to look at that.
        """
        rng = np.random.default_rng([seed, 0xBE7C4])
        base = cls.for_bearing(bearing)

        def spread(centre: float, log_sd: float) -> float:
            return float(centre * np.exp(rng.normal(0.0, log_sd)))

        def between(centre: float, sd: float, low: float, high: float) -> float:
            return float(np.clip(rng.normal(centre, sd), low, high))

        oil = spread(1.0, 0.2)
        return replace(
            base,
            ambient_c=between(base.ambient_c, 1.5, 18.0, 27.0),
            oil_40_mm2_s=base.oil_40_mm2_s * oil,
            oil_100_mm2_s=base.oil_100_mm2_s * oil**0.6,
            friction_scale=spread(base.friction_scale, 0.06),
            rolling_scale=spread(1.0, 0.08),
            sliding_scale=spread(1.0, 0.15),
            inner_share=between(base.inner_share, 0.03, 0.45, 0.65),
            ball_share=between(base.ball_share, 0.04, 0.4, 0.6),
            mixture_share=between(base.mixture_share, 0.06, 0.05, 0.45),
            contact_scale=spread(base.contact_scale, 0.25),
            film_scale=spread(base.film_scale, 0.25),
            shaft_scale=spread(base.shaft_scale, 0.3),
            outside_scale=spread(base.outside_scale, 0.2),
            joint_scale=spread(base.joint_scale, 0.25),
            shaft_joint_scale=spread(base.shaft_joint_scale, 0.25),
            capacity_scale=spread(base.capacity_scale, 0.05),
            clearance_um=between(base.clearance_um, 6.0, 28.0, 61.0),
            preload_share=between(0.8, 0.12, 0.4, 1.1),
            run_in_state=abs(float(rng.normal(0.0, 0.14))),
            run_in_revolutions=spread(base.run_in_revolutions, 0.4),
            load_play_n=spread(base.load_play_n, 0.3),
            grease_life_h=spread(base.grease_life_h, 0.3),
            thickening=spread(base.thickening, 0.3),
        )
