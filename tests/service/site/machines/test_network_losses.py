"""Losses and further boundaries of a network in the configuration."""

import tomllib
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from service.site.asset_section import AssetSection
from service.site.configuration import SettingsError, describe_all
from service.site.machines.machine import Machine
from service.site.machines.networks import NetworkSection

DEPLOY = Path(__file__).parents[4] / "deploy" / "networks"
MOTOR = """
[parameters]
slot = { unit = "K/W", centre = 0.1, spread = 0.5 }
air = { unit = "W/K", centre = 1.0, spread = 0.5 }
jacket = { unit = "K/W", centre = 0.2, spread = 0.5 }
r20 = { unit = "ohm", centre = 0.05, spread = 0.2 }
iron = { unit = "W", centre = 30.0, spread = 0.5 }

[nodes]
t_winding_c = { capacity_j_k = 300 }
t_body_c = { capacity_j_k = 2000 }

[[edges]]
between = ["t_winding_c", "t_body_c"]
kind = "constant"
resistance_k_w = "slot"

[[edges]]
between = ["coolant_c", "t_body_c"]
kind = "constant"
resistance_k_w = "jacket"

[[edges]]
between = ["t_body_c", "ambient"]
kind = "film"
conductance_w_k = "air"
exponent = 0.2

[[losses]]
node = "t_winding_c"
kind = "copper"
channel = "current_a"
resistance_20_ohm = "r20"

[[losses]]
node = "t_body_c"
kind = "speed"
loss_w = "iron"
reference_rpm = 3000
exponent = 1.5

[[losses]]
node = "t_body_c"
kind = "power"
channel = "inverter_w"
factor = 0.1

[sensors]
t_winding_c = "t_winding_c"
t_body_c = "t_body_c"

[reference]
speed_rpm = 3000
inputs = { current_a = 40.0, inverter_w = 100.0 }
"""


def motor(old: str = "", new: str = "") -> NetworkSection:
    assert old in MOTOR
    text = MOTOR.replace(old, new, 1) if old else MOTOR
    document: dict[str, Any] = {"name": "motor"} | tomllib.loads(text)
    return NetworkSection.model_validate(document)


def test_its_inputs_are_channels_by_name() -> None:
    section = motor()
    assert section.inputs == ("coolant_c", "current_a", "inverter_w")
    assert section.boundaries == ("coolant_c",)
    assert section.mean_square_inputs == ("current_a",)
    assert section.unused_channels == ("load_n",)
    model = Machine("default", None, section).build()
    assert model.input_names == section.inputs
    assert model.reference_inputs == (0.0, 40.0, 100.0)
    asset = AssetSection.model_validate(
        {
            "id": "motor-1",
            "network": section,
            "low_risk": {"speed_rpm_max": 3000, "load_n_max": 1},
            "channels": {
                name: {"source": "push"}
                for name in ("speed_rpm", "load_n", "ambient_c", *section.inputs, "t_body_c")
            },
        }
    )
    assert asset.input_names == section.inputs


def test_it_survives_a_model_file() -> None:
    machine = Machine("default", None, motor())
    assert Machine.from_dict(machine.to_dict()) == machine


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('kind = "copper"', 'kind = "iron"', "losses[0].kind = 'iron': expected one of 'copper'"),
        ('channel = "current_a"', 'channel = "speed_rpm"', "losses[0].channel = 'speed_rpm'"),
        ('channel = "current_a"', 'channel = "t_winding_c"', "losses[0].channel = 't_winding_c'"),
        ('channel = "current_a"', "", "losses[0].channel: missing"),
        ('["coolant_c", ', '["Coolant", ', "edges[1].between[0] = 'Coolant'"),
        ("current_a = 40.0, ", "", "reference.inputs.current_a: missing"),
        ("current_a = 40.0", "current_a = 4, coolant_c = 2", "reference.inputs.coolant_c: drives"),
        ('node = "t_winding_c"', 'node = "t_shaft_c"', "unknown node 't_shaft_c'"),
        ("factor = 0.1", "factor = -0.1", "losses[2].factor"),
    ],
)
def test_a_mistake_is_named(old: str, new: str, expected: str) -> None:
    with pytest.raises((ValidationError, SettingsError)) as caught:
        motor(old, new)
    assert isinstance(caught.value, ValidationError)
    assert any(expected in line for line in describe_all(caught.value)), describe_all(caught.value)


def test_a_loss_whose_resistance_may_become_negative_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"parameters\.r20: may become"):
        motor(
            'r20 = { unit = "ohm", centre = 0.05, spread = 0.2 }',
            'r20 = { transform = "linear", centre = 0.05, spread = 0.2 }',
        )


def test_a_network_without_any_heat_is_refused() -> None:
    document = tomllib.loads(MOTOR) | {"name": "cold"}
    del document["losses"]
    del document["parameters"]["r20"]
    del document["parameters"]["iron"]
    with pytest.raises(ValidationError, match="expected a law of heat, or losses"):
        NetworkSection.model_validate(document)


def test_the_stator_that_is_shipped_loads() -> None:
    section = NetworkSection.model_validate(tomllib.loads((DEPLOY / "stator.toml").read_text()))
    assert section.inputs == ("power_w",)
    assert section.unused_channels == ("speed_rpm", "load_n")
    Machine("default", None, section).build()
