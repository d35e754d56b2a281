"""What all parts of the service understand when something outside the program goes wrong."""


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
