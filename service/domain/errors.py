"""Errors that several parts of the service raise and understand."""


class BearingTwinError(Exception):
    """The root of all errors of the service."""


class ServiceError(BearingTwinError):
    """A disk, a server or an address cannot be used; the text is one line for the user.

    A person must mend it (exit status 2), unless it is a `TemporaryError`.
    """


class TemporaryError(ServiceError):
    """A temporary error: a port still in use, a store that is not there yet.

    The service waits for its end; a command that cannot wait ends with status 75.

    - ``passes``: False where only a running service may hope for its end, and a start may not.
    """

    passes = True


class ChangedMeanwhileError(BearingTwinError):
    """Somebody else changed what a change was made of; the text says what."""


class JobConflictError(BearingTwinError):
    """A job runs for this asset already."""

    def __init__(self, text: str, job: object) -> None:
        super().__init__(text)
        self.job = job


class KeyUsedBeforeError(BearingTwinError):
    """An idempotency key came again with another request; the text says what was expected."""


class ActivationRefusedError(BearingTwinError):
    """A model version may not be activated; the text says why."""


class RequestRefusedError(BearingTwinError, ValueError):
    """A request that is well-formed but cannot be served as it is.

    ``pointer``: JSON pointer into the body, for example ``/windows/0``.
    """

    def __init__(self, pointer: str, detail: str) -> None:
        super().__init__(f"{pointer}: {detail}")
        self.pointer = pointer
        self.detail = detail


class NotReadyError(BearingTwinError, RuntimeError):
    """The twin cannot answer yet; the text says what it waits for."""


class NotIdentifiedError(BearingTwinError, RuntimeError):
    """There is no identified model yet; the text says what to do."""


class CellUnavailableError(BearingTwinError, RuntimeError):
    """The process that follows the machines does not answer; the text says why."""


class PushRefusedError(BearingTwinError, RuntimeError):
    """None of the pushed samples was stored, and none is going to be.

    ``retry_after_s``: wall seconds after which the same push may come again.
    """

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail, retry_after_s)
        self.detail = detail
        self.retry_after_s = retry_after_s

    def __str__(self) -> str:
        return self.detail


class RoleRefusedError(BearingTwinError, RuntimeError):
    """The cell does not do this for a caller of that role; the text says what."""


class NotKeptError(BearingTwinError, RuntimeError):
    """A change was made, but neither the store nor the disk takes it; the text says why."""
