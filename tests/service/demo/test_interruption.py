"""The demo, interrupted: nothing stays behind and the document is there."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from patience import patience
from processes import wait_until

pytestmark = pytest.mark.wires

Demo = Callable[..., "subprocess.Popen[str]"]
PATIENCE_S = 60.0


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Demo]:
    """Start the demo as a terminal would: leader of a process group of its own."""
    started: list[subprocess.Popen[str]] = []

    def run(*arguments: str) -> "subprocess.Popen[str]":
        with (tmp_path / "told").open("w") as told:
            started.append(
                subprocess.Popen(
                    [sys.executable, "-m", "service", "demo", "--headless", "--json",
                     "--port", "0", "--rate", "240", *arguments],
                    stdout=subprocess.PIPE,
                    stderr=told,
                    stdin=subprocess.DEVNULL,
                    text=True,
                    process_group=0,
                )
            )  # fmt: skip
        return started[-1]

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        for child in children(process.pid).values():
            os.kill(child, signal.SIGKILL)
        process.communicate()


def children(parent: int) -> dict[str, int]:
    """The demo's processes by their commands."""
    found = {}
    for folder in Path("/proc").iterdir():
        try:
            parent_of_it = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            command = (folder / "cmdline").read_text().split("\0")
        except (OSError, ValueError, IndexError):
            continue
        if parent_of_it == parent and len(command) > 3:
            found[command[3]] = int(folder.name)
    return found


def told(tmp_path: Path, words: str) -> bool:
    return words in (tmp_path / "told").read_text()


@pytest.mark.thorough
def test_ctrl_c_in_the_middle_still_gives_the_account(demo: Demo, tmp_path: Path) -> None:
    process = demo()
    wait_until(lambda: told(tmp_path, "Stage 2 of"), 150, "the second stage")
    left = children(process.pid)
    assert set(left) == {"virtual-bench", "serve"}
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does on Ctrl-C
    output, _ = process.communicate(timeout=patience(PATIENCE_S))
    assert process.returncode == 0, (tmp_path / "told").read_text()
    document = json.loads(output)
    assert document["complete"] is False
    assert document["samples"]["modbus"] > 0
    assert document["samples"]["can"] > 0
    assert not any(Path(f"/proc/{child}").exists() for child in left.values())


@pytest.mark.laboratory
def test_a_signal_during_the_preparation_ends_it_at_once(demo: Demo, tmp_path: Path) -> None:
    process = demo()
    wait_until(lambda: told(tmp_path, "Preparing"), 60, "the preparation")
    process.terminate()
    output, _ = process.communicate(timeout=patience(PATIENCE_S))
    assert process.returncode == 0
    assert json.loads(output) == {
        "model_versions": [],
        "stages": [],
        "samples": {"modbus": 0, "can": 0},
        "complete": False,
        "forecasts_kept": {},
    }


@pytest.mark.laboratory
def test_a_part_that_dies_is_named(demo: Demo, tmp_path: Path) -> None:
    process = demo()
    wait_until(lambda: told(tmp_path, "Stage 1 of"), 150, "the first stage")
    os.kill(children(process.pid)["serve"], signal.SIGKILL)
    output, _ = process.communicate(timeout=patience(PATIENCE_S))
    assert process.returncode == 1
    assert output == ""
    last = (tmp_path / "told").read_text().splitlines()[-1]
    assert last.startswith("bearing-twin: the service ended with status -9")


@pytest.mark.laboratory
def test_its_time_counts_from_the_start(demo: Demo) -> None:
    process = demo("--duration-s", "2")
    output, _ = process.communicate(timeout=patience(PATIENCE_S))
    assert process.returncode == 0
    assert json.loads(output)["complete"] is False
