"""The friction laws: their coefficients for a network's heat source, and the heat itself.

``PALMGREN`` (Wang et al., Appl. Sci. 2025, 15(12), 6671, equations (1) to (4), restored)
    M = M_f + M_v in N.mm with M_f = f1 F dm, f1 = 0.0009 (F / C0)^0.55 and
    M_v = 1e-7 f2 (nu n)^(2/3) dm^3 for nu n >= 2000, else 160e-7 f2 dm^3;
    valid only with nu in mm2/s, n in rpm, dm in mm, F and C0 in N.
    nu = nu0 exp(-beta (T - T0)). f2 and nu0 enter only as f2 nu0^(2/3): f2 belongs to an oil.
``TWO_PART``
    M = M0 [(1 - s) exp(p L + p2 L^2 + (q + pq L) V + b Y) + s exp(c Y)] (1 + A exp(-rev / Nr)),
    L = ln(n / 3000 rpm), Y = ln(F / 2650 N), V = ln(nu / nu(60 degC)) of a Vogel oil,
    989 / (T + 95) - 989 / 155; the last factor is the running-in of the grease. Both Palmgren's
    and the SKF catalogue law are of this form: a rolling or viscous part that follows speed and
    viscosity, and a load-dependent or sliding part of share s that does not. The form carries what
    a single product of powers cannot: under heavy load friction grows faster with load and falls
    less with temperature, both by the same share.

Heat W = M 2 pi n / 60 in both, T the temperature of the grease-oil-air mixture.

``LINEAR``
    W = c0 n + c1 F + c2 in W, whatever the temperature: the source of the paper's simple network.
"""

import numpy as np

from twin_core.bearings import Bearing
from twin_core.materials import BaseOil
from twin_core.network import Coefficient, FrictionKind
from twin_core.simulation import kernels


def palmgren_coefficients(bearing: Bearing, oil: BaseOil) -> tuple[Coefficient, ...]:
    """Coefficients of ``PALMGREN``; binds the parameter ``f2``."""
    return (
        Coefficient(1.0, "f2"),
        Coefficient(bearing.pitch_diameter_mm),
        Coefficient(bearing.static_load_rating_n),
        Coefficient(oil.viscosity_mm2_s),
        Coefficient(oil.coefficient_per_k),
        Coefficient(oil.reference_c),
    )


def reference_moment_nmm(bearing: Bearing) -> float:
    """Moment at 3000 rpm, 2650 N and 60 degC that the prior of ``TWO_PART`` centres on.

    196 N.mm (6311) and 281 N.mm (6016) are the geometric means of Palmgren's and the SKF
    catalogue law; between and beyond they scale with dm^2.28.
    """
    return float(196.0 * (bearing.pitch_diameter_mm / 87.5) ** 2.277)


def two_part_coefficients(bearing: Bearing) -> tuple[Coefficient, ...]:
    """Coefficients of ``TWO_PART``; binds M0, p, p2, q, pq, s, b, c, A, Nr."""
    return (
        Coefficient(reference_moment_nmm(bearing), "M0"),
        *(Coefficient(1.0, name) for name in ("p", "p2", "q", "pq", "s", "b", "c", "A", "Nr")),
    )


def palmgren_moment_nmm(
    bearing: Bearing,
    oil: BaseOil,
    f2: float,
    *,
    speed_rpm: float,
    load_n: float,
    temperature_c: float,
) -> float:
    """Friction moment by Palmgren in N.mm."""
    coefficients = np.array(
        [
            coefficient.factor * (f2 if coefficient.parameter else 1.0)
            for coefficient in palmgren_coefficients(bearing, oil)
        ]
    )
    kind = int(FrictionKind.PALMGREN)
    # The kernel gives heat; a moment exists at standstill too, where M_v has its constant form.
    point = kernels.friction_at_point(kind, coefficients, max(speed_rpm, 1e-6), load_n)
    heat_w = kernels.friction_heat_w(kind, coefficients, point, temperature_c, 0.0)
    return float(heat_w / point[0])
