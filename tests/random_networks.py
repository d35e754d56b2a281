"""Random networks of one's own, as a user writes them, and profiles for them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from service.site.machines.machine import Machine
from service.site.machines.networks import NetworkSection
from twin_core.models import ThermalModel
from twin_core.simulation import OperatingProfile

AMBIENT_C = 20.0
COOLANT_C = 35.0
HEATER = "heater_w"
NO_INPUTS = np.empty((0, 0))

_BETWEEN_NODES = ("constant", "contact", "convective", "convective-reference", "speed-power")


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """A network, and what the laws of physics promise of it.

    - ``heated``: indices of the nodes that have a source.
    - ``neighbours``: by node, the indices of its neighbours; -1 is a boundary.
    """

    document: Mapping[str, Any]
    heated: frozenset[int]
    neighbours: tuple[frozenset[int], ...]

    def build(self) -> ThermalModel:
        """Build its model, as the service does."""
        return Machine("default", None, NetworkSection.model_validate(self.document)).build()


@st.composite
def networks(draw: st.DrawFn, *, contacts: bool = True, losses: bool = True) -> Drawn:
    """Draw a connected network of up to six nodes.

    ``contacts``: with resistances that fall with the load; ``losses``: with a heater and copper of
    its own beside the friction.
    """
    size = draw(st.integers(1, 6))
    names = [f"t_body_{number}_c" for number in range(size)]
    kinds = [kind for kind in _BETWEEN_NODES if contacts or kind != "contact"]
    pairs = [(draw(st.integers(0, node - 1)), node) for node in range(1, size)]
    if size > 1:
        for _ in range(draw(st.integers(0, 2))):
            first, second = draw(
                st.lists(st.integers(0, size - 1), min_size=2, max_size=2, unique=True)
            )
            pairs.append((first, second))
    edges = [
        {"between": [names[first], names[second]], **_edge(draw, draw(st.sampled_from(kinds)))}
        for first, second in pairs
    ]
    outside = draw(st.lists(st.integers(0, size - 1), min_size=1, max_size=size, unique=True))
    for node in outside:
        kind = draw(st.sampled_from(["constant", "film", "shaft-sink"]))
        edges.append({"between": [names[node], "ambient"], **_edge(draw, kind)})
    neighbours = [set[int]() for _ in names]
    for first, second in pairs:
        neighbours[first].add(second)
        neighbours[second].add(first)
    for node in outside:
        neighbours[node].add(-1)
    heated = draw(st.lists(st.integers(0, size - 1), min_size=1, max_size=2, unique=True))
    document: dict[str, Any] = {
        "name": "drawn",
        "parameters": {"friction": {"centre": draw(_between(0.001, 0.05)), "spread": 0.3}},
        "nodes": {name: {"capacity_j_k": draw(_between(2e3, 2e4))} for name in names},
        "edges": edges,
        "source": {
            "kind": "linear",
            "per_rpm_w": "friction",
            "per_n_w": draw(_between(0.001, 0.02)),
            "shares": [
                {"node": names[node]} | ({} if last else {"of_rest": draw(_between(0.1, 0.9))})
                for node, last in zip(heated, [False] * (len(heated) - 1) + [True], strict=True)
            ],
        },
        "sensors": {name: name for name in names},
        "reference": {"speed_rpm": 1500, "load_n": 2000},
    }
    if losses and draw(st.booleans()):
        node = draw(st.integers(0, size - 1))
        document["losses"] = [{"node": names[node], "kind": "power", "channel": HEATER}]
        document["reference"]["inputs"] = {HEATER: 20.0}
        heated.append(node)
    return Drawn(document, frozenset(heated), tuple(map(frozenset, neighbours)))


@st.composite
def profiles(draw: st.DrawFn, model: ThermalModel, rows: int = 240) -> OperatingProfile:
    """Draw a profile of steps, a row a minute, that begins at rest or not."""
    count = draw(st.integers(1, 4))
    lengths = np.full(count, rows // count)
    lengths[-1] += rows - int(lengths.sum())
    columns = [
        np.repeat(draw(st.lists(st.floats(0.0, high), min_size=count, max_size=count)), lengths)
        for high in (6000.0, 6000.0, *(50.0 for _ in model.input_names))
    ]
    return OperatingProfile(
        60.0 * np.arange(rows),
        columns[0],
        columns[1],
        np.full(rows, AMBIENT_C),
        np.stack(columns[2:], axis=1) if model.input_names else NO_INPUTS,
    )


def held(
    model: ThermalModel, speed_rpm: float, load_n: float, input_w: float, time_s: np.ndarray
) -> OperatingProfile:
    """One operating point throughout."""
    rows = time_s.size
    inputs = np.full((rows, len(model.input_names)), input_w) if model.input_names else NO_INPUTS
    columns = (np.full(rows, value) for value in (speed_rpm, load_n, AMBIENT_C))
    return OperatingProfile(time_s, *columns, inputs)


def _between(low: float, high: float) -> st.SearchStrategy[float]:
    """Orders of magnitude are as likely as each other."""
    return st.floats(np.log(low), np.log(high)).map(lambda value: float(np.exp(value)))


def _edge(draw: st.DrawFn, kind: str) -> dict[str, Any]:
    resistance = draw(_between(0.02, 5.0))
    keys: dict[str, Any] = {
        "constant": {"resistance_k_w": resistance},
        "contact": {"fixed_k_w": resistance, "moving_k_w": draw(_between(1.0, 1e3))},
        "convective": {
            "base_k_w": 5.0 * resistance,
            "nusselt_at_rest": 2.0,
            "nusselt_factor": draw(_between(0.01, 0.5)),
            "nusselt_exponent": 0.6,
        },
        "convective-reference": {
            "base_k_w": 5.0 * resistance,
            "nusselt_at_rest": 2.0,
            "nusselt_at_3000_rpm": draw(_between(3.0, 60.0)),
            "nusselt_exponent": 0.5,
        },
        "speed-power": {
            "resistance_k_w": resistance,
            "reference_rpm": 1500.0,
            "exponent": draw(st.floats(-0.5, 0.0)),
        },
        # Slower than the steps of 60 s, as the service chooses them.
        "film": {
            "conductance_w_k": draw(_between(0.2, 5.0)),
            "exponent": draw(st.floats(0.0, 0.3)),
        },
        "shaft-sink": {"at_rest_w_k": 1.0 / resistance, "at_6000_rpm_w_k": draw(_between(0.1, 5))},
    }
    return {"kind": kind, **keys[kind]}
