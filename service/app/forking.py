"""Makes processes by a fork of this one, which has loaded what they share."""

import asyncio
import importlib
import multiprocessing
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from multiprocessing.context import ForkProcess

from service.app.sides import begin_process
from service.loading import loading

#: What all sides need, loaded before the first of them begins. What one side alone needs it
#: loads itself: here it would be held twice.
PRELOADED = ["service.store", "service.bus.local", "prometheus_client"]
_CONTEXT = multiprocessing.get_context("fork")
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


def preload() -> None:
    """Load what all sides need, where it is not loaded yet."""
    if any(name not in sys.modules for name in PRELOADED):
        with loading():
            for name in PRELOADED:
                importlib.import_module(name)


def start(
    work: Callable[..., None], arguments: tuple[object, ...], kept: Sequence[socket.socket] = ()
) -> ForkProcess:
    """Start a process that has of this one what is loaded, and of its sockets the kept ones."""
    process = _CONTEXT.Process(target=begin_process, args=(work, arguments, kept))
    # A signal for the new process must not reach the loop of this one, whose socket it still has.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
    return process


async def ended(process: ForkProcess) -> None:
    """Wait for the end of a process."""
    loop = asyncio.get_running_loop()
    at_end = asyncio.Event()
    loop.add_reader(process.sentinel, at_end.set)
    try:
        await at_end.wait()
    finally:
        loop.remove_reader(process.sentinel)
