"""Networks of one's own: what is accepted, how each mistake is named, what is built."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from site_files import COLUMNS, asset_text

from service.site.configuration import SettingsError, describe
from service.site.machines.machine import Machine
from service.site.machines.networks import NetworkSection, read_network
from service.site.settings import load_settings
from twin_core.forecasting import forecast
from twin_core.forecasting.envelope import envelope
from twin_core.forecasting.labels import RUNAWAY
from twin_core.identification import prior_posterior
from twin_core.machine_state import MachineState
from twin_core.network import LOSSES, EdgeKind
from twin_core.network_model import RunawayLimits
from twin_core.networks.simple_5 import (
    AMBIENT_C,
    simple_5_model,
    simple_5_profile,
    target_values,
)
from twin_core.simulation import OperatingProfile, simulate, steady_state

ROOT = Path(__file__).parents[4]
GEARBOX = ROOT / "deploy" / "networks" / "gearbox.toml"
SIMPLE_5 = ROOT / "deploy" / "networks" / "simple-5.toml"


def built(file: Path) -> Any:
    return Machine("default", None, read_network(file)).build()


def test_the_papers_network_as_a_file_gives_the_same_numbers_as_the_built_in_one() -> None:
    own, reference = built(SIMPLE_5), simple_5_model()
    for name, ours, theirs in zip(
        own.compiled._fields, own.compiled, reference.compiled, strict=True
    ):
        assert np.array_equal(ours, theirs), name
    assert own.parameters.names == reference.parameters.names
    for bound in ("centre", "lower", "upper"):
        ours = getattr(own.parameters, bound)
        assert ours == pytest.approx(getattr(reference.parameters, bound), rel=1e-12)
    assert own.sensor_names == reference.sensor_names
    start = np.full(4, AMBIENT_C)
    paths = [
        simulate(model, target_values(), simple_5_profile(), start).temperatures_c
        for model in (own, reference)
    ]
    assert np.array_equal(*paths)


def test_a_machine_comes_back_from_json_as_it_was() -> None:
    machine = Machine("default", None, read_network(GEARBOX))
    again = Machine.from_dict(json.loads(json.dumps(machine.to_dict())))
    assert again == machine
    assert again.name == "gearbox"
    assert again.temperature_names == ("t_bearing_c", "t_wall_c", "t_housing_c", "t_oil_c")


def test_heat_goes_where_the_shares_say() -> None:
    model = built(GEARBOX)
    cold = steady_state(model, model.parameters.centre, 1500.0, 3000.0, 20.0)
    values = model.parameters.centre.copy()
    values[model.parameters.index("to_bearing")] = 1.0
    bearing, housing, oil = steady_state(model, values, 1500.0, 3000.0, 20.0)
    assert bearing > cold[0] + 1.0
    assert bearing > oil > housing
    # All the heat leaves through the film: 135 W = 6 W/K (dT / 12 K)^0.15 dT.
    rise = housing - 20.0
    assert 6.0 * (rise / 12.0) ** 0.15 * rise == pytest.approx(135.0, rel=1e-6)
    wall = model.sensor_row("t_wall_c") @ [bearing, housing, oil]
    assert wall == pytest.approx(0.8 * housing + 0.2 * oil)


EVERY_KIND = """
parameters = { a = { centre = 1.0, spread = 0.5 } }
nodes.t_a_c = { capacity_j_k = 100 }
nodes.t_b_c = { capacity_j_k = { parameter = "a", factor = 2 } }
sensors = { t_a_c = "t_a_c" }
source = { kind = "linear", constant_w = 1, shares = [{ node = "t_a_c" }] }
[[edges]]
between = ["t_a_c", "t_b_c"]
kind = "constant"
resistance_k_w = 2
[[edges]]
between = ["t_a_c", "t_b_c"]
kind = "contact"
fixed_k_w = 1
constant_k_w = 2
moving_k_w = 3
[[edges]]
between = ["t_a_c", "t_b_c"]
kind = "convective"
base_k_w = 1
nusselt_at_rest = 2
nusselt_factor = 3
nusselt_exponent = 0.4
[[edges]]
between = ["t_a_c", "t_b_c"]
kind = "convective-reference"
base_k_w = 1
nusselt_at_rest = 2
nusselt_at_3000_rpm = 3
nusselt_exponent = 0.4
[[edges]]
between = ["ambient", "t_b_c"]
kind = "film"
conductance_w_k = 5
exponent = 0.1
[[edges]]
between = ["t_a_c", "ambient"]
kind = "shaft-sink"
at_rest_w_k = 6
at_6000_rpm_w_k = 7
[[edges]]
between = ["t_a_c", "ambient"]
kind = "speed-power"
resistance_k_w = 8
reference_rpm = 10
exponent = 0.9
"""


def test_every_kind_of_edge_takes_its_coefficients_in_the_order_of_the_kernel() -> None:
    section = NetworkSection.model_validate({"name": "all"} | tomllib.loads(EVERY_KIND))
    edges = section.network().edges
    assert [edge.kind for edge in edges] == [kind for kind in EdgeKind if kind not in LOSSES]
    factors = [tuple(c.factor for c in edge.coefficients) for edge in edges]
    assert factors == [
        (2,), (1, 2, 3), (1, 2, 3, 0.4), (1, 2, 3, 0.4), (5, 0.1), (6, 7), (8, 10, 0.9),
    ]  # fmt: skip
    assert (edges[4].first, edges[4].second) == ("t_b_c", "ambient")
    assert section.compiled().capacity_parameter.tolist() == [-1, 0]


@pytest.mark.parametrize(
    ("source", "count"),
    [
        (
            'kind = "palmgren"\nlubricant_node = "t_a_c"\nf2 = "a"\npitch_diameter_mm = 87.5\n'
            "static_load_rating_n = 45000\nviscosity_mm2_s = 300\nviscosity_fall_per_k = 0.048\n"
            "viscosity_reference_c = 22.6",
            6,
        ),
        (
            'kind = "two-part"\nlubricant_node = "t_b_c"\nmoment_nmm = { parameter = "a", '
            "factor = 200 }\nspeed_exponent = 0.5\nviscosity_exponent = 0.4\nload_share = 0.2\n"
            "load_exponent = 1.6",
            10,
        ),
    ],
)
def test_the_friction_laws_of_bearings_heat_a_network_too(source: str, count: int) -> None:
    document = tomllib.loads(EVERY_KIND) | {"name": "friction"}
    document["source"] = tomllib.loads(source) | {"shares": [{"node": "t_a_c"}]}
    model = Machine("default", None, NetworkSection.model_validate(document)).build()
    assert model.compiled.friction_coefficient.size == count
    assert model.runaway == RunawayLimits()
    slow, fast = (steady_state(model, [1.0], n, 2650.0, 20.0) for n in (1500.0, 3000.0))
    assert (fast > slow + 0.1).all()
    assert (slow > 20.0).all()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("capacity_j_k = 900", "capacity_j_k = -900", "nodes.t_bearing_c.capacity_j_k = -900"),
        ("capacity_j_k = 900", "capacity = 900", "nodes.t_bearing_c.capacity_j_k: missing"),
        ("t_bearing_c = { cap", "bearing = { cap", "nodes.bearing"),
        ('"seat"\n', '"set"\n', "unknown parameter 'set', expected one of friction, mesh, seat"),
        ('"seat"\n', "true\n", "edges[0].resistance_k_w = True: expected a number, the name of"),
        ('"seat"\n', "nan\n", "edges[0].resistance_k_w"),
        ('kind = "constant"', 'kind = "konstant"', "edges[0].kind = 'konstant': expected one of"),
        ('kind = "constant"\n', "", "edges[0].kind: expected one of 'constant', 'contact'"),
        ("exponent = 0.15", "power = 0.15", "edges[3].exponent: missing"),
        ('between = ["t_bearing_c", "t_housing_c"]', 'between = ["t_bearing_c", "t_hosing_c"]',
         "unknown node 't_hosing_c', expected one of t_bearing_c, t_housing_c, t_oil_c"),
        ('["t_housing_c", "ambient"]', '["t_housing_c", "t_oil_c"]', "a film leads to 'ambient'"),
        ("centre = 0.05, spread", "centre = -0.05, spread", "parameters.friction: "),
        ("spread = 0.3", "spread = 0", "parameters.film.spread = 0"),
        (", lower = 0.0, upper = 1.0", "", "parameters.to_bearing: may become -0.1"),
        ('[source]\nkind = "linear"', '[source]\nkind = "quadratic"',
         "source.kind = 'quadratic': expected one of 'linear', 'palmgren', 'two-part'"),
        ('{ node = "t_oil_c" }', '{ node = "t_oil_c", of_rest = 0.5 }', "shares[1].of_rest"),
        ('of_rest = "to_bearing"', "of_rest = 1.5", "shares[0].of_rest = 1.5: expected 0 to 1"),
        ("t_oil_c = 0.2 }", "t_oil_c = 0.3 }", "sensors.t_wall_c: weights sum up to 1.1, exp"),
        ('t_bearing_c = "t_bearing_c"', 't_bearing_c = "t_oil_c"', "sensors.t_bearing_c: a node"),
        ("speed_rpm = 1500", "speed_rpm = 0", "reference.speed_rpm = 0"),
        ("[reference]", "[referense]", "referense: unknown key"),
        ('mesh = {', 'mash = {', "unknown parameter 'mesh'"),
        ("[reference]", "[errors]\nslow_k = -1\n[reference]", "errors.slow_k = -1"),
        ('per_n_w = "mesh"\n', "", "parameter 'mesh' is not used by any coefficient"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_in_one_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = GEARBOX.read_text()
    assert old in text
    file = tmp_path / "own.toml"
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(SettingsError) as caught:
        read_network(file)
    message = str(caught.value)
    for line in caught.value.lines:
        assert line.startswith(f"{file}: ")
    assert expected in message


def test_a_node_without_a_way_to_the_ambient_is_refused() -> None:
    document = tomllib.loads(EVERY_KIND) | {"name": "island"}
    document["nodes"]["t_c_c"] = {"capacity_j_k": 1}
    with pytest.raises(ValidationError) as caught:
        NetworkSection.model_validate(document)
    assert "node 't_c_c' has no path to 'ambient'" in describe(caught.value)


ASSET = asset_text(
    "gear-1",
    (*COLUMNS, "t_bearing_c", "t_oil_c"),
    machine='network = "own.toml"',
    low_risk=(2000, 4000),
)


def configuration(folder: Path, text: str = ASSET) -> Path:
    (folder / "own.toml").write_text(GEARBOX.read_text())
    file = folder / "twin.toml"
    file.write_text(text)
    return file


def test_the_file_of_a_network_is_looked_for_beside_the_configuration(tmp_path: Path) -> None:
    asset = load_settings(configuration(tmp_path)).assets[0]
    assert asset.network == read_network(GEARBOX)
    assert asset.bearing is None
    assert asset.limits == {}
    assert asset.sensor_names == ("t_bearing_c", "t_wall_c")
    assert asset.network_name == "gearbox"


def test_a_network_may_stand_in_the_configuration_itself(tmp_path: Path) -> None:
    table = re.sub(r"\[(?!\[)(?=[a-z]+\])", "[assets.network.", GEARBOX.read_text())
    table = table.replace("[[edges]]", "[[assets.network.edges]]")
    head, channels = ASSET.replace('network = "own.toml"\n', "").split("[assets.channels]")
    text = f"{head}[assets.network]\n{table}\n[assets.channels]{channels}"
    asset = load_settings(configuration(tmp_path, text)).assets[0]
    assert asset.network == read_network(GEARBOX)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"own.toml"', '"none.toml"', ("assets[0].network", "none.toml: cannot be read")),
        ('"own.toml"', '"bearing-15"', ("assets[0].network = 'bearing-15'", "'bearing-14'")),
        ('"own.toml"', '"bearing-14"', ("assets[0].bearing: missing",)),
        ('id =', 'bearing = "6311"\nid =', ("assets[0].bearing", "no bearing together with")),
        ("t_oil_c =", "t_outer_ring_c =", ("assets[0].channels.t_outer_ring_c", "t_wall_c")),
        ("low_risk", "limits = { t_inner_ring_c = { warning = 1, alarm = 2 } }\nlow_risk",
         ("assets[0].limits.t_inner_ring_c", "such as t_bearing_c")),
    ],
)  # fmt: skip
def test_a_mistake_around_a_network_is_named(
    tmp_path: Path, old: str, new: str, expected: tuple[str, ...]
) -> None:
    assert old in ASSET
    with pytest.raises(SettingsError) as caught:
        load_settings(configuration(tmp_path, ASSET.replace(old, new, 1)))
    for part in expected:
        assert part in str(caught.value)
    for line in caught.value.lines:
        assert line.startswith(f"{tmp_path / 'twin.toml'}: ")


def test_what_the_document_on_networks_shows_is_valid() -> None:
    text = (ROOT / "docs" / "connect" / "networks.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    whole = [block for block in blocks if block.startswith("name =")]
    assert len(blocks) >= 3
    assert len(whole) == 1
    assert NetworkSection.model_validate(tomllib.loads(whole[0])) == read_network(GEARBOX)
    for block in blocks:
        tomllib.loads(block)


def _hot(text: str, folder: Path) -> tuple[bool, bool]:
    """Whether a forecast and an envelope at 300 degC exclude no runaway."""
    file = folder / "forge.toml"
    file.write_text(text)
    model = built(file)
    ambient_c = 300.0
    state = MachineState(np.full(3, ambient_c), 0.01 * np.eye(3), 0.0, ambient_c)
    profile = OperatingProfile(
        np.array([0.0, 60.0, 600.0]), np.full(3, 1500.0), np.full(3, 3000.0), np.full(3, ambient_c)
    )
    posterior = prior_posterior(model)
    made = forecast(model, posterior, state, profile, members=20)
    found = envelope(model, posterior, state, [1500.0], [3000.0], {}, members=20)
    return RUNAWAY in made.labels, bool(found.runaway_not_excluded[0, 0])


def test_limits_of_a_runaway_are_a_bearings_own(tmp_path: Path) -> None:
    """A hot machine without a bearing's friction has not run away, unless its file says so."""
    gearbox = GEARBOX.read_text()
    assert _hot(gearbox, tmp_path) == (False, False)
    assert _hot(gearbox + "\n[runaway]\n", tmp_path) == (True, True)
    limits = "\n[runaway]\nhot_c = 600\nlost_c = 700\n"
    assert _hot(gearbox + limits, tmp_path) == (False, False)
    section = NetworkSection.model_validate(tomllib.loads(gearbox + limits))
    assert section.runaway_limits() == RunawayLimits(600.0, 1.5, 700.0)
    with pytest.raises(ValidationError, match="lost_c = 130: expected at least hot_c = 600"):
        NetworkSection.model_validate(tomllib.loads(gearbox + "\n[runaway]\nhot_c = 600\n"))
