"""The cell works without its compiled kernels until they are there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.cell.kernels import Kernels

LOOK = "from service.kernels import load_live_kernels; print(load_live_kernels())"


def test_kernels_that_are_there_are_not_reported() -> None:
    kernels = Kernels(ready=True)
    assert kernels.ready.is_set()
    assert kernels.progress == ""


def test_the_progress_says_what_is_missing_meanwhile() -> None:
    assert Kernels(ready=False).progress == (
        "the twin is being compiled, which only the first start does: 0%; measured values are "
        "stored, shown and compared with their limits; estimates and forecasts follow"
    )


@pytest.mark.wires
def test_an_empty_cache_is_noticed_before_anything_is_compiled(tmp_path: Path) -> None:
    found = subprocess.run(
        [sys.executable, "-c", LOOK],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout == "False\n"
    assert not list(tmp_path.rglob("*.nbc"))


@pytest.mark.wires
def test_a_cache_that_is_filled_is_loaded() -> None:
    subprocess.run([sys.executable, "-m", "service", "warm-up", "--live"], check=True)
    found = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, check=True)
    assert found.stdout == "True\n"
