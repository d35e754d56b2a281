"""Live messages are made for those who follow, and who comes back knows what was not made."""

from dataclasses import dataclass

import pytest

from service.bus.followed import Followed
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.documents.messages import NewSamples

LASTS_S = 10.0


@dataclass
class Watch:
    """Time that a test sets."""

    time_s: float = 100.0

    def __call__(self) -> float:
        return self.time_s


@pytest.fixture
def watch() -> Watch:
    return Watch()


@pytest.fixture
def followed(watch: Watch) -> Followed:
    return Followed(LASTS_S, watch)


def test_nobody_follows_at_first(followed: Followed) -> None:
    assert not followed.has("a")


def test_an_asset_is_followed_for_a_while_and_others_are_not(
    followed: Followed, watch: Watch
) -> None:
    followed.note(["a"], 5)
    watch.time_s += LASTS_S - 0.1
    assert followed.has("a")
    assert not followed.has("b")
    watch.time_s += 0.2
    assert not followed.has("a")


def test_who_follows_all_follows_each(followed: Followed) -> None:
    followed.note(None, 5)
    assert followed.has("a")


def test_messages_are_complete_from_the_first_word_on_as_long_as_it_is_repeated(
    followed: Followed, watch: Watch
) -> None:
    assert followed.note(["a"], 5) == 5
    for number in (9, 13, 17):
        watch.time_s += LASTS_S - 1.0
        assert followed.note(["a"], number) == 5
    watch.time_s += LASTS_S + 1.0
    assert followed.note(["a"], 40) == 40


def test_of_several_assets_the_one_that_was_followed_last_counts(followed: Followed) -> None:
    followed.note(["a"], 5)
    assert followed.note(["a", "b"], 20) == 20
    assert followed.note(["a"], 30) == 5


def test_an_asset_of_all_that_are_followed_is_complete_since_then(
    followed: Followed, watch: Watch
) -> None:
    assert followed.note(None, 5) == 5
    watch.time_s += LASTS_S - 1.0
    assert followed.note(["a"], 20) == 5
    watch.time_s += LASTS_S - 1.0  # nobody follows all of them any more
    assert followed.note(["a"], 30) == 5
    assert followed.note(["b"], 30) == 30
    assert followed.note(None, 31) == 31


async def test_a_subscriber_here_follows_too() -> None:
    bus = LiveMessages(ProcessClock())
    assert not bus.is_followed("a")
    mine = bus.subscribe(["a"])
    assert bus.is_followed("a")
    assert not bus.is_followed("b")
    everything = bus.subscribe()
    assert bus.is_followed("b")
    for one in (mine, everything):
        one.close()
    assert not bus.is_followed("a")


async def test_who_wants_alarms_only_follows_no_asset() -> None:
    bus = LiveMessages(ProcessClock())
    bus.subscribe(types={"alarm"})
    assert not bus.is_followed("a")
    assert bus.followed() == frozenset()


async def test_who_comes_back_to_an_asset_that_nobody_followed_meanwhile_has_a_gap() -> None:
    bus = LiveMessages(ProcessClock())
    for _ in range(9):
        bus.publish("measurement", "a", NewSamples(samples=[]))
    assert not bus.subscribe(["a"], resume_from=6, complete_after=6).gap
    late = bus.subscribe(["a"], resume_from=5, complete_after=6)
    assert late.gap
    assert late.start_seq == 9


async def test_a_gap_is_still_told_when_older_messages_leave_the_history() -> None:
    """Found by `tests/simulation/web.py`: the history, when it was full, took the gap back."""
    bus = LiveMessages(ProcessClock(), history_messages=3)
    for _ in range(5):
        bus.publish("measurement", "a", NewSamples(samples=[]))
    bus.skip_to(9, 9)  # four are missing
    bus.publish("measurement", "a", NewSamples(samples=[]))
    assert bus.subscribe(["a"], resume_from=5).gap
    assert not bus.subscribe(["a"], resume_from=9).gap
