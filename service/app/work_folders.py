"""Where a service has its compiled kernels and its temporary files."""

import contextlib
import os
import tempfile
from pathlib import Path

import twin_core
from service.files import make_private_folder


def use_work_folders(data_dir: Path) -> None:
    """Let the data directory take the place of usual folders that cannot be written.

    Without a folder for kernels each process would compile them for itself: half a minute at every
    start, with every job and before the first what-if forecast. Without one for temporary files the
    store could not sort much. Holds for processes and libraries that begin after it.
    """
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        with contextlib.suppress(OSError):  # a start says what is wrong with it
            make_private_folder(data_dir)
        os.environ["TMPDIR"] = str(data_dir.resolve())
    named = os.environ.get("NUMBA_CACHE_DIR")
    package = Path(twin_core.__file__).parent / "simulation" / "__pycache__"
    home = os.environ.get("HOME", "")
    of_user = Path(os.environ.get("XDG_CACHE_HOME") or f"{home}/.cache", "numba")
    if not any(_can_write(one) for one in ([Path(named)] if named else [package, of_user])):
        os.environ["NUMBA_CACHE_DIR"] = str(data_dir.resolve() / "kernels")


def _can_write(folder: Path) -> bool:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)
