"""The published schema: every model file keeps to it, and a damaged one does not."""

import copy
import functools
import json
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest

from service.offline.model_schema import NAME, schema
from service.site.machines.machine import Machine
from service.site.machines.networks import read_network

from . import fmus

ROOT = Path(__file__).parents[3]


#: Members that a file may lack, by where they are.
_OPTIONAL = {
    (): ("family", "own", "rows"),
    ("posterior", "trained"): ("ambient_c", "duty", "drives"),
}


def document(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    return found


@functools.cache
def validator() -> jsonschema_rs.Draft202012Validator:
    return jsonschema_rs.Draft202012Validator(schema())


def faults(value: object) -> list[str]:
    return [error.message for error in validator().iter_errors(value)]


def test_the_published_schema_is_that_of_the_program() -> None:
    """A change of the file is a decision: `make descriptions` writes it down."""
    jsonschema_rs.meta.validate(schema())
    assert document(ROOT / "docs" / NAME) == schema(), f"docs/{NAME}: 'make descriptions' writes it"


@pytest.mark.parametrize("name", ["default", "paper-reduced", "drive", "gearbox", "stator"])
def test_a_file_of_any_machine_keeps_to_it(name: str, tmp_path: Path) -> None:
    if name == "drive":
        machine = fmus.own_model(fmus.DRIVE, tmp_path)
    elif name in ("gearbox", "stator"):
        network = read_network(ROOT / "deploy" / "networks" / f"{name}.toml")
        machine = Machine("default", None, network)
    else:
        machine = fmus.bearing_model(name)
    fmus.identified_model(machine, 1).save(tmp_path / "model.json")
    assert faults(document(tmp_path / "model.json")) == []


def test_an_identified_file_keeps_to_it_and_nothing_may_be_missing(bearing_model: Path) -> None:
    whole = document(bearing_model)
    assert faults(whole) == []
    assert faults(whole | {"later": 1}) == []
    # Each of these members is needed, and no other is known inside the parts.
    for part in ((), ("posterior",), ("posterior", "trained"), ("run_in",), ("machine",)):
        place = whole
        for name in part:
            place = place[name]
        for name in place:
            damaged = copy.deepcopy(whole)
            inside = damaged
            for step in part:
                inside = inside[step]
            del inside[name]
            optional = name in _OPTIONAL.get(part, ())
            assert bool(faults(damaged)) != optional, (*part, name)
            inside[name] = {"wrong": "kind"}
            assert faults(damaged), (*part, name)
        if part:
            damaged = copy.deepcopy(whole)
            inside = damaged
            for step in part:
                inside = inside[step]
            inside["later"] = 1
            assert faults(damaged), part
