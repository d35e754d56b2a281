"""A command in a forked process does the same as one in a fresh interpreter."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from forking import Commands
from patience import patience


@pytest.fixture(scope="module")
def commands() -> Iterator[Commands]:
    commands = Commands()
    yield commands
    commands.close()


@pytest.mark.wires
@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (["--version"], 0),
        (["keys", "list"], 0),
        (["keys", "revoke", "bt_none"], 2),
        (["serve", "--nonsense"], 2),
        (["check", "-c", "gone.toml"], 2),
    ],
)
def test_output_errors_and_status_are_those_of_a_fresh_interpreter(
    commands: Commands, tmp_path: Path, arguments: list[str], status: int
) -> None:
    forked = commands.run(arguments, tmp_path, os.environ)
    fresh = subprocess.run(
        [sys.executable, "-m", "service", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=patience(180),
        check=False,
    )
    assert forked.returncode == fresh.returncode == status
    assert forked.stderr == fresh.stderr
    assert forked.stdout == fresh.stdout


def test_nothing_of_a_command_is_left_for_the_next(commands: Commands, tmp_path: Path) -> None:
    variables = os.environ | {"BEARING_TWIN__SERVICE__DATA_DIR": str(tmp_path / "one")}
    commands.run(["keys", "create", "--role", "viewer"], tmp_path, variables)
    assert "viewer" in commands.run(["keys", "list"], tmp_path, variables).stdout
    assert "viewer" not in commands.run(["keys", "list"], tmp_path, os.environ).stdout
