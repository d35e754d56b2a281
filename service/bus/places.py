"""Where the sockets of a local bus are."""

import hashlib
import os
import stat
from pathlib import Path

from service.domain.errors import ServiceError
from service.files import make_private_folder

#: Longest path of a local socket, in bytes.
LONGEST = 107
# Where every user may write, unless it is mounted otherwise.
_ANY_USER = ("/tmp", "/var/tmp", "/dev/shm")
CHANGES, COMMANDS = "bus-changes", "bus-commands"


def bus_folder(data_dir: Path) -> Path:
    """Give the folder of the sockets of a data directory; the same for all its processes.

    It is the data directory, or a private folder of the user where that has too long a path.

    Raises
    ------
    ServiceError
        If there is no place for it.
    """
    data_dir = data_dir.resolve()
    if _is_short(data_dir):
        return data_dir
    digest = hashlib.blake2b(os.fsencode(data_dir), digest_size=8).hexdigest()
    name = f"bearing-twin-{os.getuid()}-{digest}"
    named = [os.environ.get("XDG_RUNTIME_DIR", ""), os.environ.get("TMPDIR", "")]
    bases = [Path(one).absolute() for one in (*named, *_ANY_USER) if one]
    # By names alone: all processes of a service must find the same one.
    fits = (one for one in bases if os.access(one, os.W_OK | os.X_OK) and _is_short(one / name))
    base = next(fits, None)
    why = "there is no other place with a short path" if base is None else _why_not(base / name)
    if why or base is None:
        raise ServiceError(
            f"data_dir {data_dir} has too long a path for local sockets, and {why}; expected "
            "XDG_RUNTIME_DIR to name a folder of this user with a short path"
        )
    return base / name


def _is_short(folder: Path) -> bool:
    return len(os.fsencode(folder / COMMANDS)) <= LONGEST


def _why_not(folder: Path) -> str:
    """Make a folder for sockets; says why it cannot be had."""
    try:
        make_private_folder(folder)
        there = folder.lstat()
    except OSError as error:
        return f"{folder} cannot be made ({error.strerror})"
    is_ours = stat.S_ISDIR(there.st_mode) and there.st_uid == os.getuid()
    return "" if is_ours else f"{folder} is not of this user"
