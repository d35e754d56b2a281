"""The command line as a user has it: a process with output, error and exit status."""

import os
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest
from forking import Commands
from processes import Command, free_port
from site_files import asset_text

ASSET = asset_text("motor-1")


@pytest.fixture(scope="session")
def commands() -> Iterator[Commands]:
    commands = Commands()
    yield commands
    commands.close()


@pytest.fixture
def cli(commands: Commands, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``bearing-twin ARGUMENTS`` in an empty directory to its end."""

    def run(
        *arguments: str, environment: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        return commands.run(arguments, tmp_path, os.environ | (environment or {}))

    return run


@pytest.fixture
def refused(
    cli: Callable[..., subprocess.CompletedProcess[str]],
) -> Callable[..., str]:
    """Run a command that must end with status 2; returns its one line."""

    def run(*arguments: str, environment: Mapping[str, str] | None = None) -> str:
        ended = cli(*arguments, environment=environment)
        assert ended.returncode == 2, ended.stderr[-3000:]
        assert ended.stdout == ""
        (line,) = ended.stderr.splitlines()
        assert line.startswith("bearing-twin: ")
        return line

    return run


@pytest.fixture
def postponed(
    cli: Callable[..., subprocess.CompletedProcess[str]],
) -> Callable[..., str]:
    """Run a command that must end with status 75, to be tried again; returns its last line."""

    def run(*arguments: str) -> str:
        ended = cli(*arguments)
        assert ended.returncode == os.EX_TEMPFAIL, ended.stderr[-3000:]
        assert ended.stdout == ""
        line = ended.stderr.splitlines()[-1]
        assert line.startswith("bearing-twin: ")
        return line

    return run


@pytest.fixture(scope="session")
def asset() -> str:
    """Lines of a configuration file: a machine whose values are pushed."""
    return ASSET


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def configure(tmp_path: Path, port: int) -> Callable[..., Path]:
    """Write a configuration file; the service's section is given already."""

    def write(text: str = ASSET, service: str = "") -> Path:
        path = tmp_path / "site.toml"
        path.write_text(f'[service]\nport = {port}\ndata_dir = "data"\n{service}\n{text}')
        return path

    return write


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Command]]:
    """Start a command that stays; all are cleared away at the end."""
    started: list[Command] = []

    def run(*arguments: str) -> Command:
        started.append(Command(list(arguments), tmp_path / f"{arguments[0]}.log"))
        return started[-1]

    yield run
    for command in started:
        command.end()
