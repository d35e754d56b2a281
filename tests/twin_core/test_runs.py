"""Runs are found in any history of the speed, however it is cut."""

from itertools import pairwise

from hypothesis import example, given
from hypothesis import strategies as st

from twin_core.runs import GAP_S, LEAST_S, STANDSTILL_S, RunSpan, Stretch, find_runs

MINUTE_S = 60
#: Minutes of turning, standstill, or nothing known.
histories = st.lists(
    st.tuples(st.sampled_from(["turns", "stands", "unknown"]), st.integers(1, 40)), max_size=30
)


def minutes(history: list[tuple[str, int]]) -> list[str]:
    return [what for what, count in history for _ in range(count)]


def by_minutes(known: list[str]) -> list[Stretch]:
    return [
        Stretch(number * MINUTE_S, (number + 1) * MINUTE_S, what == "turns")
        for number, what in enumerate(known)
        if what != "unknown"
    ]


def as_they_come(history: list[tuple[str, int]]) -> list[Stretch]:
    """The same as one stretch for each entry, of any length."""
    found, at_s = [], 0
    for what, count in history:
        end_s = at_s + count * MINUTE_S
        if what != "unknown":
            found.append(Stretch(at_s, end_s, what == "turns"))
        at_s = end_s
    return found


@given(histories)
def test_how_the_history_is_cut_does_not_matter(history: list[tuple[str, int]]) -> None:
    known = minutes(history)
    now_s = len(known) * MINUTE_S
    assert find_runs(as_they_come(history), now_s) == find_runs(by_minutes(known), now_s)


@given(histories)
def test_runs_are_what_their_words_say(history: list[tuple[str, int]]) -> None:
    known = minutes(history)
    now_s = len(known) * MINUTE_S
    runs = find_runs(by_minutes(known), now_s)
    turning = {number for number, what in enumerate(known) if what == "turns"}
    for one in runs:
        end_s = now_s if one.end_s is None else one.end_s
        inside = range(one.begin_s // MINUTE_S, end_s // MINUTE_S)
        assert inside[0] in turning, "it begins with the first minute in which the machine turns"
        still = 0  # no pause within it is a standstill of five minutes, no gap longer than 30 min
        for number in inside if one.end_s is not None else []:
            still = 0 if number in turning else still + 1
            seen = "stands" in known[number - still + 1 : number + 1]
            assert not (seen and still * MINUTE_S >= STANDSTILL_S) or number + 1 not in turning
            assert still * MINUTE_S <= GAP_S or seen
        if one.end_s is None:
            assert one is runs[-1]
            assert one.ended == ""
        else:
            assert end_s - one.begin_s >= LEAST_S
            assert inside[-1] in turning
            after = known[end_s // MINUTE_S :]
            pause = after[: after.index("turns")] if "turns" in after else after
            in_time = pause[: GAP_S // MINUTE_S + 1]
            assert ("stands" in in_time) == (one.ended == "standstill")
            least_s = STANDSTILL_S if one.ended == "standstill" else GAP_S + 1
            assert len(pause) * MINUTE_S >= least_s
    assert all(a.end_s is not None and a.end_s < b.begin_s for a, b in pairwise(runs))


@given(histories, st.integers(0, 400))
@example([("turns", 30), ("unknown", 40), ("stands", 1)], 65)
def test_what_has_ended_stays_as_it_is(history: list[tuple[str, int]], earlier: int) -> None:
    known = minutes(history)
    then = find_runs(by_minutes(known[:earlier]), min(earlier, len(known)) * MINUTE_S)
    now = find_runs(by_minutes(known), len(known) * MINUTE_S)
    over = [one for one in then if one.ended]
    assert now[: len(over)] == over
    assert len(now) >= len(then)


def test_a_jog_is_no_run_and_a_short_stop_ends_none() -> None:
    turns = [(0, 1), (20, 50), (54, 80)]
    stands = [(1, 20), (50, 54), (80, 100)]
    stretches = sorted(
        [Stretch(a * 60, b * 60, True) for a, b in turns]
        + [Stretch(a * 60, b * 60, False) for a, b in stands],
        key=lambda one: one.begin_s,
    )
    assert find_runs(stretches, 6000) == [RunSpan(1200, 4800, "standstill")]
    assert find_runs(stretches, 4800 + STANDSTILL_S - 1) == [RunSpan(1200, None, "")]
