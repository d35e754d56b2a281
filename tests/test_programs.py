"""A run on a machine without some program: one line at its end, and CI does not pass."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import patience
from programs import commands_for

SUITE = """
import pytest
from programs import missing, needed

@pytest.mark.parametrize("number", range(20))
def test_of_a_browser(number):
    needed("chromium-that-is-not-there")

def test_of_a_broker():
    needed("mosquitto-that-is-not-there")

def test_of_a_shell():
    assert needed("bash").endswith("/bash")
"""


@pytest.mark.wires
@pytest.mark.parametrize(("ci", "status"), [("", 0), ("true", 1)])
def test_what_is_missing_is_named_once_with_the_command_that_installs_it(
    tmp_path: Path, ci: str, status: int
) -> None:
    (tmp_path / "conftest.py").write_text((Path(__file__).with_name("conftest.py")).read_text())
    (tmp_path / "test_suite.py").write_text(SUITE)
    run = subprocess.run(
        [
            sys.executable, "-m", "pytest", "-ra", "--rootdir", str(tmp_path),
            "-p", "no:cacheprovider", "-o", f"pythonpath={Path(__file__).parent}",
            "--numprocesses=1", str(tmp_path),
        ],
        cwd=tmp_path, env=os.environ | {"CI": ci}, capture_output=True, text=True, check=False,
        timeout=patience(120),
    )  # fmt: skip
    lines = run.stdout.splitlines()
    assert run.returncode == status, run.stdout + run.stderr
    assert lines[-1] == (
        "21 tests skipped, as programs are missing: "
        "apt-get install chromium-that-is-not-there mosquitto-that-is-not-there"
    )
    assert len([line for line in lines if "chromium-that-is-not-there" in line]) == 2, (
        "once in the summary of what was skipped, once in the last line"
    )


def test_packages_of_debian_are_installed_by_one_command() -> None:
    commands = ["pip install one", "apt-get install mbpoll", "apt-get install chromium"]
    assert commands_for(commands) == "apt-get install chromium mbpoll && pip install one"
