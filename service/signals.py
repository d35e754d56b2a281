"""Clean ends: SIGTERM and SIGINT set an event, the command then ends with status 0."""

import asyncio
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterable

import structlog

_THREADS_WALL_S = 0.5

_log = structlog.get_logger(__name__)


def stop_on_signals(
    signals: Iterable[signal.Signals] = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP),
) -> asyncio.Event:
    """Return an event that the signals set; to be called in the running loop.

    Who was started to outlive its terminal (``nohup``) does.
    """
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in signals:
        if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
            continue
        loop.add_signal_handler(number, stop.set)
    return stop


async def leave_tasks_behind() -> None:
    """End the process with status 0 if tasks still wait for a store that does not answer.

    `asyncio.run` would wait for them as long as they take: requests, and threads behind them.
    """
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    if others:
        _, left = await asyncio.wait(others, timeout=_THREADS_WALL_S)
        if left:
            _log.warning("tasks_left_behind", tasks=sorted(task.get_name() for task in left))
            sys.stdout.flush()
            logging.shutdown()
            os._exit(0)


def leave_threads_behind() -> None:
    """End the process with status 0 if threads still wait for a store that does not answer.

    Python itself would wait for them as long as they take. What they were to write was given up,
    and logged, by the code that waited for it.
    """
    deadline = time.monotonic() + _THREADS_WALL_S
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join(max(deadline - time.monotonic(), 0.0))
            if thread.is_alive():
                _log.warning("thread_left_behind", thread=thread.name)
                sys.stdout.flush()
                logging.shutdown()
                os._exit(0)
