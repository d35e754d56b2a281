"""What can go wrong with the store."""

import errno
import sqlite3

from service.domain.errors import (
    BearingTwinError,
    CellUnavailableError,
    ServiceError,
    TemporaryError,
)

#: The state of a disk or of the machine; what is wrong with a path or with rights does not pass.
_PASSING_ERRNOS = frozenset(
    {
        errno.EAGAIN,
        errno.EBUSY,
        errno.EDQUOT,
        errno.EINTR,
        errno.EIO,
        errno.EMFILE,
        errno.ENFILE,
        errno.ENOMEM,
        errno.ENOSPC,
        errno.ESTALE,
        errno.ETIMEDOUT,
    }
)
_PASSING_CODES = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_NOMEM,
        sqlite3.SQLITE_PROTOCOL,
    }
)


class StoreError(ServiceError):
    """The store cannot be used as it is configured; the text is one line for the user.

    A person must mend it, unless it is a `StoreUnavailableError`.
    """


class StoreUnavailableError(StoreError, TemporaryError):
    """The store does not answer now (locked, disk full, server away, I/O error); try again."""


class DataDirectoryInUseError(StoreUnavailableError):
    """Another service works on this data directory."""


class DatabaseInUseError(StoreUnavailableError):
    """Another service works on this database."""


class NotOwnerError(StoreError, CellUnavailableError):
    """Another cell owns the asset: what this one knows of it must not be written any more."""


class StoreDoubtedError(StoreUnavailableError):
    """The store is another one, or lacks what it confirmed: what is to be stored waits."""


class StoreDamagedError(StoreUnavailableError):
    """The store's file is damaged; the text is one line that says what to do.

    A running service goes on onto the spool; a start ends.
    """

    passes = False


class ActiveJobError(BearingTwinError):
    """An identification job of this asset is already queued or running."""

    def __init__(self, job_id: str) -> None:
        super().__init__(f"job {job_id} is already queued or running for this asset")
        self.job_id = job_id


def passes(cause: BaseException | None) -> bool:
    """Whether an error of the operating system or of SQLite is temporary."""
    if isinstance(cause, OSError):
        return cause.errno in _PASSING_ERRNOS
    # The low byte is the kind of error, the others say more about it.
    return isinstance(cause, sqlite3.Error) and (
        getattr(cause, "sqlite_errorcode", 0) & 0xFF in _PASSING_CODES
    )


def opening_error(text: str, cause: BaseException | None) -> StoreError:
    """Make the error of a file that could not be opened, of the kind that its cause is."""
    return StoreUnavailableError(text) if passes(cause) else StoreError(text)
