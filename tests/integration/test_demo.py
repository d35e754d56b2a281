"""The demo as a script runs it, cut short; the full story is for people and takes five minutes."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from patience import patience
from processes import Site, wait_until

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600)]


@pytest.fixture(scope="module", autouse=True)
def compiled_kernels() -> None:
    """Have the kernels compiled, so that the demo's time is spent on its story."""
    subprocess.run([sys.executable, "-m", "service", "warm-up"], check=True, timeout=patience(560))


def test_the_bench_waits_for_the_identification_however_fast_the_clock_runs() -> None:
    """Five hours of low-risk stages pass in 20 s, sooner than an identification ends."""
    demo = subprocess.run(
        [
            sys.executable, "-m", "service", "demo", "--headless", "--json", "--port", "0",
            "--rate", "1000",
        ],
        capture_output=True,
        text=True,
        timeout=patience(560),
        check=False,
    )  # fmt: skip
    assert demo.returncode == 0, demo.stderr[-3000:]
    document = json.loads(demo.stdout)
    assert document["complete"] is True
    identified = {model["version"] for model in document["model_versions"] if model["activated"]}
    for stage in document["stages"]:
        assert stage["forecast_model_version"] in identified, demo.stderr[-3000:]
        assert stage["forecast_made_at"] < stage["start"]


@pytest.mark.endurance
def test_a_demo_that_make_starts_is_cut_short_and_prints_its_document_and_nothing_else() -> None:
    """As a script would: what make itself has to say is not on standard output."""
    # Not as a part of the make that runs these tests, which would name its folders.
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    demo = subprocess.run(
        [
            "make", "demo", f"VENV={sys.prefix}", "--assume-old", f"{sys.prefix}/.installed-run",
            "DEMO_ARGS=--headless --json --port 0 --duration-s 90 --rate 240",
        ],
        cwd=Path(__file__).parents[2],
        env=alone,
        capture_output=True,
        text=True,
        timeout=patience(560),
        check=False,
    )  # fmt: skip
    assert demo.returncode == 0, demo.stderr[-3000:]
    document = json.loads(demo.stdout)
    assert document["complete"] is False
    assert document["samples"]["modbus"] > 100
    assert document["samples"]["can"] > 100
    assert set(document) >= {"model_versions", "stages", "samples", "complete"}
    assert "Stage 2 of" in demo.stderr


@pytest.mark.endurance
def test_a_pause_of_the_processor_raises_no_alarm_of_lost_data(tmp_path: Path) -> None:
    """At rate 120 two seconds are four minutes of the bench, and nothing is lost in them."""
    site = Site(tmp_path, "demo", 120.0)
    good = ("t_inner_ring_c", "speed_rpm", "speed_setpoint_rpm")

    def all_good() -> bool:
        tags = site.tags()
        return all(tags[name]["quality"] == 192 for name in good)

    try:
        site.start_bench()
        site.start_service()
        assert site.service is not None
        assert site.bench is not None
        wait_until(all_good, 90, "all channels")
        for process in (site.service.side("cell"), site.bench.process.pid):
            os.kill(process, signal.SIGSTOP)
            time.sleep(2.0)
            os.kill(process, signal.SIGCONT)
            resumed_us = site.now_us()
            wait_until(
                lambda since_us=resumed_us: site.now_us() - since_us > 600e6 and all_good(),
                90,
                "values from after the pause",
            )
        assert [one["message"] for one in site.get("/api/v1/alarms")["items"]] == []
    finally:
        site.close()
