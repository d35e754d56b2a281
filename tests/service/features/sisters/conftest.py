"""Jobs on a real store, and the command line on files."""

from tests.service.jobs.conftest import _compiled
from tests.service.offline.conftest import command, complaint, run_command

__all__ = ["_compiled", "command", "complaint", "run_command"]
