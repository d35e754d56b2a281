"""Where a command runs does not matter: terminals of few characters, labels that are no line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from patience import patience

pytestmark = pytest.mark.wires


def run(folder: Path, *arguments: str, **environment: str) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run(
        [sys.executable, "-m", "service", *arguments],
        capture_output=True,
        cwd=folder,
        env=os.environ | environment,
        check=False,
        timeout=patience(100),
    )


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_of_few_characters_shows_what_it_can(tmp_path: Path, encoding: str) -> None:
    made = run(tmp_path, "keys", "create", "--role", "viewer", "--label", "Pr\u00fcfstand \u2026")
    assert made.returncode == 0, made.stderr
    listed = run(tmp_path, "keys", "list", PYTHONIOENCODING=encoding)
    assert (listed.returncode, listed.stderr) == (0, b"")
    assert b"fstand ?" in listed.stdout


@pytest.mark.parametrize("label", ["a\nb", "a\n", "x" * 101, "\x1b[31m", "a\u202eb", "\udc9b"])
def test_a_label_that_is_no_line_is_refused_in_one(tmp_path: Path, label: str) -> None:
    refused = run(tmp_path, "keys", "create", "--role", "viewer", "--label", label)
    expected = (
        b"bearing-twin: label: expected at most 100 characters on one line, and no control "
        b"characters\n"
    )
    assert (refused.returncode, refused.stderr) == (2, expected)
