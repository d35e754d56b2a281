"""What keeps a model from being exported."""

from service.domain.errors import BearingTwinError


class FmuError(BearingTwinError, ValueError):
    """A model or an environment that no FMU can be made with; one line for the user."""
