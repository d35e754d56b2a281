"""Work spread over the processors, and ended as a whole."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")

Progress = Callable[[float, str], None]
"""Called with how far the work has come: a fraction from 0 to 1, and what has been done."""


def in_processes(
    function: Callable[[Task], Result], tasks: Sequence[Task], progress: Progress
) -> list[Result]:
    """Apply a function of this package to tasks, one process per processor.

    Numerical libraries run on one thread in each, so that times measured in one process are those
    of one processor. Results are in the order of the tasks. An error ends all processes and is
    raised; so does a signal that raises in this process.

    - ``function``, ``tasks``: both travel to other processes by pickle.
    - ``progress``: called after each task.
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
