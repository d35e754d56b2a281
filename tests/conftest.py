"""What all tests share."""

import gc
import importlib
import os
import signal
from collections import Counter
from collections.abc import Iterator

import hypothesis
import pytest
from failure_report import pytest_runtest_makereport
from leftovers import no_task_left, nothing_left
from outside import pytest_runtest_call
from patience import patience, slowness
from programs import MISSING, commands_for
from seconds import Seconds

__all__ = ["no_task_left", "nothing_left", "pytest_runtest_call", "pytest_runtest_makereport"]

# One thread of linear algebra in each worker: several workers share the cores, and threads that
# spin while they wait took ten times the processor time. Programs that tests start have what a
# user's have.
with pytest.MonkeyPatch.context() as patch:
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        patch.setenv(name, "1")
    for name in ("numpy", "scipy.linalg"):
        importlib.import_module(name)

# A slow machine is no finding: an example may take the time that it takes.
hypothesis.settings.register_profile("patient", deadline=None)
hypothesis.settings.load_profile("patient")

_skipped: list[str] = []
#: Commands that install what is missing, and how many tests were skipped for it.
_installs: Counter[str] = Counter()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("faults")
    group.addoption(
        "--faults",
        choices=("short", "full"),
        default="short",
        help="full: outages of 60 s and 50 kills, as in docs/run/reliability.md",
    )
    group.addoption(
        "--soak-minutes",
        type=float,
        default=0.1,
        help="how long random faults strike a bench at 60 times the speed of life",
    )
    group.addoption(
        "--damages",
        type=int,
        default=100,
        help="how many random damages are done to the spool, the outbox, the clock and the store",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Let programs under test hear Ctrl-C also when the tests run behind a shell's `&`."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.pluginmanager.register(Seconds())
    slowness()  # measured before there are workers


def pytest_report_header() -> str:
    return f"waits: {slowness():g} times those of an ordinary machine"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Give each test more time on a slow machine, by the factor of all waits."""
    if slowness() > 1.0:
        usual = config.getini("timeout")
        for item in items:
            own = item.get_closest_marker("timeout")
            seconds = usual if own is None else own.args[0]
            if seconds:
                limit = pytest.mark.timeout(patience(float(seconds)))
                item.add_marker(limit, append=False)


def pytest_collection_finish() -> None:
    """Keep all that was collected out of later collections of garbage, of which tests make many."""
    gc.collect()
    gc.freeze()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        _skipped.append(report.nodeid)
        reason = str(report.longrepr[2]) if isinstance(report.longrepr, tuple) else ""
        _, missing, install = reason.partition(MISSING)
        if missing:
            _installs[install] += 1


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Iterator[None]:
    """In continuous integration nothing may be skipped; what is missing stands in the last line."""
    if _skipped and os.environ.get("CI") and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    yield
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:
        return
    if _skipped and os.environ.get("CI"):
        reporter.write_line(f"skipped in CI, which counts as failed: {len(_skipped)}", red=True)
    if _installs:
        reporter.write_line(
            f"{_installs.total()} tests skipped, as programs are missing: "
            f"{commands_for(_installs)}",
            red=True,
        )
