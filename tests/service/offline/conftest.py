"""A bench run, a model that needs no fit, and how to call the command line on files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from adapters.virtual_bench import BenchParameters, Scenario, measure, scenario_profile, simulate
from service.cli.main import app
from service.offline.model_file import IdentifiedModel, RunIn
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from twin_core.identification import prior_posterior

from .files import HEADER, STEPS, Run, write


@pytest.fixture(scope="session")
def run() -> Run:
    bench = BenchParameters.for_bearing("6311")
    profile = scenario_profile(Scenario("test", "test", "6311", STEPS), bench, seed=5)
    truth = simulate(profile, bench)
    shown = measure(profile, truth, seed=5)
    return Run(
        np.stack([getattr(shown, name) for name in HEADER], axis=1),
        truth.t_inner_ring_c,
        truth.t_outer_ring_c,
    )


@pytest.fixture
def prior_model(tmp_path: Path) -> Path:
    """A model file with prior parameters, as if identified from six hours at rest."""
    machine = Machine("default", named_bearing("6311", {}), None)
    model = machine.build()
    time_s = np.array([0.0, 21600.0])
    run_in = RunIn(None, True, time_s, np.array([0.0, 540_000.0]), {})
    path = tmp_path / "prior.json"
    IdentifiedModel(machine, model, prior_posterior(model), run_in).save(path)
    return path


@pytest.fixture(scope="session")
def run_command() -> Callable[..., Any]:
    """Run a command that must succeed; gives its JSON document, or its text without --json."""

    def call(*arguments: object) -> Any:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        assert result.exit_code == 0, result.output + repr(result.exception)
        return json.loads(result.stdout) if "--json" in arguments else result.stdout

    return call


@pytest.fixture
def command(run_command: Callable[..., Any]) -> Callable[..., Any]:
    """Run a command that must succeed; gives its JSON document, or its text without --json."""
    return run_command


@pytest.fixture(scope="session")
def bearing_model(
    run: Run, tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]
) -> Path:
    """A model file of the bench run's low part."""
    folder = tmp_path_factory.mktemp("bearing")
    data = write(folder / "data.csv", run.rows(60))
    run_command(
        "identify", data, "--bearing", "6311", "--at-rest", "--method", "refine",
        "--out", folder / "model.json",
    )  # fmt: skip
    return folder / "model.json"


@pytest.fixture
def complaint() -> Callable[..., str]:
    """Run a command that must refuse its input; gives the one line that the user gets."""

    def call(*arguments: object) -> str:
        result = CliRunner().invoke(app, [str(argument) for argument in arguments])
        error = result.exception
        # What `main` turns into one line and exit status 2.
        assert isinstance(error, ValueError), result.output + repr(error)
        assert type(error).__module__.startswith(("service.", "twin_core.", "adapters."))
        assert "\n" not in str(error)
        return str(error)

    return call
