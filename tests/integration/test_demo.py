"""The demo as a script runs it, cut short; the full story is for people and takes five minutes."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]


@pytest.fixture(scope="module", autouse=True)
def compiled_kernels() -> None:
    """Have the kernels compiled, so that the demo's time is spent on its story."""
    subprocess.run([sys.executable, "-m", "service", "warm-up"], check=True, timeout=560)


def test_the_bench_waits_for_the_identification_however_fast_the_clock_runs() -> None:
    """Five hours of low-risk stages pass in 20 s, sooner than an identification ends."""
    demo = subprocess.run(
        [
            sys.executable, "-m", "service", "demo", "--headless", "--json", "--port", "0",
            "--rate", "1000",
        ],
        capture_output=True,
        text=True,
        timeout=560,
        check=False,
    )  # fmt: skip
    assert demo.returncode == 0, demo.stderr[-3000:]
    document = json.loads(demo.stdout)
    assert document["complete"] is True
    identified = {model["version"] for model in document["model_versions"] if model["activated"]}
    for stage in document["stages"]:
        assert stage["forecast_model_version"] in identified, demo.stderr[-3000:]
        assert stage["forecast_made_at"] < stage["start"]


def test_a_demo_that_make_starts_is_cut_short_and_prints_its_document_and_nothing_else() -> None:
    """As a script would: what make itself has to say is not on standard output."""
    # Not as a part of the make that runs these tests, which would name its folders.
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    demo = subprocess.run(
        [
            "make", "demo", f"VENV={sys.prefix}", "--assume-old", f"{sys.prefix}/.installed-run",
            "DEMO_ARGS=--headless --json --port 0 --duration-s 45 --rate 240",
        ],
        cwd=Path(__file__).parents[2],
        env=alone,
        capture_output=True,
        text=True,
        timeout=560,
        check=False,
    )  # fmt: skip
    assert demo.returncode == 0, demo.stderr[-3000:]
    document = json.loads(demo.stdout)
    assert document["complete"] is False
    assert document["samples"]["modbus"] > 100
    assert document["samples"]["can"] > 100
    assert set(document) >= {"model_versions", "stages", "samples", "complete"}
    assert "Stage 2 of" in demo.stderr
