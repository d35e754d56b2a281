"""A plugin of pytest that writes down what `tools.gate` decides by.

pytest's own ``--last-failed`` keeps the names of failures, but neither their texts nor the crashes
of workers.
"""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest

#: The environment variable that names the file to write; without it nothing is written.
REPORT_VARIABLE = "BEARING_TWIN_GATE_REPORT"
#: Marks of tests that share with the others of their file what is slow to start.
SHARING = {"wires", "browser"}


@dataclass
class Report:
    """What became of the tests of one run."""

    #: Names of tests of which nothing failed.
    passed: list[str] = field(default_factory=list)
    #: Names of tests that failed, or whose fixtures did, with the texts of their failures.
    failed: dict[str, str] = field(default_factory=dict)
    #: Those of the failed tests that share with the others of their file what is slow to start.
    with_their_file: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    #: Tests in which a worker ended.
    crashed: list[str] = field(default_factory=list)
    #: Files in which tests could not be collected.
    not_collected: list[str] = field(default_factory=list)


def read(file: Path) -> Report:
    """What a run reported; nothing where it did not come so far."""
    return Report(**json.loads(file.read_text(encoding="utf-8"))) if file.exists() else Report()


def pytest_configure(config: pytest.Config) -> None:
    """Report from the process that sees all reports: the only one, or that of no worker."""
    file = os.environ.get(REPORT_VARIABLE)
    if file is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Reporter(Path(file)))


class _Reporter:
    def __init__(self, file: Path) -> None:
        self._file = file
        self._report = Report()
        self._passed: dict[str, None] = {}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._report.not_collected.append(report.nodeid)
        elif report.skipped:
            self._report.skipped.append(report.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        test, seen = report.nodeid, self._report
        if report.failed:
            # pytest-xdist reports a test in which a worker ended with a phase of its own
            if report.when not in ("setup", "call", "teardown"):
                seen.crashed.append(test)
            logs = "\n".join(f"--- {title}\n{text}" for title, text in report.sections)
            text = f"{report.when} took {report.duration:.1f} s\n{report.longreprtext}\n{logs}\n"
            seen.failed[test] = seen.failed.get(test, "") + text
            if SHARING & report.keywords.keys() and test not in seen.with_their_file:
                seen.with_their_file.append(test)
        elif report.skipped and not hasattr(report, "wasxfail"):
            seen.skipped.append(test)
        elif report.when == "call":
            self._passed[test] = None

    def pytest_sessionfinish(self) -> None:
        self._report.passed = [test for test in self._passed if test not in self._report.failed]
        self._file.parent.mkdir(exist_ok=True, parents=True)
        self._file.write_text(json.dumps(asdict(self._report)), encoding="utf-8")
