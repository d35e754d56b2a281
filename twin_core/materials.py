"""Material properties (Wang et al., Appl. Sci. 2025, 15(12), 6671, table 4) and lubricants.

Table 4 prints the densities run together with their unit; they read 7810, 7750, 7810 and
8300 kg/m3. Its copper cage is brass in practice, but only density and heat capacity matter here.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Solid:
    """A solid material."""

    #: Constant over the temperatures of a bearing.
    density_kg_m3: float
    conductivity_w_mk: float
    specific_heat_j_kgk: float

    @property
    def volumetric_heat_j_m3k(self) -> float:
        """Heat capacity per volume."""
        return self.density_kg_m3 * self.specific_heat_j_kgk


RING_STEEL = Solid(7810.0, 60.5, 460.0)
BALL_STEEL = Solid(7750.0, 28.5, 502.0)
STRUCTURAL_STEEL = Solid(7810.0, 60.5, 434.0)
CAGE_METAL = Solid(8300.0, 401.0, 385.0)

GREASE_DENSITY_KG_M3 = 900.0
GREASE_SPECIFIC_HEAT_J_KGK = 1900.0
MIXTURE_CONDUCTIVITY_W_MK = 0.05
"""Effective conductivity of the grease-oil-air mixture in the bearing's cavity."""


@dataclass(frozen=True, slots=True)
class BaseOil:
    """Kinematic viscosity of a grease's base oil, nu = nu0 exp(-beta (T - T0)).

    Equation (4) of the paper; the sign of beta, lost in print, is restored.
    """

    viscosity_mm2_s: float  # nu0 at the reference temperature
    reference_c: float  # T0
    coefficient_per_k: float  # beta > 0

    def kinematic_viscosity_mm2_s(self, temperature_c: float) -> float:
        """Viscosity in mm2/s (cSt) at *temperature_c*."""
        return self.viscosity_mm2_s * math.exp(
            -self.coefficient_per_k * (temperature_c - self.reference_c)
        )


MINERAL_OIL_100 = BaseOil(297.0, 22.6, 0.0482)
"""A 100 / 10.5 mm2/s (40 / 100 degC) base oil, usual in electric-motor greases.

The exponential law meets the Walther equation of this oil at 22.6 and 80 degC.
"""


def walther_viscosity_mm2_s(
    temperature_c: float, viscosity_40_mm2_s: float, viscosity_100_mm2_s: float
) -> float:
    """Kinematic viscosity by the Walther equation (ASTM D341), lg lg (nu + 0.7) = A - B lg T.

    From the two values of a data sheet, at 40 and 100 degC.
    """
    at_40 = math.log10(math.log10(viscosity_40_mm2_s + 0.7))
    at_100 = math.log10(math.log10(viscosity_100_mm2_s + 0.7))
    t_40, t_100 = math.log10(313.15), math.log10(373.15)
    slope = (at_40 - at_100) / (t_100 - t_40)
    level = at_40 - slope * (math.log10(temperature_c + 273.15) - t_40)
    return float(10.0 ** (10.0**level) - 0.7)
