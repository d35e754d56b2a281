"""What the default model has beyond the paper's, and how each part of it is switched off."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from twin_core.network import Coefficient, Network
from twin_core.parameters import ParameterSet

SHOULDERS = "shaft_shoulders"
"""The shaft is a bar that seat and sleeve share; no parameter belongs to it."""

MODEL_OPTIONS: Mapping[str, Mapping[str, float]] = {
    "load_part": {"s": 0.0, "c": 1.0},
    "curvature": {"p2": 0.0, "pq": 0.0},
    "run_in": {"A": 0.0, "Nr": 1.0e6},
    "rotating_shaft": {"gs": 0.0},
    "heat_split": {"fm": 0.0, "ball": 0.5, "inn": 0.5},
    "outer_film": {"eext": 0.0},
    SHOULDERS: {},
}
"""Values at which the parameters of a part are held when it is left out: friction that does not
follow viscosity; curved speed law; running-in of the grease; sink of the rotating shaft; free
shares of the heat (1 : 2 : 1 without, as in the paper); film that grows with its difference; one
shaft for the heat of seat and sleeve (see `twin_core.networks.bearing_14.with_shoulders`)."""


def held_at(without: Collection[str]) -> dict[str, float]:
    """Values at which the parameters of left-out parts are held.

    Raises `ValueError` if a part is unknown or named twice.
    """
    names = list(without)
    known: set[str] = set()
    for name in names:
        if name not in MODEL_OPTIONS or name in known:
            raise ValueError(
                f"without has {name!r}, expected each once of {', '.join(MODEL_OPTIONS)}"
            )
        known.add(name)
    return {key: value for name in names for key, value in MODEL_OPTIONS[name].items()}


def free_parameters(parameters: ParameterSet, held: Mapping[str, float]) -> ParameterSet:
    """Return the parameters that are not held."""
    return ParameterSet(tuple(p for p in parameters.parameters if p.name not in held))


def hold_parameters(network: Network, held: Mapping[str, float]) -> Network:
    """Return a network whose coefficients have the held parameters' values built in."""

    def fixed(coefficient: Coefficient) -> Coefficient:
        if coefficient.parameter not in held:
            return coefficient
        return Coefficient(coefficient.factor * held[coefficient.parameter])

    source = network.source
    return replace(
        network,
        nodes=tuple(replace(node, capacity=fixed(node.capacity)) for node in network.nodes),
        edges=tuple(
            replace(edge, coefficients=tuple(map(fixed, edge.coefficients)))
            for edge in network.edges
        ),
        source=replace(
            source,
            coefficients=tuple(map(fixed, source.coefficients)),
            shares=tuple(replace(share, fraction=fixed(share.fraction)) for share in source.shares),
        ),
    )
