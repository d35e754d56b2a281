"""What a user of the command line can mend."""


class BadInputError(ValueError):
    """An option or a file that cannot be used; the text is one line that names it."""
