import itertools

import pytest

from service.alarms import TRANSITIONS, AlarmEvent, AlarmState, next_state

NORM, UNACK, ACKED, RTNUN = AlarmState
RAISE, RETURN, ACKNOWLEDGE = AlarmEvent


@pytest.mark.parametrize(
    ("state", "event", "expected"),
    [
        (NORM, RAISE, UNACK),
        (NORM, RETURN, NORM),
        (NORM, ACKNOWLEDGE, NORM),
        (UNACK, RAISE, UNACK),
        (UNACK, RETURN, RTNUN),
        (UNACK, ACKNOWLEDGE, ACKED),
        (ACKED, RAISE, ACKED),
        (ACKED, RETURN, NORM),
        (ACKED, ACKNOWLEDGE, ACKED),
        (RTNUN, RAISE, UNACK),
        (RTNUN, RETURN, RTNUN),
        (RTNUN, ACKNOWLEDGE, NORM),
    ],
)
def test_every_event_in_every_state(
    state: AlarmState, event: AlarmEvent, expected: AlarmState
) -> None:
    assert next_state(state, event) is expected


def test_the_table_names_changes_only_and_the_standard_mnemonics() -> None:
    assert all(state is not target for (state, _), target in TRANSITIONS.items())
    assert [str(state) for state in AlarmState] == ["NORM", "UNACK", "ACKED", "RTNUN"]
    reachable = {NORM}
    for _ in AlarmState:
        reachable |= {next_state(*pair) for pair in itertools.product(reachable, AlarmEvent)}
    assert reachable == set(AlarmState)
