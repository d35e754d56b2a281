"""Runs the tests in parallel, and those that failed once more: ``python -m tools.gate [PATH ...]``.

A few hundred of the tests start processes and open sockets, and on a busy machine one of them fails
now and then for a reason that has nothing to do with a change. So each test that failed, or whose
fixture did, has a second look: in a process of its own, one after another, with nothing next to it.
Tests that use real sockets, other processes or a browser share what their file starts, and some go
on where the one before ended: of them the second look takes the whole file.
A test that passes then is *unstable*: the run passes, its last lines name the test, and the first
failure is kept in ``build/unstable``. The model is ``regrtest --rerun`` of CPython.

What no second look mends: a test that fails twice, more than five looks, an error while tests are
collected, a worker that crashed, and in continuous integration a test that is skipped.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tools.gate_report import REPORT_VARIABLE, Report, read

LOOKS_MAX = 5
WORKERS = 2  # one of them runs the tests of whole services (tests/seconds.py)
BUILD = Path("build")
UNSTABLE = BUILD / "unstable"


def main(paths: Sequence[str]) -> int:
    """Run the gate over paths, or over the whole suite; 0 where it passes, 1 where it does not."""
    shutil.rmtree(UNSTABLE, ignore_errors=True)
    UNSTABLE.mkdir(parents=True)
    status, first = look([f"--numprocesses={WORKERS}", *paths])
    problems = beyond_a_second_look(status, first)
    if problems:
        return end(first, problems=problems, failed=list(first.failed))
    for test, text in first.failed.items():
        (UNSTABLE / file_name(test)).write_text(text, encoding="utf-8")
    unstable: list[str] = []
    failed: list[str] = []
    for target, tests in second_looks(first).items():
        write(f"\nsecond look at {target}")
        status, second = look([target])
        for test in tests:
            (unstable if status == 0 and test in second.passed else failed).append(test)
    return end(first, unstable=unstable, failed=failed)


def look(arguments: Sequence[str]) -> tuple[int, Report]:
    """Run pytest in a fresh process; its exit status and what it reported."""
    file = BUILD / "gate-report.json"
    file.unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "tools.gate_report", *arguments],
        env=os.environ | {REPORT_VARIABLE: str(file.resolve())},
        check=False,
    )
    return done.returncode, read(file)


def second_looks(report: Report) -> dict[str, list[str]]:
    """Name what is run once more, each with the failed tests for which it is."""
    looks: dict[str, list[str]] = {}
    for test in report.failed:
        target = test.partition("::")[0] if test in report.with_their_file else test
        looks.setdefault(target, []).append(test)
    return looks


def beyond_a_second_look(status: int, report: Report) -> list[str]:
    """Say why a run fails whatever a second look would show; empty where one is worth it."""
    problems = [f"not collected: {path}" for path in report.not_collected]
    problems += [f"a worker crashed in {test}" for test in report.crashed]
    if os.environ.get("CI"):
        problems += [f"skipped in CI: {test}" for test in report.skipped]
    looks = len(second_looks(report))
    if looks > LOOKS_MAX:
        problems.append(f"{looks} second looks would be needed; at most {LOOKS_MAX} are taken")
    if not problems and status != (1 if report.failed else 0):
        problems.append(f"pytest ended with exit status {status}")
    return problems


def end(
    report: Report,
    *,
    unstable: Sequence[str] = (),
    failed: Sequence[str] = (),
    problems: Sequence[str] = (),
) -> int:
    """Print the last lines of a run, and give its exit status."""
    count = f"{len(report.passed) + len(unstable)} passed"
    if unstable:
        count += f", {len(unstable)} of them at the second look"
    if failed:
        count += f", {len(failed)} failed"
    write(
        "",
        *(f"unstable: {test} (first failure: {UNSTABLE / file_name(test)})" for test in unstable),
        *(f"FAILED {test}{'' if problems else ' - twice'}" for test in failed),
        *(f"ERROR {problem}" for problem in problems),
        count,
    )
    return 1 if failed or problems else 0


def write(*lines: str) -> None:
    """Print lines in order with what pytest prints."""
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def file_name(test: str) -> str:
    """Name the file of a test's first failure."""
    return re.sub(r"[^\w.-]+", "_", test)[:200] + ".txt"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
