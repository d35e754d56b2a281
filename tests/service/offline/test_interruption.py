"""A computation on the command line ends when it is asked to, wherever the signal meets it."""

import signal
import subprocess
import sys

import pytest
from patience import patience

_IN_A_FINALIZER = """
import os, signal, time
from service.offline.interruption import exit_on_signals

class Finalized:
    def __del__(self):
        print("in the finalizer", flush=True)
        time.sleep(30)  # the signal ends it, and Python drops the exception

with exit_on_signals():
    Finalized()
    print("goes on", flush=True)
    while True:
        time.sleep(0.1)
"""


@pytest.mark.wires
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_in_a_finalizer_ends_the_process_too(number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _IN_A_FINALIZER],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "in the finalizer\n"
    process.send_signal(number)
    try:
        output, errors = process.communicate(timeout=patience(60))
    finally:
        process.kill()
    assert (process.returncode, output) == (0, "goes on\n")
    assert errors.count("stopped; nothing is written") == 1
