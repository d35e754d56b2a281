"""What can be wrong with a file."""


class TransferError(ValueError):
    """A file, or a mapping, that cannot be used as a whole; the text is one line for the user."""
