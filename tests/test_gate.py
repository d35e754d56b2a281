"""The gate of `make test`: what a second look mends, and what it does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.gate import LOOKS_MAX

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.wires

STEADY = "def test_steady(): pass\n"
#: Fails as often as `FAILURES` says, and passes then.
FAILS_FIRST = """
from pathlib import Path
import pytest

def fail_first(name, times):
    seen = Path(name)
    count = len(seen.read_text()) if seen.exists() else 0
    seen.write_text("x" * (count + 1))
    assert count >= times, "the port was taken by a neighbour"
"""


def gate(folder: Path, suite: str, *paths: str, **environment: str) -> tuple[int, list[str]]:
    """Run the gate over a suite of one file; exit status and the lines that it printed."""
    (folder / "pytest.ini").write_text(
        "[pytest]\naddopts = -p no:schemathesis --dist=loadscope\nmarkers =\n    wires\n"
    )
    (folder / "test_suite.py").write_text(suite)
    inherited = {name: value for name, value in os.environ.items() if name != "CI"}
    done = subprocess.run(
        [sys.executable, "-m", "tools.gate", *paths],
        cwd=folder,
        env=inherited | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout.splitlines()


def test_a_steady_suite_passes(tmp_path: Path) -> None:
    status, lines = gate(tmp_path, STEADY + "def test_other(): pass\n")
    assert (status, lines[-1]) == (0, "2 passed")
    assert not list((tmp_path / "build/unstable").iterdir())


def test_what_passes_at_the_second_look_passes_and_is_named_unstable(tmp_path: Path) -> None:
    suite = STEADY + FAILS_FIRST + "def test_late(): fail_first('late', 1)\n"
    status, lines = gate(tmp_path, suite)
    assert status == 0
    kept = "build/unstable/test_suite.py_test_late.txt"
    assert lines[-2:] == [
        f"unstable: test_suite.py::test_late (first failure: {kept})",
        "2 passed, 1 of them at the second look",
    ]
    assert "the port was taken by a neighbour" in (tmp_path / kept).read_text()


def test_a_failure_has_the_logs_of_its_programs_and_the_load_of_the_machine(
    tmp_path: Path,
) -> None:
    suite = """
def test_late(tmp_path):
    (tmp_path / "serve.log").write_text("the port is taken")
    assert False
"""
    paths = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    options = {"PYTEST_ADDOPTS": "-p failure_report", "PYTHONPATH": paths}
    status, lines = gate(tmp_path, suite, **options)
    assert status == 1
    assert "the port is taken" in lines
    assert any("load" in line and "processors" in line for line in lines)


def test_a_fixture_that_fails_first_gets_a_second_look(tmp_path: Path) -> None:
    suite = FAILS_FIRST + (
        "@pytest.fixture\ndef port(): fail_first('port', 1)\ndef test_port(port): pass\n"
    )
    status, lines = gate(tmp_path, suite)
    assert (status, lines[-1]) == (0, "1 passed, 1 of them at the second look")


def test_what_fails_twice_fails(tmp_path: Path) -> None:
    suite = STEADY + FAILS_FIRST + "def test_wrong(): fail_first('wrong', 2)\n"
    suite += "def test_late(): fail_first('late', 1)\n"
    status, lines = gate(tmp_path, suite)
    assert status == 1
    assert lines[-3].startswith("unstable: test_suite.py::test_late ")
    assert lines[-2] == "FAILED test_suite.py::test_wrong - twice"
    assert lines[-1] == "2 passed, 1 of them at the second look, 1 failed"


def test_a_story_is_looked_at_with_its_whole_file(tmp_path: Path) -> None:
    """What goes on where the test before ended cannot pass alone; its failures are one look."""
    suite = FAILS_FIRST + (
        "pytestmark = pytest.mark.wires\nbegun = []\n"
        "def test_begin(): begun.append(1); fail_first('begin', 1)\n"
        f"@pytest.mark.parametrize('step', range({LOOKS_MAX}))\n"
        "def test_go_on(step): assert begun; fail_first(f'step-{step}', 1)\n"
        "def test_end(): assert begun\n"
    )
    status, lines = gate(tmp_path, suite)
    assert (status, lines[-1]) == (
        0,
        f"{LOOKS_MAX + 2} passed, {LOOKS_MAX + 1} of them at the second look",
    )
    assert lines.count("second look at test_suite.py") == 1


def test_so_many_are_looked_at_and_no_more(tmp_path: Path) -> None:
    many = LOOKS_MAX + 1
    suite = FAILS_FIRST + (
        f"@pytest.mark.parametrize('name', range({many}))\n"
        "def test_late(name): fail_first(f'late-{name}', 1)\n"
    )
    status, lines = gate(tmp_path, suite)
    assert (status, lines[-1]) == (1, f"0 passed, {many} failed")
    assert f"ERROR {many} second looks would be needed; at most {LOOKS_MAX} are taken" in lines
    assert (tmp_path / "late-0").read_text() == "x", "nothing was run again"


def test_a_file_that_is_not_collected_fails(tmp_path: Path) -> None:
    status, lines = gate(tmp_path, STEADY + "import nothing_of_this_name\n")
    assert (status, lines[-1]) == (1, "0 passed")
    assert "ERROR not collected: test_suite.py" in lines


def test_a_worker_that_crashes_fails(tmp_path: Path) -> None:
    suite = STEADY + "import os\ndef test_end(): os._exit(3)\n"
    status, lines = gate(tmp_path, suite)
    assert (status, lines[-1]) == (1, "1 passed, 1 failed")
    assert "ERROR a worker crashed in test_suite.py::test_end" in lines


def test_in_continuous_integration_nothing_is_skipped(tmp_path: Path) -> None:
    suite = STEADY + "import pytest\ndef test_away(): pytest.skip('no mosquitto')\n"
    assert gate(tmp_path, suite)[0] == 0
    status, lines = gate(tmp_path, suite, CI="true")
    assert (status, lines[-1]) == (1, "1 passed")
    assert "ERROR skipped in CI: test_suite.py::test_away" in lines


def test_a_part_is_run_where_paths_are_named(tmp_path: Path) -> None:
    (tmp_path / "test_other.py").write_text("def test_wrong(): assert False\n")
    status, lines = gate(tmp_path, STEADY, "test_suite.py")
    assert (status, lines[-1]) == (0, "1 passed")
    status, lines = gate(tmp_path, STEADY, "test_nowhere.py")
    assert status == 1
    assert lines[-2:] == ["ERROR pytest ended with exit status 5", "0 passed"]
