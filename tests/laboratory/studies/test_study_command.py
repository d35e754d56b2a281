"""The command ``study`` as a user has it."""

import json
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from patience import patience
from processes import wait_until

from bearing_twin_laboratory.studies.registry import STUDIES
from bearing_twin_laboratory.studies.study import Options

pytestmark = pytest.mark.wires

COMMAND = [sys.executable, "-m", "service", "study"]


def _study(folder: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=patience(280),
        check=False,
    )


@pytest.mark.laboratory
def test_simple_network_prints_the_papers_targets_beside_what_was_found(tmp_path: Path) -> None:
    ended = _study(tmp_path, "simple-network", "--json", "--out", "plots")
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert list(document["parameters"]) == [f"k{number}" for number in range(1, 8)]
    assert document["parameters"]["k6"]["target"] == 0.5
    for row in document["parameters"].values():
        assert row["identified"] == pytest.approx(row["target"], rel=1e-6)
        assert row["noa_alone"] == pytest.approx(row["target"], rel=1e-2)
    assert document["evaluations_to_1_percent"] <= document["evaluations"] <= 800
    assert document["seconds"] < 60
    assert json.loads((tmp_path / "plots" / "simple-network.json").read_text()) == document
    assert "| k7 | 0.18 |" in (tmp_path / "plots" / "simple-network.md").read_text()
    assert (tmp_path / "plots" / "fig08-convergence.png").stat().st_size > 20_000


@pytest.mark.laboratory
def test_a_study_on_random_benches_takes_their_number_and_seed(tmp_path: Path) -> None:
    ended = _study(
        tmp_path, "variable-speed", "--benches", "1", "--seed", "104", "--json", "--out", "plots"
    )
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["seeds"] == [104]
    assert document["samples"] == 540
    assert document["refused"] == {}
    assert document["paper"]["max_error_c"] == {"t_inner_ring_c": 1.2, "t_outer_ring_c": 0.5}
    for ring in ("t_inner_ring_c", "t_outer_ring_c"):
        assert document["max_error_c"][ring] < 1.2
        assert document["coverage_95_by_sensor"][ring] > 0.9
    assert json.loads((tmp_path / "plots" / "variable-speed.json").read_text()) == document
    assert (tmp_path / "plots" / "fig10-variable-speed.png").stat().st_size > 20_000


def test_an_unknown_study_names_the_known_ones(tmp_path: Path) -> None:
    ended = _study(tmp_path, "simple")
    assert ended.returncode == 2
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert line == (f"bearing-twin: study 'simple': expected one of {', '.join(STUDIES)}, all")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("simple-network", "--benches", "3"), "--benches: the study simple-network takes no"),
        (("all", "--benches", "0"), "--benches 0: expected 1 or more"),
        (("all", "--seed", "-1"), "--seed -1: expected 0 or more"),
        (("all", "--data", "."), "--data: each study of recorded data has files of its own; name"),
    ],
)
def test_options_that_do_not_fit(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    ended = _study(tmp_path, *arguments)
    assert ended.returncode == 2
    assert ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"bearing-twin: {message}")


@pytest.mark.parametrize("name", [name for name, study in STUDIES.items() if not study.needs])
def test_quickly_a_study_has_few_cases_of_the_same_kind(name: str) -> None:
    """One bench where there are many by default; the other searches from two seeds of twenty."""
    declared = import_module(f"bearing_twin_laboratory.studies.{STUDIES[name].module}").STUDY
    assert declared.name == name
    every, quick = declared.cases(Options()), declared.cases(Options(quick=True))
    assert [type(case) for case in quick] == [type(case) for case in every[: len(quick)]]
    if name == "simple-network":
        assert list(quick) == list(every)
    else:
        assert 4 * benches(quick) <= benches(every)


def benches(cases: Any) -> int:
    """Of cases that are many each, how many there are."""
    return sum(getattr(case, "targets", 1) for case in cases)


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    ended = _study(tmp_path, "simple-network", "--out", "file/plots")
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith("bearing-twin: --out file/plots: ")


def test_help_names_every_study(tmp_path: Path) -> None:
    shown = re.sub(r"\s+", " ", re.sub(r"[│╭╮╰╯─]", " ", _study(tmp_path, "--help").stdout))
    for name in (*STUDIES, "all"):
        assert name in shown


@pytest.mark.laboratory
def test_a_stop_takes_the_other_processes_along(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, "noa-vs-pso", "--out", "plots"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as running:
        children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
        deadline = time.monotonic() + patience(120)
        workers: list[str] = []
        while len(workers) < 2:
            assert running.poll() is None, running.stderr and running.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.1)
            workers = children.read_text().split()
        running.send_signal(signal.SIGTERM)
        _, error = running.communicate(timeout=patience(60))
    assert running.returncode == 0
    assert error == "bearing-twin: stopped; nothing is written\n"
    assert not list((tmp_path / "plots").iterdir())
    wait_until(
        lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers),
        30,
        "all processes have ended",
    )
