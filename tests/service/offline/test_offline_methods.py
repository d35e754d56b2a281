"""``identify`` with other searches than NOA, and with other models than the default one."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from service.cli.identify import MODELS
from service.offline.identification import (
    METHOD_NAMES,
    FailedFitError,
    UnusableDataError,
    check_options,
    identify_recording,
)
from service.offline.searches import OTHER_SEARCHES
from service.offline.tables import read_recording
from service.site.machines.bearings import named_bearing
from service.site.machines.machine import Machine
from twin_core.identification.identify import Method
from twin_core.models import ModelName

from .files import Run, write

Command = Callable[..., Any]


@pytest.fixture
def data(run: Run, tmp_path: Path) -> Path:
    """The first hour and a half of the bench, every minute."""
    return write(tmp_path / "data.csv", run.rows(60)[:90])


def identify(command: Command, data: Path, *options: object) -> Any:
    out = data.with_name("model.json")
    return command(
        "identify", data, "--bearing", "6311", "--at-rest", *options, "--out", out, "--json"
    )


@pytest.mark.parametrize("search", OTHER_SEARCHES)
def test_a_librarys_search_followed_by_the_refinement_ends_where_noa_does(
    data: Path, command: Command, search: str
) -> None:
    ours = identify(command, data, "--budget", 100)
    theirs = identify(command, data, "--budget", 100, "--method", f"{search}+refine")
    assert theirs["method"] == f"{search}+refine"
    assert ours["method"] == "noa+refine"
    assert theirs["rms_error_k"] == pytest.approx(ours["rms_error_k"], abs=0.03)
    assert theirs["evaluations"] > 100


@pytest.mark.parametrize(("search", "budget"), [("trf", 1000)])
def test_alone_it_is_given_its_budget_and_no_more(
    data: Path, command: Command, search: str, budget: int
) -> None:
    few, more = (
        identify(command, data, "--method", search, "--budget", evaluations)
        for evaluations in (budget, budget + 500)
    )
    assert more["evaluations"] - few["evaluations"] == 500
    assert more["rms_error_k"] < 0.5


def test_every_method_is_known_by_its_name() -> None:
    assert set(get_args(Method)) < set(METHOD_NAMES)
    for name in METHOD_NAMES:
        procedure = check_options(name, None, 0)
        assert procedure.name == name
        assert procedure.method in get_args(Method)
        assert (procedure.search is None) == (name in get_args(Method))
    assert check_options("de+refine", 50, 0).method == "noa+refine"
    assert check_options("de", 50, 0).method == "noa"


def test_a_search_whose_library_is_missing_says_how_to_install_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search, _ = OTHER_SEARCHES["pso"]
    monkeypatch.setitem(OTHER_SEARCHES, "pso", (search, "no_such_library"))
    with pytest.raises(UnusableDataError) as refused:
        check_options("pso+refine", None, 0)
    assert str(refused.value) == (
        "--method 'pso+refine': no_such_library is not installed: pip install 'bearing-twin[bench]'"
    )


def test_the_models_of_configuration_command_line_and_twin_are_the_same() -> None:
    assert get_args(ModelName) == MODELS


def test_the_reduced_paper_model_shows_the_papers_15_numbers(data: Path, command: Command) -> None:
    found = identify(command, data, "--model", "paper-reduced", "--budget", 100)
    assert found["model"] == "paper-reduced"
    assert found["rms_error_k"] < 0.4
    assert len(found["paper_view"]) == 15
    for number in found["paper_view"].values():
        assert number["low"] <= number["high"]
    f2 = found["paper_view"]["f2"]
    assert f2["low"] < f2["value"] < f2["high"]
    assert found["paper_view"]["K41"] == {"value": 2.0, "low": 2.0, "high": 2.0}
    text = command(
        "identify", data, "--bearing", "6311", "--at-rest", "--model", "paper-reduced",
        "--method", "refine", "--out", data.with_name("other.json"),
    )  # fmt: skip
    assert "the paper's number" in text


def test_other_models_have_no_view(data: Path, command: Command) -> None:
    assert "paper_view" not in identify(command, data, "--method", "refine")


def test_the_papers_model_that_does_not_fit_names_the_one_that_may(
    run: Run, tmp_path: Path
) -> None:
    """A grease that runs in looks to it like nothing it knows."""
    rows = run.rows(60)
    rows[:, 4:6] += 6.0 * np.exp(-np.arange(len(rows)) / 20.0)[:, None] - 6.0
    recording = read_recording(write(tmp_path / "data.csv", rows))
    machine = Machine("paper", named_bearing("6311", {}), None)
    with pytest.raises(FailedFitError, match=r"rms only.*; see --model paper-reduced"):
        identify_recording(recording, machine=machine, procedure=check_options("refine", None, 0))


def test_a_robust_loss_is_not_bent_by_a_loose_contact(data: Path, command: Command) -> None:
    """Every tenth reading of the inner ring is 8 K too high."""
    clean = identify(command, data, "--method", "refine")
    lines = data.read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("t_inner_ring_c")
    for row in range(10, len(lines), 10):
        cells = lines[row].split(",")
        cells[column] = f"{float(cells[column]) + 8.0:.2f}"
        lines[row] = ",".join(cells)
    bad = data.with_name("loose.csv")
    bad.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = identify(command, bad, "--method", "refine", "--loss", "cauchy")
    assert found["rms_error_k"] < 0.4
    moment = found["parameters"]["M0"]["value"]
    assert moment == pytest.approx(clean["parameters"]["M0"]["value"], rel=0.05)


def test_an_unknown_loss_is_refused() -> None:
    with pytest.raises(UnusableDataError, match=r"--loss 'l1': expected one of linear, soft_l1"):
        check_options("refine", None, 0, "l1")
