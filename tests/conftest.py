"""What all tests share."""

import os
import signal

import hypothesis
import pytest

# A slow machine is no finding: an example may take the time that it takes.
hypothesis.settings.register_profile("patient", deadline=None)
hypothesis.settings.load_profile("patient")

_skipped: list[str] = []


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("faults")
    group.addoption(
        "--faults",
        choices=("short", "full"),
        default="short",
        help="full: outages of 60 s and 50 kills, as in docs/reliability.md",
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
        default=200,
        help="how many random damages are done to the spool, the outbox, the clock and the store",
    )


def pytest_configure() -> None:
    """Let programs under test hear Ctrl-C also when the tests run behind a shell's `&`."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        _skipped.append(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """In continuous integration every real component is there, so nothing may be skipped."""
    if _skipped and os.environ.get("CI"):
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        if reporter is not None:
            reporter.write_line(f"skipped in CI, which counts as failed: {_skipped}", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
