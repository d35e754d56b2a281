"""Where the sockets of a local bus are."""

import hashlib
import os
import tempfile
from pathlib import Path

from service.files import make_private_folder

#: Longest path of a local socket, in bytes.
LONGEST = 107
CHANGES, COMMANDS = "bus-changes", "bus-commands"


def bus_folder(data_dir: Path) -> Path:
    """Give the folder of the sockets of a data directory; the same for all its processes.

    It is the data directory, or a private folder of the user where that has too long a path.

    Raises
    ------
    OSError
        If the folder cannot be made, or belongs to someone else.
    """
    data_dir = data_dir.resolve()
    if len(os.fsencode(data_dir / COMMANDS)) <= LONGEST:
        return data_dir
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    name = hashlib.blake2b(os.fsencode(data_dir), digest_size=8).hexdigest()
    base = Path(runtime) if runtime else Path(tempfile.gettempdir())
    folder = base / f"bearing-twin-{os.getuid()}-{name}"
    make_private_folder(folder)
    if folder.stat().st_uid != os.getuid():
        raise PermissionError(f"{folder} belongs to another user")
    return folder
