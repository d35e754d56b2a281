"""What a user of the command line can mend."""

from service.domain.errors import BearingTwinError


class BadInputError(BearingTwinError, ValueError):
    """An option or a file that cannot be used; the text is one line that names it."""
