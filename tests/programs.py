"""Programs that tests need and that are no Python packages."""

import os
import shutil
from collections.abc import Collection
from pathlib import Path
from typing import NoReturn

import pytest

#: Where the packages of Node.js are that tests use.
FOREIGN = Path(__file__).with_name("foreign")
#: Why a test is skipped; the command that installs what is missing follows.
MISSING = "missing: "
APT = "apt-get install "


def path_of(*commands: str) -> str | None:
    """Path of the first of some commands that this machine has."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin"
    return next((found for name in commands if (found := shutil.which(name, path=path))), None)


def needed(package: str, *commands: str) -> str:
    """Path of a program, without which the test is skipped.

    The last line of the run names all that is missing; where ``CI`` is set the run then fails.
    """
    found = path_of(*(commands or (package,)))
    return found or missing(APT + package)


def node_package(name: str, folder: Path = FOREIGN) -> Path:
    """Folder of a package of Node.js, without which the test is skipped."""
    found = folder / "node_modules" / name
    command = f"npm ci --ignore-scripts --prefix tests/{folder.name}"
    return found if found.is_dir() else missing(command)


def missing(command: str) -> NoReturn:
    """Skip the test, as something is missing that a command installs."""
    pytest.skip(MISSING + command)


def commands_for(commands: Collection[str]) -> str:
    """One line that does all the commands; those of Debian's packages are one."""
    packages = sorted(one.removeprefix(APT) for one in commands if one.startswith(APT))
    others = sorted(one for one in commands if not one.startswith(APT))
    return " && ".join([APT + " ".join(packages)] * bool(packages) + others)
