"""The decision who owns what, as a function of a look and of time: no database, no clock."""

from collections import Counter
from collections.abc import Mapping
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.site.partitions import partition_of
from service.store.partition_shares import (
    COME_BACK_S,
    DEAD_S,
    GAP_S,
    KNOWN_S,
    LEFT_OVER_S,
    LOOK_S,
    ClusterView,
    Decision,
    Member,
    Watch,
    decide,
    even_shares,
    interrupted,
    watched,
)

COUNT = 64


def view(
    server_s: float, members: Mapping[str, Member], shares: Mapping[str, int], locked: bool = True
) -> ClusterView:
    """Partitions in the order of their owners; those of connected members are locked."""
    owners: dict[int, str] = {}
    for name, count in shares.items():
        for _ in range(count):
            owners[len(owners)] = name
    for number in range(len(owners), COUNT):
        owners[number] = ""
    held = {
        number
        for number, name in owners.items()
        if locked and name in members and members[name].is_connected
    }
    return ClusterView(server_s, members, owners, held)


def owned(seen: ClusterView, name: str) -> set[int]:
    return {partition for partition, owner in seen.owners.items() if owner == name}


class Observer:
    """Looks every `LOOK_S`; the server's clock is 1,000 s ahead of its own."""

    def __init__(self, shares: Mapping[str, int]) -> None:
        self.shares = shares
        self.watch = Watch()
        self.now_s = 0.0
        self.beats = dict.fromkeys(shares, 1000.0)
        self.connected = dict.fromkeys(shares, True)
        self.silent: set[str] = set()

    def look(self, after_s: float = LOOK_S) -> Decision:
        self.now_s += after_s
        for name in self.beats.keys() - self.silent:
            if self.connected[name]:
                self.beats[name] = 1000 + self.now_s
        members = {name: Member(self.beats[name], self.connected[name]) for name in self.beats}
        seen = view(1000 + self.now_s, members, self.shares)
        self.watch = watched(self.watch, seen, self.now_s)
        return decide("a", seen, self.watch, self.now_s, owned(seen, "a"))

    def look_for(self, seconds: float) -> list[Decision]:
        return [self.look() for _ in range(round(seconds / LOOK_S))]


THREE = {"a": 22, "b": 21, "c": 21}


def quiet(decision: Decision) -> bool:
    return not decision.end and not decision.leave and not decision.take


def test_a_cell_that_hangs_is_ended_after_the_limit() -> None:
    observer = Observer(THREE)
    observer.look_for(60)
    observer.silent = {"b"}
    decisions = observer.look_for(DEAD_S + 1)
    ended_s = [LOOK_S * number for number, one in enumerate(decisions, 1) if one.end]
    assert DEAD_S <= ended_s[0] <= DEAD_S + LOOK_S
    assert all(one.end.keys() <= {"b"} for one in decisions)


@pytest.mark.parametrize("pause_s", [GAP_S + 0.1, 5.0, 20.0, 3600.0])
def test_an_observer_that_was_blind_judges_nobody(pause_s: float) -> None:
    """Findings 1.3: the server paused, and whoever comes back first sees all others silent."""
    observer = Observer(THREE)
    observer.look_for(60)
    observer.silent = {"b", "c"}
    assert quiet(observer.look(pause_s))
    assert all(quiet(one) for one in observer.look_for(DEAD_S - LOOK_S))
    observer.silent = set()
    assert all(quiet(one) for one in observer.look_for(60))


@pytest.mark.parametrize("pause_s", [1.0, 5.0, 40.0])
def test_after_a_failover_members_have_time_to_connect_again(pause_s: float) -> None:
    observer = Observer(THREE)
    observer.look_for(60)
    observer.connected |= {"b": False, "c": False}
    observer.watch = interrupted(observer.watch)
    assert quiet(observer.look(pause_s))
    assert all(quiet(one) for one in observer.look_for(COME_BACK_S - LOOK_S))
    observer.connected["b"] = True
    decisions = observer.look_for(1)
    # One did not come: what it had is free, and this cell takes what is missing of its half.
    assert [len(one.take) for one in decisions] == [10, 10]


def test_a_copy_in_which_nobody_has_beaten_for_a_day_does_not_give_one_cell_everything() -> None:
    observer = Observer(THREE)
    observer.look_for(60)
    day_s = 86_400.0
    members = {
        "a": Member(1000 + observer.now_s, True),
        **{name: Member(1000 - day_s, False) for name in ("b", "c")},
    }
    seen = view(1000 + observer.now_s, members, THREE)
    watch = watched(interrupted(observer.watch), seen, observer.now_s)
    assert quiet(decide("a", seen, watch, observer.now_s, owned(seen, "a")))


def test_a_killed_cell_is_replaced_at_once_by_who_has_watched_it() -> None:
    observer = Observer(THREE)
    observer.look_for(2)
    observer.connected["b"] = False
    assert len(observer.look().take) == 10


def test_a_new_cell_waits_for_those_that_were_there_a_moment_ago_and_for_no_others() -> None:
    observer = Observer({"a": 0, "b": 64})
    observer.connected["b"] = False
    assert not observer.look().take
    assert not any(one.take for one in observer.look_for(DEAD_S - LOOK_S))
    assert len(observer.look().take) == 32, "no more than its share at once"
    long_ago = Observer({"a": 0, "b": 64})
    long_ago.connected["b"] = False
    long_ago.beats["b"] -= KNOWN_S
    assert len(long_ago.look().take) == COUNT


def test_a_new_cell_takes_at_once_what_is_left_for_it_though_its_last_run_may_be_there() -> None:
    observer = Observer({"a": 0, "b": 43, "earlier run of a": 0})
    observer.connected["earlier run of a"] = False
    assert len(observer.look().take) == 21


def test_no_more_than_a_share_of_those_known_is_taken_at_once() -> None:
    names = [chr(ord("a") + number) for number in range(16)]
    observer = Observer(dict.fromkeys(names, 4))
    observer.look_for(60)
    observer.connected |= dict.fromkeys(names[1:], False)
    taken = []
    for _ in range(15):
        decision = observer.look()
        taken.append(len(decision.take))
        observer.shares = {**observer.shares, "a": observer.shares["a"] + taken[-1]}
        left = COUNT - observer.shares["a"]
        for name in names[1:]:
            observer.shares[name] = min(4, left)
            left -= observer.shares[name]
    assert max(taken) == 4
    assert observer.shares["a"] == COUNT


@pytest.mark.parametrize("cells", [1, 2, 3, 5, 7, 12, 17, 18, 48, 64, 80])
def test_no_cell_is_idle_and_few_partitions_change_hands(cells: int) -> None:
    """Findings 1.5: 12 cells owned 6 x 10, 4, and 0."""
    names = [f"cell-{number:02}" for number in range(cells)]
    members = {name: Member(1000.0, True) for name in names}
    owners = dict.fromkeys(range(COUNT), names[0])
    moved = 0
    for _ in range(40):
        for name in names:
            moved += look(name, members, owners, {})
    counts = [list(owners.values()).count(name) for name in names]
    assert sum(counts) == COUNT
    assert max(counts) - min(counts) <= 1
    assert moved == COUNT - max(counts)


def look(
    name: str, members: Mapping[str, Member], owners: dict[int, str], assets: Mapping[int, int]
) -> int:
    """Let a cell look and do what it decides; gives how many partitions it has left."""
    held = {partition for partition, owner in owners.items() if owner in members}
    seen = ClusterView(1000, members, dict(owners), held)
    watch = watched(Watch(), seen, 0.0)
    decision = decide(name, seen, watch, 0.0, owned(seen, name), assets=assets)
    assert not decision.leave & set(decision.take)
    owners |= dict.fromkeys(decision.leave, "") | dict.fromkeys(decision.take, name)
    return len(decision.leave)


ASSETS = st.dictionaries(st.integers(0, COUNT - 1), st.integers(0, 400))


@settings(deadline=None, max_examples=40)
@given(ASSETS, st.integers(1, 20), st.randoms())
def test_cells_carry_as_many_assets_each_and_come_to_rest(
    assets: dict[int, int], cells: int, chance: Random
) -> None:
    """Findings 1.5: behind gateways the fullest of 16 cells had 40 % more than its share."""
    names = [f"cell-{number:02}" for number in range(cells)]
    members = {name: Member(1000.0, True) for name in names}
    owners = {number: chance.choice([*names, "gone", ""]) for number in range(COUNT)}
    for _ in range(3):
        for name in chance.sample(names, cells):
            look(name, members, owners, assets)
    assert not any(look(name, members, owners, assets) for name in names)
    assert set(owners.values()) <= set(names)
    loads = {
        name: sorted(assets.get(one, 0) for one, owner in owners.items() if owner == name)
        for name in names
    }
    sums = {name: sum(load) for name, load in loads.items()}
    most = max(names, key=lambda name: sums[name])
    quarter = sum(assets.values()) / COUNT / 4
    assert sums[most] - min(sums.values()) <= loads[most][0] + quarter + 1


def test_gateways_of_a_hundred_are_shared_out_evenly_and_one_more_asset_moves_none() -> None:
    """16,000 bearings, 100 behind each gateway: the fullest of 16 cells had 1,400, not 1,000."""
    partitions = [partition_of(f"source {number}", 256) for number in range(160)]
    assets = {one: 100 * partitions.count(one) for one in partitions}
    names = {f"cell-{number:02}" for number in range(16)}
    shares = even_shares(dict.fromkeys(range(256), ""), names, assets)
    loads = Counter(dict.fromkeys(names, 0))
    for partition, name in shares.items():
        loads[name] += assets.get(partition, 0)
    assert set(loads.values()) == {1000}
    assets[partitions[0]] += 1
    assert even_shares(shares, names, assets) == shares


def test_what_each_cell_leaves_to_another_one_is_taken_in_the_end() -> None:
    """Two that see other assets: each takes the free partition for the other one's."""
    members = {name: Member(1000.0, True) for name in "ab"}
    owners = {0: "a", 1: "b", 2: ""}
    taken = []
    watch = Watch()
    for number in range(30):
        now_s = LOOK_S * number
        seen = ClusterView(
            1000 + now_s,
            {name: Member(1000.0 + now_s, True) for name in members},
            owners,
            {0, 1},
        )
        watch = watched(watch, seen, now_s)
        decision = decide("a", seen, watch, now_s, {0}, assets={0: 9, 1: 1, 2: 1})
        taken.append(decision.take)
    first = next(number for number, one in enumerate(taken) if one)
    assert first * LOOK_S >= LEFT_OVER_S
    assert taken[-1] == (2,)


def test_the_least_revision_is_that_of_those_that_are_there() -> None:
    members = {
        "a": Member(1000, True, 7),
        "b": Member(1000, True, 5),
        "gone": Member(1000 - KNOWN_S, False, 1),
    }
    seen = view(1000, members, THREE)
    assert decide("a", seen, watched(Watch(), seen, 0.0), 0.0, range(22)).least_revision == 5
