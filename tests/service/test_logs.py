"""What the log of a service holds, and that strangers cannot fill it."""

import json
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from patience import patience
from unread import Unread

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


#: Logs in a process of its own, and in one that it forks while its own line is not read.
BUSY = """
import logging, os, sys, time
from service.logs import configure_logging
configure_logging()
log = logging.getLogger("ours")
for number in range(3000):
    log.warning("line %d", number)
print("done", flush=True)
child = os.fork()
if not child:
    log.warning("child")
    print("forked", flush=True)
    logging.shutdown()
    os._exit(0)
os.waitpid(child, 0)
sys.stdin.readline()
for number in range(20):
    log.warning("again %d", number)
    time.sleep(0.02)
"""


@pytest.mark.parametrize("kind", ["pipe", "terminal"])
def test_a_process_goes_on_and_ends_whoever_reads_its_log(kind: str) -> None:
    unread = Unread(kind)
    program = subprocess.Popen(
        [sys.executable, "-c", BUSY],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=unread.near,
        text=True,
    )
    said, _ = program.communicate("go on\n", timeout=patience(50))
    assert said.split() == ["done", "forked"]
    assert program.returncode == 0
    assert "line 2999" not in unread.read_all()


def test_what_was_dropped_is_counted_when_the_log_is_read_again() -> None:
    unread = Unread("pipe")
    texts: list[str] = []
    reader = threading.Thread(target=lambda: texts.append(unread.read_all()))
    with subprocess.Popen(
        [sys.executable, "-c", BUSY],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=unread.near,
        text=True,
    ) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        assert [program.stdout.readline() for _ in range(2)] == ["done\n", "forked\n"]
        reader.start()
        program.stdin.write("go on\n")
        program.stdin.close()
        assert program.wait(50) == 0
    reader.join(50)
    lines = [json.loads(line) for line in texts[0].lstrip("x").splitlines()]
    events = [line["event"] for line in lines]
    dropped = sum(line["lines"] for line in lines if line["event"] == "log_lines_dropped")
    shown = sum(event.startswith("line ") for event in events)
    assert (shown + dropped, events.count("again 19")) == (3000, 1)
    assert 1000 <= shown < 1100


def test_a_log_without_any_room_stops_nothing() -> None:
    with Path("/dev/full").open("w") as full:
        program = subprocess.run(
            [sys.executable, "-c", BUSY],
            stderr=full,
            input="\n",
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            timeout=patience(50),
        )
    assert program.stdout.split() == ["done", "forked"]


def test_the_last_words_of_a_refused_command_hold_nothing_up() -> None:
    unread = Unread("pipe")
    command = [sys.executable, "-m", "service", "serve", "-c", "/no/such/file.toml"]
    refused = subprocess.run(command, stderr=unread.near, timeout=patience(50), check=False)
    assert refused.returncode == 2
