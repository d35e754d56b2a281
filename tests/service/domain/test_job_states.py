"""The table of a job's states."""

from typing import get_args

import pytest

from service.domain.job_states import TRANSITIONS, UNFINISHED, JobEvent, JobStatus

ENDED = ("succeeded", "failed", "cancelled")


def test_nothing_leads_out_of_an_end_and_something_into_every_state() -> None:
    assert set(UNFINISHED) == {"queued", "running"}
    assert not any(set(ENDED) & set(one.before) for one in TRANSITIONS.values())
    reached = {one.after for one in TRANSITIONS.values()}
    assert reached == set(get_args(JobStatus))
    assert set(TRANSITIONS) == set(get_args(JobEvent))


@pytest.mark.parametrize("event", ["progress", "interrupt"])
def test_a_job_that_waits_makes_no_progress_and_is_not_interrupted(event: JobEvent) -> None:
    assert TRANSITIONS[event].before == ("running",)
