"""What the report of a failed test says beside its traceback: logs, ports, load, seconds."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from leftovers import ports, processes, sockets

LINES = 30
#: Of the newest logs; a stand of several cells writes more than one can read.
LOGS = 8
#: Its fixtures may have written the last lines before the test itself began.
BEFORE_S = 5.0


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report: pytest.TestReport = yield
    if report.failed:
        report.sections.append(("machine", _machine(report.duration)))
        folder: Path = item.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
        report.sections += _logs(folder, time.time() - report.duration - BEFORE_S)
    return report


def _machine(duration_s: float) -> str:
    load = " ".join(f"{one:.1f}" for one in os.getloadavg())
    lines = [
        f"{duration_s:.1f} s, load {load} on {os.cpu_count()} processors",
        f"ports of this process: {', '.join(sorted(ports(sockets()))) or 'none'}",
        *(f"runs: {command}" for command in sorted(processes())),
    ]
    return "\n".join(lines)


def _logs(folder: Path, since_s: float) -> Iterator[tuple[str, str]]:
    """The last lines of the logs that were written since then."""
    written = [(file.stat().st_mtime, file) for file in folder.rglob("*.log") if file.is_file()]
    newest = sorted(one for one in written if one[0] >= since_s)[-LOGS:]
    for _, file in newest:
        lines = file.read_text(errors="replace").splitlines()[-LINES:]
        yield f"log {file.relative_to(folder)}", "\n".join(lines)
