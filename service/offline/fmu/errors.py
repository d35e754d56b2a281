"""What keeps a model from being exported."""


class FmuError(ValueError):
    """A model or an environment that no FMU can be made with; one line for the user."""
