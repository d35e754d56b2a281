"""One service per data directory."""

import contextlib
import fcntl
import os
from pathlib import Path

from service.store.closable import Closable
from service.store.errors import DataDirectoryInUseError, opening_error

LOCK_FILE = "service.lock"


class DataDirectoryLock(Closable):
    """The right to run a service on a data directory, until closed or the process ends."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def close(self) -> None:
        """Give the directory free."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def lock_data_directory(data_dir: Path) -> DataDirectoryLock:
    """Take a data directory for one service; tools that only open the store need no lock.

    The operating system drops the lock when the process ends, however it ends.

    Parameters
    ----------
    data_dir : pathlib.Path
        Made when it does not exist.

    Raises
    ------
    DataDirectoryInUseError
        If another service has it.
    StoreError
        If the directory cannot be made or written.
    """
    path = data_dir / LOCK_FILE
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise opening_error(
            f"data directory {data_dir}: cannot be used ({error.filename}: {error.strerror})", error
        ) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(descriptor, 32).decode(errors="replace").strip()
        os.close(descriptor)
        raise DataDirectoryInUseError(
            f"data directory {data_dir}: another service is running on it"
            f"{f' (process {holder})' if holder else ''}; "
            "stop that one or give this one another service.data_dir"
        ) from None
    # Who holds it is a help for people; a full disk does not take it, and need not.
    with contextlib.suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
    return DataDirectoryLock(descriptor)
