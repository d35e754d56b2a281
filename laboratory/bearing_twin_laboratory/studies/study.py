"""What all studies share: a declaration of cases, runner, figures, tables and plots.

A study is declared once (`Study`): which cases there are, what is done with one of them in a
process of its own, and how figures, tables and plots follow from all results. Running it in
parallel, writing and drawing are the same for all.
"""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from bearing_twin_laboratory.studies.processes import Progress, in_processes
from service.cli.errors import BadInputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Case = TypeVar("Case")
Result = TypeVar("Result")
Row = TypeVar("Row")
Document = dict[str, Any]
Drawing = Callable[[], "Figure"]
"""Draws one plot when it is wanted; needs matplotlib."""

FIRST_SEED = 200
"""Seed of a study's first bench. No constant of the twin was chosen by looking at these benches."""

_DOTS_PER_INCH = 150


class StudyError(BadInputError):
    """A study cannot be run or written as asked; the text is one line."""


@dataclass(frozen=True, slots=True)
class Options:
    """What a user may ask of a study; None where nothing was asked.

    - ``benches``: how many random benches.
    - ``seed``: seed of the first bench; the others follow it.
    - ``data``: folder with recorded data.
    - ``quick``: whether the study runs on few and short cases: all of it works, no figure is to be
      quoted.

    Raises `StudyError` if a number is out of range.
    """

    benches: int | None = None
    seed: int | None = None
    data: Path | None = None
    quick: bool = False

    def __post_init__(self) -> None:
        if self.benches is not None and self.benches < 1:
            raise StudyError(f"--benches {self.benches}: expected 1 or more")
        if self.seed is not None and self.seed < 0:
            raise StudyError(f"--seed {self.seed}: expected 0 or more")

    def given(self) -> set[str]:
        """Names of the fields that were asked for and that not every study takes."""
        return {name for name in ("benches", "seed", "data") if getattr(self, name) is not None}

    def seeds(self, benches: int) -> range:
        """Seeds of the benches, where a study takes this many by default; one where it is quick."""
        first = FIRST_SEED if self.seed is None else self.seed
        return range(first, first + (self.benches or (1 if self.quick else benches)))


@dataclass(frozen=True, slots=True)
class Table:
    """A table for people; every row has one text per column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """The table as Markdown."""
        cells = [self.columns, ["---"] * len(self.columns), *self.rows]
        lines = [f"### {self.title}", "", *("| " + " | ".join(row) + " |" for row in cells)]
        for note in self.notes:
            lines += ["", note]
        return "\n".join(lines) + "\n"


def table(
    title: str,
    rows: Iterable[Row],
    columns: Sequence[tuple[str, Callable[[Row], str]]],
    *notes: str,
) -> Table:
    """Make a table of rows of any kind: each column has a heading and shows a row as a text."""
    return Table(
        title,
        tuple(heading for heading, _ in columns),
        tuple(tuple(shown(row) for _, shown in columns) for row in rows),
        notes,
    )


def cell(path: str, show: Callable[..., str] = str, *how: Any) -> Callable[[Document], str]:
    """Show what lies at a path of keys, such as ``paper.max_error_c``; None on the way stays None.

    - ``path``: keys with dots between them.
    - ``show``: makes a text of the value.
    - ``how``: further arguments of ``show``.
    """
    keys = path.split(".")

    def shown(row: Document) -> str:
        value: Any = row
        for key in keys:
            value = None if value is None else value[key]
        return show(value, *how)

    return shown


def named(found: Mapping[str, Mapping[str, object]]) -> list[Document]:
    """Rows of a table from figures by name; the name is one of them."""
    return [{"name": name, **figures} for name, figures in found.items()]


def text(value: float | None, digits: int = 2) -> str:
    """A figure as it stands in the tables."""
    return "–" if value is None else f"{value:.{digits}f}"


def share(value: float | None, digits: int = 0) -> str:
    """A share in percent as it stands in the tables."""
    return "–" if value is None else f"{100.0 * value:.{digits}f}"


def mean(values: Iterable[float]) -> float | None:
    """Mean of what there is; None of nothing."""
    import numpy as np  # the command line lists the studies without it

    known = list(values)
    return float(np.mean(known)) if known else None


@dataclass(frozen=True, slots=True)
class Report:
    """What a study found.

    - ``study``: its name.
    - ``document``: figures for programs, plain JSON types.
    - ``tables``, ``plots``: the same for people.
    """

    study: str
    document: Document
    tables: tuple[Table, ...]
    plots: Mapping[str, Drawing]

    def write(self, folder: Path) -> list[Path]:
        """Write the document, the tables and the plots into a folder; see `prepare`."""
        try:
            written = [folder / f"{self.study}.json", folder / f"{self.study}.md"]
            written[0].write_text(json.dumps(self.document, indent=2) + "\n", encoding="utf-8")
            tables = "\n".join(one.markdown() for one in self.tables)
            written[1].write_text(tables, encoding="utf-8")
            for name, draw in self.plots.items():
                written.append(folder / f"{name}.png")
                draw().savefig(written[-1], dpi=_DOTS_PER_INCH)
        except OSError as error:
            raise StudyError(f"--out {folder}: {error.strerror or error}") from error
        return written


def _no_plots(results: Any, document: Document) -> Mapping[str, Drawing]:
    return {}


@dataclass(frozen=True, slots=True)
class Study(Generic[Case, Result]):
    """A study, declared.

    - ``name``: as a user asks for it.
    - ``cases``: what is examined, by what was asked for.
    - ``examine``: examines one case, in a process of its own; case and result travel there by
      pickle.
    - ``figures``: all results as plain JSON types.
    - ``tables``, ``plots``: all results, and the document that ``figures`` made of them, for
      people.
    - ``libraries``: what must be installed beyond the product's own.
    """

    name: str
    cases: Callable[[Options], Sequence[Case]]
    examine: Callable[[Case], Result]
    figures: Callable[[Sequence[Result]], Document]
    tables: Callable[[Sequence[Result], Document], Iterable[Table]]
    plots: Callable[[Sequence[Result], Document], Mapping[str, Drawing]] = _no_plots
    libraries: tuple[str, ...] = ()

    def run(self, progress: Progress, options: Options) -> Report:
        """Examine all cases, one process per processor.

        Raises `StudyError` if a library is not installed, or the options do not do.
        """
        require(*self.libraries)
        return self.report(in_processes(self.examine, self.cases(options), progress))

    def report(self, results: Sequence[Result]) -> Report:
        """Put results together into figures, tables and plots."""
        document = {"study": self.name, **self.figures(results)}
        return Report(
            self.name,
            document,
            tuple(self.tables(results, document)),
            self.plots(results, document),
        )


def figure(width_in: float, height_in: float) -> "Figure":
    """A figure that needs no display and no global state of matplotlib."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def prepare(folder: Path) -> None:
    """Make the folder that reports shall be written to, before hours of work are spent on them.

    Raises `StudyError` if that is impossible, or matplotlib is not installed.
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

    Raises `StudyError` if one is missing; says how to install it.
    """
    for module in modules:
        if find_spec(module) is None:
            raise StudyError(f"{module} is not installed: pip install 'bearing-twin[bench]'")
