"""The bar that long work shows on a terminal, and its lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from service.cli.consoles import make_console


@contextmanager
def progress_bar(
    title: str, line_every_s: float | None = None
) -> Iterator[Callable[[float, str], None]]:
    """Yield what to call with the fraction done.

    ``line_every_s``: without a terminal, the wall seconds between lines on standard error; absent:
    no lines.
    """
    console = make_console(stderr=True)
    shown_s = time.monotonic()
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %  {task.fields[done]}", markup=False),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, total=1.0, done="")

        def report(fraction: float, text: str) -> None:
            nonlocal shown_s
            bar.update(task, completed=fraction, done=text)
            now_s = time.monotonic()
            if line_every_s is None or console.is_terminal or now_s < shown_s + line_every_s:
                return
            shown_s = now_s
            sys.stderr.write(f"{title}: {100 * fraction:.0f} % {text}".rstrip() + "\n")
            sys.stderr.flush()

        yield report
