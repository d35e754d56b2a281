"""Errors that several parts of the service raise and understand."""


class ServiceError(Exception):
    """A disk, a server or an address cannot be used; the text is one line for the user.

    A person must mend it (exit status 2), unless it is a `TemporaryError`.
    """


class TemporaryError(ServiceError):
    """Trouble that passes by itself: a port still in use, a store that is not there yet.

    The service waits for its end; a command that cannot wait ends with status 75.

    Attributes
    ----------
    passes : bool
        False where only a running service may hope for its end, and a start may not.
    """

    passes = True


class ChangedMeanwhileError(Exception):
    """Somebody else changed what a change was made of; the text says what."""


class JobConflictError(Exception):
    """A job runs for this asset already.

    Parameters
    ----------
    text : str
        Which job, and what it is doing.
    job
        Its document.
    """

    def __init__(self, text: str, job: object) -> None:
        super().__init__(text)
        self.job = job


class KeyUsedBeforeError(Exception):
    """An idempotency key came again with another request; the text says what was expected."""


class ActivationRefusedError(Exception):
    """A model version may not be activated; the text says why."""


class RequestRefusedError(ValueError):
    """A request that is well-formed but cannot be served as it is.

    Parameters
    ----------
    pointer : str
        JSON pointer into the body, for example ``/windows/0``.
    detail : str
        What is wrong and what was expected.
    """

    def __init__(self, pointer: str, detail: str) -> None:
        super().__init__(f"{pointer}: {detail}")
        self.pointer = pointer
        self.detail = detail


class NotReadyError(RuntimeError):
    """The twin cannot answer yet; the text says what it waits for."""


class NotIdentifiedError(RuntimeError):
    """There is no identified model yet; the text says what to do."""


class CellUnavailableError(RuntimeError):
    """The process that follows the machines does not answer; the text says why."""


class PushRefusedError(RuntimeError):
    """None of the pushed samples was stored, and none is going to be.

    Parameters
    ----------
    detail : str
        Why.
    retry_after_s : int
        Wall seconds after which the same push may come again.
    """

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail, retry_after_s)
        self.detail = detail
        self.retry_after_s = retry_after_s

    def __str__(self) -> str:
        return self.detail


class NotKeptError(RuntimeError):
    """A change was made, but neither the store nor the disk takes it; the text says why."""
