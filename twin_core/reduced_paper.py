"""The paper's model in the combinations of its parameters that data can separate.

Of the paper's 15 parameters two rings' temperatures inform three to five combinations: the level of
the viscous friction (f2 and the oil's viscosity only ever act together), the contact resistance
where the machine runs, the Nusselt numbers there, and how they grow with speed. Those are searched
here; the standstill terms K_i1 = 2, the cage and the exponents of load and speed in the contact
resistance stay as the correlations have them. The 15 numbers of the paper are a view on the result,
`paper_numbers`.

What the paper takes as known is freed with a tight prior: f1 (as the share of the load-dependent
friction), the exponents 2/3 of speed and viscosity, heat capacities, outer films, joints. There is
no running-in, no rotating shaft as a sink, and no load exponent to learn: what the paper leaves out
stays out. The viscosity follows a Vogel oil rather than the paper's exponential.
"""

import math

import numpy as np
from numpy.typing import NDArray

from twin_core.bearings import Bearing
from twin_core.friction import palmgren_moment_nmm
from twin_core.materials import MINERAL_OIL_100
from twin_core.network import Coefficient, EdgeKind, FrictionKind, HeatShare, HeatSource, Network
from twin_core.networks.bearing_14 import Bearing14, assemble, edge_between, node_name
from twin_core.parameters import Parameter, ParameterSet

REDUCED_NAME = "paper-reduced"

_SPEED_RPM, _LOAD_N, _LUBRICANT_C = 3000.0, 2650.0, 60.0
_F2 = 0.45
_PALMGREN_EXPONENT, _LOAD_EXPONENT = 2.0 / 3.0, 1.55
_LARGEST_SHARE = 0.7
_NUSSELT_AT_REST = 2.0
_CAGE_FACTOR, _CAGE_EXPONENT = 0.76, 0.50

_FILMS = ((1, 14), (8, 14), (9, 14), (13, 14))
_SHAFT_ENDS = ((5, 14), (12, 14))
_JOINTS = ((1, 2), (1, 8), (1, 9), (2, 8), (2, 9), (1, 13))
_SHAFT_JOINTS = ((4, 5), (4, 12), (4, 10), (4, 11), (5, 10), (11, 12))


def reduced_parameters(bearing: Bearing) -> ParameterSet:
    """Priors of the combinations, then of what the paper takes as known.

    The share of the load-dependent friction centres on Palmgren's f1 for the bearing.
    """
    share = _load_share(bearing)
    return ParameterSet(
        (
            Parameter(
                "M0", "-", "friction moment relative to Palmgren's with f2 = 0.45", "log", 1.0, 0.5
            ),
            Parameter(
                "Rc",
                "K/W",
                "contact resistance of all balls to one ring at 2650 N, 3000 rpm",
                "log",
                0.40,
                0.7,
            ),
            Parameter("Nub", "-", "Nusselt number of the balls at 3000 rpm", "log", 100.0, 0.8),
            Parameter("Nuo", "-", "Nusselt number of the outer ring at 3000 rpm", "log", 70.0, 0.8),
            Parameter("Nui", "-", "Nusselt number of the inner ring at 3000 rpm", "log", 70.0, 0.8),
            Parameter("m", "-", "Nusselt numbers: exponent of speed", "linear", 0.55, 0.1),
            Parameter(
                "s",
                "-",
                "load-dependent friction: share at the reference point",
                "log",
                share,
                0.25,
                0.0,
                0.9,
            ),
            Parameter(
                "p", "-", "viscous friction: exponent of speed", "linear", _PALMGREN_EXPONENT, 0.1
            ),
            Parameter(
                "q",
                "-",
                "viscous friction: exponent of viscosity",
                "linear",
                _PALMGREN_EXPONENT,
                0.1,
            ),
            Parameter("hext", "-", "outer film relative to 8 W/m2K", "log", 1.0, 0.25),
            Parameter("hsh", "-", "film of the shaft relative to 8 W/m2K", "log", 1.0, 0.25),
            Parameter(
                "Rj",
                "-",
                "scale of the joints around the outer ring and the house",
                "log",
                1.0,
                0.3,
            ),
            Parameter("Rs", "-", "scale of the resistances of shaft and sleeves", "log", 1.0, 0.3),
            Parameter("Cs", "-", "scale of all heat capacities", "log", 1.0, 0.08),
        )
    )


def palmgren_parts_nmm(bearing: Bearing) -> tuple[float, float]:
    """Viscous (f2 = 0.45) and load-dependent moment by Palmgren at the reference point, N.mm."""

    def moment(f2: float) -> float:
        return palmgren_moment_nmm(
            bearing,
            MINERAL_OIL_100,
            f2,
            speed_rpm=_SPEED_RPM,
            load_n=_LOAD_N,
            temperature_c=_LUBRICANT_C,
        )

    return moment(_F2) - moment(0.0), moment(0.0)


def _load_share(bearing: Bearing) -> float:
    """Palmgren's share of the load-dependent friction; bounded where 2650 N is an overload."""
    viscous, load = palmgren_parts_nmm(bearing)
    return min(load / (viscous + load), _LARGEST_SHARE)


def reduced_network(bearing: Bearing, data: Bearing14) -> Network:
    """The paper's network with its coefficients bound to `reduced_parameters`."""
    edges = []
    for pair, resistance in data.constant_k_w.items():
        if pair in _FILMS or pair in _SHAFT_ENDS:
            scale = "hext" if pair in _FILMS else "hsh"
            # A film whose exponent of the temperature difference is zero: constant.
            film = (Coefficient(1.0 / resistance, scale), Coefficient(0.0))
            edges.append(edge_between(pair, EdgeKind.FILM, *film))
        else:
            scale = "Rj" if pair in _JOINTS else "Rs" if pair in _SHAFT_JOINTS else ""
            edges.append(edge_between(pair, EdgeKind.CONSTANT, Coefficient(resistance, scale)))
    contact = (
        Coefficient(data.half_balls_k_w),
        Coefficient(0.0),
        Coefficient(math.sqrt(_LOAD_N * _SPEED_RPM), "Rc"),
    )
    edges += [edge_between(pair, EdgeKind.CONTACT, *contact) for pair in ((2, 3), (3, 4))]
    cage = _NUSSELT_AT_REST + _CAGE_FACTOR * _SPEED_RPM**_CAGE_EXPONENT
    for pair, nusselt, exponent in (
        ((3, 7), Coefficient(1.0, "Nub"), Coefficient(1.0, "m")),
        ((2, 7), Coefficient(1.0, "Nuo"), Coefficient(1.0, "m")),
        ((4, 7), Coefficient(1.0, "Nui"), Coefficient(1.0, "m")),
        ((6, 7), Coefficient(cage), Coefficient(_CAGE_EXPONENT)),
    ):
        convection = Coefficient(data.convection_k_w[pair]), Coefficient(_NUSSELT_AT_REST)
        edges.append(
            edge_between(pair, EdgeKind.CONVECTIVE_REFERENCE, *convection, nusselt, exponent)
        )
    source = HeatSource(
        FrictionKind.TWO_PART,
        (
            Coefficient(palmgren_parts_nmm(bearing)[0] / (1.0 - _load_share(bearing)), "M0"),
            Coefficient(1.0, "p"),
            Coefficient(0.0),
            Coefficient(1.0, "q"),
            Coefficient(0.0),
            Coefficient(1.0, "s"),
            Coefficient(0.0),
            Coefficient(_LOAD_EXPONENT),
            Coefficient(0.0),  # no running-in
            Coefficient(1.0),
        ),
        node_name(7),
        # outer ring : balls : inner ring = 1 : 2 : 1
        (
            HeatShare(node_name(3), Coefficient(0.5)),
            HeatShare(node_name(4), Coefficient(0.5)),
            HeatShare(node_name(2), Coefficient(1.0)),
        ),
    )
    return assemble("bearing-14, paper reduced", data, tuple(edges), source, "Cs")


def paper_numbers(
    parameters: ParameterSet, values: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """The 15 numbers of the paper that a reduced parameter vector stands for.

    `values` (..., p) in physical units. Returns by the paper's names, each (...,). f2 belongs to a
    100 mm2/s base oil and holds at 3000 rpm and 60 degC.
    """
    values = np.asarray(values, dtype=np.float64)
    one = {name: values[..., k] for k, name in enumerate(parameters.names)}
    share = parameters.centre[parameters.index("s")]
    full = np.ones(values.shape[:-1])
    numbers = {
        "f2": _F2 * one["M0"] * (1.0 - one["s"]) / (1.0 - share),
        "Kc1": 0.0 * full,
        "Kc2": one["Rc"] * math.sqrt(_LOAD_N * _SPEED_RPM),
    }
    for number, nusselt in enumerate(("Nub", "Nuo", "Nui"), start=1):
        numbers[f"K{number}1"] = _NUSSELT_AT_REST * full
        numbers[f"K{number}2"] = (one[nusselt] - _NUSSELT_AT_REST) / _SPEED_RPM ** one["m"]
        numbers[f"K{number}3"] = one["m"]
    numbers |= {
        "K41": _NUSSELT_AT_REST * full,
        "K42": _CAGE_FACTOR * full,
        "K43": _CAGE_EXPONENT * full,
    }
    return numbers
