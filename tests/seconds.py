"""Seconds per file of tests: recorded in each run, and the order in which files are handed out.

``tests/seconds.json`` holds those of a whole run on two idle cores. A run writes its own to
``build/test-seconds.json`` and names the files that took half as long again; ``make seconds`` keeps
the new figures.
"""

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

#: Files, by the beginning of their paths, whose tests share something that is slow to start: one
#: worker of pytest-xdist runs them all; other files go one by one.
TOGETHER = (
    r"tests/browser/",
    r"tests/faults/test_wires",
    r"tests/service/offline/",
    r"tests/twin_core/identification/",
)
#: Files of tests that start whole services, with processes that keep more than one core at work.
#: One worker runs them, one after another, while the others run the rest: with two of them at the
#: same time what one of them waits for comes too late for reasons that the other one has.
WHOLE_SERVICES = (
    r"tests/(browser/(?!.*_parts)|faults|foreign|integration/(?!adapters)|security)"
    r"|tests/service/cli/test_serve"
)
RECORDED = Path(__file__).with_suffix(".json")
MEASURED = Path(__file__).parents[1] / "build" / "test-seconds.json"
#: A file grew when it takes this many times its recorded seconds, and this many seconds more.
GROWN, GROWN_S = 1.5, 5.0
#: So many files are printed with their seconds after each run of more.
SLOWEST = 10


def recorded() -> dict[str, float]:
    """Seconds of each file in the run that was kept."""
    seconds: dict[str, float] = json.loads(RECORDED.read_text()) if RECORDED.exists() else {}
    return seconds


def group(nodeid: str) -> str:
    """What a test is handed out with."""
    file = file_of(nodeid)
    if file.endswith("_parts.py"):  # modules of the page alone, without a service
        return file
    return next((together for together in TOGETHER if re.match(together, file)), file)


def file_of(nodeid: str) -> str:
    """The file of a test."""
    return nodeid.partition("::")[0]


def longest_first(items: Sequence[pytest.Item], seconds: dict[str, float]) -> list[pytest.Item]:
    """Tests in the order in which they are handed out: the group with most seconds first."""
    totals: Counter[str] = Counter()
    for file in {file_of(item.nodeid) for item in items}:
        totals[group(file)] += seconds.get(file, 0.0)
    return sorted(items, key=lambda item: -totals[group(item.nodeid)])


class Sharing(LoadScopeScheduling):
    """Hands out files, and groups of files, in the order in which they were collected."""

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)

    def _assign_work_unit(self, node: WorkerController) -> None:
        """Give tests of whole services to the first worker, and the rest to the others."""
        services = node is self.nodes[0]
        for scope in self.workqueue:
            if bool(re.match(WHOLE_SERVICES, scope)) == services:
                self.workqueue.move_to_end(scope, last=False)
                break
        super()._assign_work_unit(node)


class Seconds:
    """Records what each file takes, fixtures included."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()

    def pytest_xdist_make_scheduler(self, config: pytest.Config, log: Producer) -> Sharing:
        return Sharing(config, log)

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = longest_first(items, recorded())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self._taken[file_of(report.nodeid)] += report.duration

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, config: pytest.Config
    ) -> None:
        if any("::" in argument for argument in config.args):
            return  # some tests of a file do not say what the file takes
        taken = {file: round(seconds, 2) for file, seconds in sorted(self._taken.items())}
        MEASURED.parent.mkdir(exist_ok=True)
        earlier = json.loads(MEASURED.read_text()) if MEASURED.exists() else {}
        MEASURED.write_text(json.dumps(earlier | taken, indent=0, sort_keys=True) + "\n")
        if len(taken) > SLOWEST:
            slowest = sorted(taken, key=lambda file: -taken[file])[:SLOWEST]
            terminalreporter.write_line(f"the {SLOWEST} files that took longest:")
            for file in slowest:
                terminalreporter.write_line(f"{taken[file]:7.1f} s {file}")
        before = recorded()
        for file, seconds in taken.items():
            if file in before and seconds > max(GROWN * before[file], before[file] + GROWN_S):
                terminalreporter.write_line(
                    f"{file} took {seconds:.0f} s, recorded are {before[file]:.0f} s", yellow=True
                )
