"""What a silent process is judged by: hung, or kept waiting by a busy machine."""

import os

from service.app.hanging import HUNG_S, Look, SilentTime, look_at

LIMIT_S = 30.0
RESTS = Look(waits_for_machine=False, processor_s=1.0)
WAITS = Look(waits_for_machine=True, processor_s=1.0)


def first_s(looks: list[Look | None], excused_at: int | None = None) -> int | None:
    """The second at which a process that is looked at once a second is said to hang."""
    silence = SilentTime(0.0)
    for second, look in enumerate(looks, start=1):
        if second == excused_at:
            silence.excuse()
        if silence.is_hanging(look, float(second), LIMIT_S):
            return second
    return None


def test_one_of_which_no_thread_would_run_hangs_after_a_short_silence() -> None:
    assert first_s([RESTS] * 40) == HUNG_S + 1


def test_one_that_waits_for_a_busy_machine_is_given_longer() -> None:
    assert first_s([RESTS, WAITS] + [RESTS] * 40) == LIMIT_S + 1
    assert first_s([RESTS] * 40, excused_at=3) == LIMIT_S + 1, "the observer itself was late"


def test_one_that_computes_without_a_sign_of_life_hangs_by_its_own_processor_time() -> None:
    computes = [Look(waits_for_machine=True, processor_s=0.5 * second) for second in range(40)]
    assert first_s(computes) == 2 * HUNG_S + 2


def test_what_cannot_be_looked_at_is_judged_by_its_silence_alone() -> None:
    assert first_s([None] * 40) == LIMIT_S + 1


def test_a_look_shows_processor_time_and_who_runs() -> None:
    own = look_at(os.getpid())
    assert own is not None
    assert own.waits_for_machine, "this very thread runs"
    assert own.processor_s > 0.0
    assert look_at(2**22 + 1) is None
