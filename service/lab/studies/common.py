"""What all studies share: reports with tables and plots, and work spread over the processors."""

import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Task = TypeVar("Task")
Result = TypeVar("Result")

FIRST_SEED = 200
"""Seed of a study's first bench. No constant of the twin was chosen by looking at these benches."""

_DOTS_PER_INCH = 150


class StudyError(ValueError):
    """A study cannot be run or written as asked; the text is one line."""


Progress = Callable[[float, str], None]
"""Told how far a study has come: a fraction from 0 to 1, and what has been done."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a user may ask of a study; None where nothing was asked.

    Parameters
    ----------
    benches
        How many random benches.
    seed
        Seed of the first bench; the others follow it.
    data
        Folder with recorded data.

    Raises
    ------
    StudyError
        If a number is out of range.
    """

    benches: int | None = None
    seed: int | None = None
    data: Path | None = None

    def __post_init__(self) -> None:
        if self.benches is not None and self.benches < 1:
            raise StudyError(f"--benches {self.benches}: expected 1 or more")
        if self.seed is not None and self.seed < 0:
            raise StudyError(f"--seed {self.seed}: expected 0 or more")

    def given(self) -> set[str]:
        """Names of the fields that were asked for."""
        return {field.name for field in fields(self) if getattr(self, field.name) is not None}

    def seeds(self, benches: int) -> range:
        """Seeds of the benches, where a study by itself takes this many."""
        first = FIRST_SEED if self.seed is None else self.seed
        return range(first, first + (self.benches or benches))


@dataclass(frozen=True, slots=True)
class Table:
    """A table for people; every row has one text per column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [f"### {self.title}", "", _row(self.columns), _row(["---"] * len(self.columns))]
        lines += [_row(row) for row in self.rows]
        for note in self.notes:
            lines += ["", note]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot that is drawn when it is wanted; needs matplotlib."""

    name: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True, slots=True)
class Report:
    """What a study found.

    Parameters
    ----------
    study
        Its name.
    document
        Figures for programs, plain JSON types.
    tables, plots
        The same for people.
    """

    study: str
    document: dict[str, Any]
    tables: tuple[Table, ...]
    plots: tuple[Plot, ...]

    def write(self, folder: Path) -> list[Path]:
        """Write the document, the tables and the plots into a folder; see `prepare`."""
        try:
            written = [folder / f"{self.study}.json", folder / f"{self.study}.md"]
            written[0].write_text(json.dumps(self.document, indent=2) + "\n", encoding="utf-8")
            text = "\n".join(table.markdown() for table in self.tables)
            written[1].write_text(text, encoding="utf-8")
            for plot in self.plots:
                written.append(folder / f"{plot.name}.png")
                plot.draw().savefig(written[-1], dpi=_DOTS_PER_INCH)
        except OSError as error:
            raise StudyError(f"--out {folder}: {error.strerror or error}") from error
        return written


def figure(width_in: float, height_in: float) -> "Figure":
    """A figure that needs no display and no global state of matplotlib."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def prepare(folder: Path) -> None:
    """Make the folder that reports shall be written to, before hours of work are spent on them.

    Raises
    ------
    StudyError
        If that is impossible, or matplotlib is not installed.
    """
    require("matplotlib")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StudyError(f"--out {folder}: {error.strerror or error}") from error
    if not os.access(folder, os.W_OK):
        raise StudyError(f"--out {folder}: cannot be written")


def require(*modules: str) -> None:
    """Check that libraries of the extra ``bench`` are installed.

    Raises
    ------
    StudyError
        If one is missing; says how to install it.
    """
    for module in modules:
        if find_spec(module) is None:
            raise StudyError(f"{module} is not installed: pip install 'bearing-twin[bench]'")


def in_processes(
    function: Callable[[Task], Result], tasks: Sequence[Task], progress: Progress
) -> list[Result]:
    """Apply a function of this package to tasks, one process per processor.

    Numerical libraries run on one thread in each, so that times measured in one process are those
    of one processor. Results are in the order of the tasks. An error ends all processes and is
    raised; so does a signal that raises in this process.

    Parameters
    ----------
    function, tasks
        Both travel to other processes by pickle.
    progress
        Told after each task.
    """
    results: list[Result] = []
    processes = min(len(os.sched_getaffinity(0)), len(tasks))
    context = multiprocessing.get_context("spawn")
    with _one_thread(), ExitStack() as stack:
        # Half a pool would leave processes behind that complain about its end.
        with _signals_afterwards():
            pool = stack.enter_context(context.Pool(processes, _ignore_interrupts))
        for result in pool.imap(function, tasks):
            results.append(result)
            progress(len(results) / len(tasks), f"{len(results)} of {len(tasks)} runs")
    return results


def _ignore_interrupts() -> None:
    """Leave Ctrl-C, which reaches all processes, to the one that started the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _signals_afterwards() -> Iterator[None]:
    """Let requests to stop that come meanwhile take effect at the end; for the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: caught.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if caught:
        signal.raise_signal(caught[0])


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that are started meanwhile compute on one thread each."""
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
