"""What can be wrong with a file."""

from service.domain.errors import BearingTwinError


class TransferError(BearingTwinError, ValueError):
    """A file, or a mapping, that cannot be used as a whole; the text is one line for the user."""
