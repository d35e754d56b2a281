"""A web side on an open store, and the command line on files."""

from tests.service.offline.conftest import command, complaint, prior_model, run_command
from tests.service.web.api.conftest import empty_store, patient, settings, world

__all__ = [
    "command",
    "complaint",
    "empty_store",
    "patient",
    "prior_model",
    "run_command",
    "settings",
    "world",
]
