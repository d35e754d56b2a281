"""Commands as a user calls them, each in a process of its own, that need not import all anew.

One process imports what the commands need and forks itself for each of them: of hundreds of calls,
each takes a second of processor time less. What a command prints, how it ends, and that nothing of
it is left for the next one are the same as with a fresh interpreter.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

_PARENT = """
import importlib, json, logging, os, sys, traceback
from service.cli import main
for name in ("service.app.serve", "service.app.checking", "service.store", "rich.table"):
    importlib.import_module(name)

def run(order):
    os.chdir(order["folder"])
    os.environ.clear()
    os.environ.update(order["environment"])
    for number, name in enumerate((os.devnull, order["out"], order["error"])):
        file = os.open(name, os.O_RDWR | os.O_CREAT)
        os.dup2(file, number)
        os.close(file)
    sys.argv = ["bearing-twin", *order["arguments"]]
    try:
        main()
        status = 0
    except SystemExit as end:
        status = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    logging.shutdown()
    os._exit(status)

print(flush=True)
for line in sys.stdin:
    child = os.fork()
    if not child:
        run(json.loads(line))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Commands:
    """The process that has imported everything, and the commands that it runs one by one."""

    def __init__(self) -> None:
        self._folder = TemporaryDirectory()
        self._process = subprocess.Popen(
            [sys.executable, "-c", _PARENT],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            # A process with threads had better not fork.
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it has imported everything

    def run(
        self, arguments: Sequence[str], folder: Path, environment: Mapping[str, str]
    ) -> "subprocess.CompletedProcess[str]":
        """Run ``bearing-twin ARGUMENTS`` to its end."""
        out, error = (Path(self._folder.name, name) for name in ("out", "error"))
        for file in (out, error):
            file.unlink(missing_ok=True)
        order = {
            "arguments": list(arguments),
            "folder": str(folder),
            "environment": dict(environment),
            "out": str(out),
            "error": str(error),
        }
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        status = int(self._process.stdout.readline())
        return subprocess.CompletedProcess([*arguments], status, out.read_text(), error.read_text())

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()
        self._folder.cleanup()
