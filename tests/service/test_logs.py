"""What the log of a service holds, and that strangers cannot fill it."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.wires

#: In a process of its own: what is configured there is for the whole process.
PROGRAM = """
import logging, sys
from service.logs import configure_logging
configure_logging()
library = logging.getLogger(sys.argv[1])
for _ in range(1000):
    library.warning("Exceeded concurrency limit.")
library.warning("another")
for _ in range(2):
    try:
        raise ValueError("ours")
    except ValueError:
        library.exception("failed")
"""


@pytest.mark.parametrize("name", ["uvicorn.error", "asyncio"])
def test_a_message_that_strangers_cause_is_logged_once(name: str) -> None:
    program = subprocess.run(
        [sys.executable, "-c", PROGRAM, name], capture_output=True, text=True, check=True
    )
    lines = [json.loads(line) for line in program.stderr.splitlines()]
    events = [line["event"] for line in lines]
    assert events == ["Exceeded concurrency limit.", "another", "failed", "failed"]
    assert (lines[0]["level"], lines[0]["logger"]) == ("warning", name)
