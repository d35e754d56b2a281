"""What identify says beside the parameters: bounds, gates, and what to change after a refusal."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from service.cli.main import app

from .block import CONFIGURATION, NETWORK, recorded

OPTIONS = ("--asset", "block-1", "--at-rest", "--method", "refine", "--json")


@pytest.fixture
def block(tmp_path: Path) -> Callable[[str], Path]:
    """A configuration whose one asset is a network; gives the configuration's file."""

    def configured(network: str) -> Path:
        (tmp_path / "block.toml").write_text(network)
        file = tmp_path / "twin.toml"
        file.write_text(CONFIGURATION)
        return file

    return configured


def slow_noise(std_k: float, time_s: float) -> np.ndarray:
    """A deviation that lasts, zero at the beginning."""
    rng, keep = np.random.default_rng(8), np.exp(-60.0 / time_s)
    noise = np.zeros(480)
    for row in range(1, 480):
        noise[row] = keep * noise[row - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal()
    return std_k * noise


def test_a_parameter_on_its_bound_is_reported(
    tmp_path: Path, block: Callable[[str], Path], command: Callable[..., Any]
) -> None:
    narrow = NETWORK.replace("spread = 0.4 }", "spread = 0.4, upper = 6.5 }")
    narrow += "[errors]\nslow_k = 1.5\nslow_s = 3600\n"
    data, model = recorded(tmp_path), tmp_path / "model.json"
    found = command(
        "identify", data, "--config", block(narrow), "--out", model, *OPTIONS
    )  # fmt: skip
    film = found["parameters"]["film"]
    assert (film["at_bound"], film["value"]) == ("upper", pytest.approx(6.5))
    assert found["parameters"]["speed"]["at_bound"] is None
    assert film["verdict"] in ("informed", "weak", "prior only")
    assert any("film = 6.5 W/K is on its upper bound" in text for text in found["warnings"])
    assert model.exists()
    text = command(
        "identify", data, "--config", tmp_path / "twin.toml", "--out", model, *OPTIONS[:-1]
    )
    assert "Warning: film = 6.5 W/K is on its upper bound" in text
    free = command("identify", data, "--config", block(NETWORK), "--out", model, *OPTIONS)
    assert {row["at_bound"] for row in free["parameters"].values()} == {None}
    assert free["warnings"] == []


def test_the_nested_prediction_is_made_on_the_command_line_too(
    tmp_path: Path, block: Callable[[str], Path], command: Callable[..., Any]
) -> None:
    data, model = recorded(tmp_path), tmp_path / "model.json"
    gates = command("identify", data, "--config", block(NETWORK), "--out", model, *OPTIONS)["gates"]
    assert gates["accepted"]
    checks = {check["name"]: check for check in gates["checks"]}
    assert set(checks) == {"fit", "ranges", "residuals", "extrapolation", "latest"}
    assert checks["extrapolation"]["values"]["load_n"] == pytest.approx(5000.0)
    assert checks["extrapolation"]["values"]["nested_rms_k"] < 3.0
    assert "prior parameters" in checks["extrapolation"]["detail"]
    # A machine that becomes as the prior has it for the last two hours: what came before them
    # predicts them worse than the prior does.
    changed = recorded(tmp_path, values=(5.0, 0.05, 0.02), early=1.4)
    wide = NETWORK + "[errors]\nslow_k = 4\nslow_s = 7200\n"
    found = command("identify", changed, "--config", block(wide), "--out", model, *OPTIONS)
    assert not found["gates"]["accepted"]
    assert any(text.startswith("gate not passed: latest: ") for text in found["warnings"])


def refused(data: Path, config: Path, out: Path) -> str:
    result = CliRunner().invoke(
        app, ["identify", str(data), "--config", str(config), "--out", str(out), *OPTIONS]
    )
    assert result.exit_code == 1, result.output
    assert not out.exists()
    assert result.stderr.count("\n") == 1
    return result.stderr


def test_a_refusal_by_the_error_model_names_it_and_what_would_do(
    tmp_path: Path, block: Callable[[str], Path], command: Callable[..., Any]
) -> None:
    data, model = recorded(tmp_path, slow_noise(1.5, 2400.0)), tmp_path / "model.json"
    said = refused(data, block(NETWORK), model)
    assert "failed fit: t_block_c is met with" in said
    assert "hint: change [errors] of the network, not the network" in said
    found = re.search(r"white_k = (\S+), slow_k = (\S+), slow_s = (\S+) ", said)
    assert found is not None
    white_k, slow_k, slow_s = (float(text) for text in found.groups())
    assert (0.05 < white_k < 0.5, 0.7 < slow_k < 2.5, 600.0 < slow_s < 9600.0) == (True,) * 3
    errors = f"[errors]\nwhite_k = {white_k}\nslow_k = {slow_k}\nslow_s = {slow_s}\n"
    again = command("identify", data, "--config", block(NETWORK + errors), "--out", model, *OPTIONS)
    assert again["parameters"]["film"]["low"] < 7.0 < again["parameters"]["film"]["high"]


def test_a_refusal_of_a_network_that_lacks_something_names_the_network(
    tmp_path: Path, block: Callable[[str], Path]
) -> None:
    loadless = NETWORK.replace('per_n_w = "load"\n', "").replace(
        'load = { unit = "W/N", centre = 0.02, spread = 0.7 }\n', ""
    )
    said = refused(recorded(tmp_path), block(loadless), tmp_path / "model.json")
    assert "hint: change the network or its priors, not its [errors]: with those " in said
