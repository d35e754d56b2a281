"""How long the faults last, and the table of what became of the samples."""

import functools
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from faults.hall import BACK_S, Hall, Outcome

_OUTCOMES = pytest.StashKey[list[Outcome]]()


class Extent(NamedTuple):
    """How much a run of the faults takes upon itself."""

    outage_s: float
    kills: int


SHORT, FULL = Extent(2.0, 3), Extent(60.0, 50)


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_OUTCOMES] = []


@pytest.fixture(scope="session")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hall]:
    """One hall for all tests that leave it running: a start takes longer than most faults."""
    with Hall(tmp_path_factory.mktemp("hall")).running() as hall:
        yield hall


@pytest.fixture(scope="session")
def preloaded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Compile what stands between a service and the C library: the value of LD_PRELOAD."""

    @functools.cache
    def made(name: str) -> str:
        compiler = shutil.which("cc")
        assert compiler is not None, "a C compiler is needed: apt-get install gcc libc6-dev"
        library = tmp_path_factory.mktemp("library") / f"{name}.so"
        source = Path(__file__).with_name(f"{name}.c")
        command = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(library)]
        subprocess.run([*command, str(source), "-ldl"], check=True)
        return str(library)

    return made


@pytest.fixture
def extent(pytestconfig: pytest.Config) -> Extent:
    return FULL if pytestconfig.getoption("--faults") == "full" else SHORT


@pytest.fixture
def tell(pytestconfig: pytest.Config) -> Callable[[Outcome], None]:
    """Take a row for the table at the end of the run."""
    return pytestconfig.stash[_OUTCOMES].append


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    config = terminalreporter.config
    outcomes = config.stash.get(_OUTCOMES, [])
    if not outcomes:
        return
    write = terminalreporter.write_line
    terminalreporter.section("faults: what became of the samples")
    columns = ("fault", "sent", "stored", "skipped", "on the wire", "twice", "order", "back in s")
    write(f"| {' | '.join(columns)} |")
    write(f"|{' --- |' * len(columns)}")
    for one in outcomes:
        count, times = one.count, sorted(one.recoveries_s)
        back = "" if not times else f"{times[-1]:.1f}"
        if len(times) > 1:
            back = f"{times[len(times) // 2]:.1f} (at most {times[-1]:.1f})"
        late = sum(time > BACK_S for time in times)
        back += f", {late} of {len(times)} late" if late else ""
        write(
            f"| {one.fault} | {count.sent:,} | {count.stored:,} | {one.skipped:,} "
            f"| {count.missing - one.skipped:,} | {count.duplicates} "
            f"| {'kept' if count.in_order else 'BROKEN'} | {back} |"
        )
    for one in outcomes:
        if one.note:
            write(f"{one.fault}: {one.note}")
