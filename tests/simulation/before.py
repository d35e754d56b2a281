"""The rules of commit 8c379b4, put back: the simulation finds what was wrong with them."""

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from simulation.fleet import Cell
from simulation.world import replaced

from service.cell.share import Share
from service.store import Outbox, StoreUnavailableError, alarm_journal, ownership
from service.store.partition_shares import DEAD_S, ClusterView, Decision, Watch


def sent_before_the_fence(cell: Cell, run: str) -> tuple[Any, Share]:
    """Findings 1.2: the outbox of an earlier run was sent before there was a fence."""
    fleet, store = cell.fleet, cell.store
    store._database.fence = None
    box = cell.open_outbox(run)
    if not box.flush(10.0):
        raise StoreUnavailableError("changes of an earlier run wait")
    share = Share(cell.own(run), fleet.changed)
    share.arrange(fleet.settings.assets, 0)
    store.write_only_what(share)
    return box, share


def _dropped(*_: object) -> bool:
    """What the store refused was a line of the log."""
    return True


@contextmanager
def refused_is_dropped() -> Iterator[None]:
    """Findings 1.2: an open row of the same condition refused the next alarm, which was dropped."""
    with replaced(
        (Outbox, "_refuse", _dropped),
        (alarm_journal, "_close_unknown", lambda *_: None),
    ):
        yield


def _silence_by_the_servers_clock(
    me: str,
    view: ClusterView,
    watch: Watch,
    now_s: float,
    owned: Collection[int],
    leaving: Collection[int],
    assets: Mapping[int, int],
) -> Decision:
    connected = {name for name, one in view.members.items() if one.is_connected} - {me}
    silent = {
        name: view.members[name].beat_s
        for name in connected
        if view.members[name].beat_s < view.server_s - DEAD_S
    }
    alive = connected - silent.keys()
    kept = [one for one in owned if one not in leaving]
    share = math.ceil(len(view.owners) / (len(alive) + 1))
    free = [
        partition
        for partition, owner in view.owners.items()
        if partition not in view.locked and owner not in alive and partition not in owned
    ]
    return Decision(silent, frozenset(kept[share:]), tuple(free[: max(share - len(kept), 0)]), 0)


@contextmanager
def judged_while_blind() -> Iterator[None]:
    """Findings 1.3: whoever came back first after a pause of the server ended all others."""
    with replaced((ownership, "decide", _silence_by_the_servers_clock)):
        yield
