"""Imported in the processes of a service: it then waits for another service for seconds only."""

from service import waiting

HASTY_S = 5.0

waiting.LEAVE_S = waiting.LEAVE_DATABASE_S = HASTY_S
