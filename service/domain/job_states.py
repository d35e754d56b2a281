"""The states of an identification job, and what leads from one to another; all of it in one table.

A job that has ended never changes. The comparison with the state before and the change are one
write in the store: of two that want to end a job only one does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

JobStatus = Literal["queued", "running", "succeeded", "failed", "cancelled"]
JobEvent = Literal["start", "progress", "interrupt", "succeed", "fail", "cancel"]


@dataclass(frozen=True, slots=True)
class JobTransition:
    """What an event does to a job: from any of these states into that one."""

    before: tuple[JobStatus, ...]
    after: JobStatus


TRANSITIONS = MappingProxyType[JobEvent, JobTransition](
    {
        # Also the next attempt, after a worker that died.
        "start": JobTransition(("queued", "running"), "running"),
        "progress": JobTransition(("running",), "running"),
        # The service stops, or was killed: the job waits for the next start.
        "interrupt": JobTransition(("running",), "queued"),
        # Also of a job whose result was stored before the service was killed.
        "succeed": JobTransition(("queued", "running"), "succeeded"),
        "fail": JobTransition(("queued", "running"), "failed"),
        "cancel": JobTransition(("queued", "running"), "cancelled"),
    }
)

#: States of a job that has not ended: those that something leads out of.
UNFINISHED: Sequence[JobStatus] = tuple(
    status
    for status in get_args(JobStatus)
    if any(status in one.before for one in TRANSITIONS.values())
)
