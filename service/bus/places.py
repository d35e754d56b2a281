"""Where the sockets of a local bus are."""

import hashlib
import os
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
    if len(os.fsencode(data_dir / COMMANDS)) <= LONGEST:
        return data_dir
    digest = hashlib.blake2b(os.fsencode(data_dir), digest_size=8).hexdigest()
    name = f"bearing-twin-{os.getuid()}-{digest}"
    bases = [os.environ.get("XDG_RUNTIME_DIR", ""), os.environ.get("TMPDIR", ""), *_ANY_USER]
    refused = []
    for base in (Path(one) for one in bases if one):
        if why := _why_not(base / name):
            refused.append(f"{base}: {why}")
        else:
            return base / name
    raise ServiceError(
        f"the path of data_dir {data_dir} is too long for local sockets, and they have no other "
        f"place ({'; '.join(refused)}); expected XDG_RUNTIME_DIR to name a folder of this user "
        "with a short path"
    )


def _why_not(folder: Path) -> str:
    """Try to make a folder for sockets; empty where it is there."""
    if len(os.fsencode(folder / COMMANDS)) > LONGEST:
        return "too long a path"
    try:
        make_private_folder(folder)
        return "" if folder.stat().st_uid == os.getuid() else "of another user"
    except OSError as error:
        return error.strerror or str(error)
