"""One service per data directory, and per SQLite file."""

import contextlib
import fcntl
import os
from pathlib import Path

from service.files import make_private_folder
from service.store.closable import Closable
from service.store.errors import DatabaseInUseError, DataDirectoryInUseError, opening_error

LOCK_FILE = "service.lock"
#: Locks of this process: another descriptor of the same file would find them taken.
_held: set[Path] = set()


class DataDirectoryLock(Closable):
    """The right to run a service on a data directory or a file, until closed or the process ends.

    The operating system drops the lock when the process ends, however it ends. Raises
    `BlockingIOError` if another program has it; the text names its process. Raises `OSError` if the
    file cannot be made or written.
    """

    def __init__(self, path: Path) -> None:
        self.lost = ""
        self._path = path.resolve()
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        self._descriptor = os.open(path, flags, 0o600)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(self._descriptor, 32).decode(errors="replace").strip()
            os.close(self._descriptor)
            raise BlockingIOError(f" (process {holder})" if holder else "") from None
        # Who holds it is a help for people; a full disk does not take it, and need not.
        with contextlib.suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.write(self._descriptor, f"{os.getpid()}\n".encode())
        _held.add(self._path)

    def close(self) -> None:
        """Release the lock."""
        if self._descriptor >= 0:
            _held.discard(self._path)
            os.close(self._descriptor)
            self._descriptor = -1


def lock_data_directory(data_dir: Path) -> DataDirectoryLock:
    """Take a data directory for one service; tools that only open the store need no lock.

    Raises `DataDirectoryInUseError` if another service has it; `StoreError` if the directory cannot
    be made or written.
    """
    try:
        make_private_folder(data_dir)
        return DataDirectoryLock(data_dir / LOCK_FILE)
    except BlockingIOError as error:
        raise DataDirectoryInUseError(
            f"data directory {data_dir}: another service is running on it{error}; "
            "stop that one or give this one another service.data_dir"
        ) from None
    except OSError as error:
        raise opening_error(
            f"data directory {data_dir}: cannot be used ({error.filename}: {error.strerror})", error
        ) from error


def lock_sqlite_file(path: Path) -> DataDirectoryLock:
    """Take an SQLite file for one service, whatever its data directory.

    Raises `DatabaseInUseError` if another service has it; `StoreError` if the lock next to it
    cannot be made or written.
    """
    lock = _lock_of(path)
    try:
        return DataDirectoryLock(lock)
    except BlockingIOError as error:
        raise DatabaseInUseError(
            f"store {path}: another service is running on it{error}; "
            "stop that one or give this one another service.database_url"
        ) from None
    except OSError as error:
        raise opening_error(
            f"store {path}: cannot be locked ({lock}: {error.strerror})", error
        ) from error


def who_uses(path: Path) -> str | None:
    """Which other service works on an SQLite file, as " (process N)"; None if none does."""
    for lock in (_lock_of(path), path.parent / LOCK_FILE):
        if not lock.exists() or lock.resolve() in _held:
            continue
        try:
            DataDirectoryLock(lock).close()
        except BlockingIOError as error:
            return str(error)
        except OSError:
            continue
    return None


def _lock_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.lock")
