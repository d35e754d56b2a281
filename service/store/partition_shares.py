"""Which partitions a cell gives up and takes: a pure function of what it sees, and of time.

A cell judges another one only by what it has watched itself. Silence counts while the observer
looks without a gap: after a gap of its own (the server paused, a failover, a network that was cut,
a machine that slept) it cannot know whether the others were silent or it was blind, and begins
again. So leases do it in etcd, in Consul and in Kafka's group coordinator.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

#: Wall seconds between two looks.
LOOK_S: Final = 0.5
#: A cell that is connected and has had no heartbeat for so long, as one observer sees it, hangs.
DEAD_S: Final = 4.0
#: Between two looks of an observer that has not been blind.
GAP_S: Final = DEAD_S / 2
#: After a gap others are given so many seconds to connect again.
COME_BACK_S: Final = 8.0
#: A cell that had a heartbeat in this time is counted, whatever has become of it.
KNOWN_S: Final = 60.0
#: A partition that is free for so long is any cell's: those that see other members or other assets
#: may each leave it to another one.
LEFT_OVER_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class Member:
    """A run of a cell as a look at the database shows it.

    ``beat_s``: its last heartbeat, on the server's clock; ``assets_revision``: of the assets that
    it has taken up.
    """

    beat_s: float
    is_connected: bool
    assets_revision: int = 0


@dataclass(frozen=True, slots=True)
class ClusterView:
    """What one look at the database shows to one cell.

    - ``owners``: owner by partition, of all partitions; empty for one that was given up.
    - ``locked``: partitions whose lock a session holds.
    """

    server_s: float
    members: Mapping[str, Member]
    owners: Mapping[int, str]
    locked: Collection[int]


@dataclass(frozen=True, slots=True)
class Seen:
    """What an observer knows of the heartbeat of a member; times on the observer's own clock.

    - ``beat_s``: the last one, on the server's clock.
    - ``still_s``: since when the observer has seen it unchanged, without a gap of its own.
    - ``known_s``: when the member was there last, as far as the observer knows.
    - ``has_moved``: whether the observer has seen it move, without a gap of its own since.
    """

    beat_s: float
    still_s: float
    known_s: float
    has_moved: bool = False


@dataclass(frozen=True, slots=True)
class Watch:
    """What an observer remembers between its looks, on its own monotonic clock.

    - ``since_s``, ``last_s``: looks follow each other without a gap since then; the last one. None
      before the first.
    - ``patience_s``: members that are not connected are judged when it has looked for so long.
    - ``seen``: by member; those that were there in the last minute.
    - ``unlocked_s``: since when it has seen a partition without a lock.
    """

    since_s: float | None = None
    last_s: float | None = None
    patience_s: float = DEAD_S
    seen: Mapping[str, Seen] = field(default_factory=dict)
    unlocked_s: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Decision:
    """What a cell does after a look.

    - ``end``: members that hang, with the heartbeat that was seen last.
    - ``leave``: partitions that it gives up.
    - ``take``: partitions without an owner that it takes.
    - ``least_revision``: of the assets: every member that is there has taken this one up.
    """

    end: Mapping[str, float]
    leave: frozenset[int]
    take: tuple[int, ...]
    least_revision: int


def interrupted(watch: Watch) -> Watch:
    """Give what an observer remembers that was blind for a while: it begins again."""
    return Watch(None, None, COME_BACK_S, watch.seen)


def watched(watch: Watch, view: ClusterView, now_s: float) -> Watch:
    """Give what the observer remembers after a look at a time of its own monotonic clock."""
    if watch.last_s is not None and now_s - watch.last_s > GAP_S:
        watch = interrupted(watch)
    begins = watch.since_s is None
    seen = {name: one for name, one in watch.seen.items() if now_s - one.known_s < KNOWN_S}
    if begins:
        seen = {name: Seen(one.beat_s, now_s, one.known_s) for name, one in seen.items()}
    for name, member in view.members.items():
        before = seen.get(name)
        if before is None:
            age_s = max(view.server_s - member.beat_s, 0.0)
            seen[name] = Seen(member.beat_s, now_s, now_s - age_s)
        elif before.beat_s != member.beat_s:
            seen[name] = Seen(member.beat_s, now_s, now_s, not begins)
    before_s = {} if begins else watch.unlocked_s
    unlocked_s = {
        partition: before_s.get(partition, now_s)
        for partition in view.owners
        if partition not in view.locked
    }
    return Watch(now_s if begins else watch.since_s, now_s, watch.patience_s, seen, unlocked_s)


def decide(
    me: str,
    view: ClusterView,
    watch: Watch,
    now_s: float,
    owned: Collection[int],
    leaving: Collection[int] = (),
    assets: Mapping[int, int] = MappingProxyType({}),
) -> Decision:
    """Decide what a cell does after a look.

    - ``watch``: what the observer remembers after this look, see `watched`.
    - ``now_s``: the observer's monotonic clock.
    - ``owned``, ``leaving``: partitions that it owns, and those of them that it gives up already.
    - ``assets``: how many each partition has; of one that is missing, none.
    """
    seen = watch.seen
    connected = {name for name, one in view.members.items() if one.is_connected} - {me}
    known = connected | {name for name, one in seen.items() if now_s - one.known_s < KNOWN_S} - {me}
    can_judge = watch.since_s is not None and now_s - watch.since_s >= watch.patience_s
    # One that was seen to beat, and has no session any more, has ended. Of others an observer that
    # was blind does not know it yet.
    unsettled = {name for name in known - connected if not (can_judge or seen[name].has_moved)}
    there = connected | unsettled
    free = [
        partition
        for partition, owner in sorted(view.owners.items())
        if partition not in view.locked and owner not in there
    ]
    owners = {**view.owners, **dict.fromkeys(owned, me), **dict.fromkeys(leaving, "")}
    # Members that are perhaps gone keep what they have, and get nothing.
    shared = {one: owner for one, owner in owners.items() if owner not in unsettled}
    shares = even_shares(shared, {me, *connected}, assets)
    mine = [
        partition
        for partition in free
        if shares[partition] == me or now_s - watch.unlocked_s[partition] >= LEFT_OVER_S
    ]
    # The ceiling: a view that is wrong all the same does not give one cell everything.
    at_once = -(-len(view.owners) // (len(known) + 1))
    revisions = [one.assets_revision for name, one in view.members.items() if name in {me, *there}]
    return Decision(
        end={
            name: view.members[name].beat_s
            for name in sorted(connected)
            if now_s - seen[name].still_s >= DEAD_S
        },
        leave=frozenset(one for one in owned if shares[one] != me and one not in leaving),
        take=tuple(one for one in mine if one not in owned)[:at_once],
        least_revision=min(revisions),
    )


def even_shares(
    owners: Mapping[int, str], members: Collection[str], assets: Mapping[int, int]
) -> dict[int, str]:
    """Give the member that is to have each partition: as many assets each, few change hands.

    What has no member goes to those with the least, the heaviest first; then single partitions
    move from the member with the most to the one with the least while that makes the two more
    even by a quarter of a mean partition: an asset more or less moves none. Members that see the
    same come to the same shares. No member then has more assets than another one by its smallest
    partition and that quarter. Partitions without assets are shared out too.
    """
    # All partitions together count less than one asset.
    weights = {one: assets.get(one, 0) * (len(owners) + 1) + 1 for one in owners}
    held: dict[str, set[int]] = {name: set() for name in members}
    for partition, owner in owners.items():
        if owner in held:
            held[owner].add(partition)
    sums = {name: sum(weights[one] for one in held[name]) for name in held}

    def move(partition: int, giver: str | None, taker: str) -> None:
        if giver is not None:
            held[giver].remove(partition)
            sums[giver] -= weights[partition]
        held[taker].add(partition)
        sums[taker] += weights[partition]

    def ends() -> tuple[str, str]:
        order = sorted(sums, key=lambda name: (sums[name], name))
        return order[0], order[-1]

    quarter = sum(weights.values()) / max(len(weights), 1) / 4
    without = [one for one, owner in owners.items() if owner not in held]
    for partition in sorted(without, key=lambda one: (-weights[one], one)):
        move(partition, None, ends()[0])
    while True:
        least, most = ends()
        apart = sums[most] - sums[least]
        fitting = [one for one in held[most] if weights[one] + quarter <= apart]
        if not fitting:
            return {one: name for name in held for one in held[name]}
        move(min(fitting, key=lambda one: (abs(apart - 2 * weights[one]), one)), most, least)
