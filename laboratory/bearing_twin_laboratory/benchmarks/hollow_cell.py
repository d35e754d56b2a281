"""A cell without twins: a process that writes what a cell of many assets writes, at a given pace.

Everything that stores is the product's own: ownership of partitions, the fence, the witness, the
transactions of samples and of states, rollups and packing. What makes the values is a random walk.

It is started by `fleet_store` with its `Task` as the argument, says in lines of JSON what is done,
and is led by words on its standard input: ``begin``, ``condense``, ``pack``, ``stop``.
"""

import asyncio
import json
import math
import sys
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection

from adapters.samples import Quality, Sample, make_sample
from service.cell.share import Share
from service.clock import HOUR_US, MICROSECONDS
from service.logs import configure_logging
from service.site.partitions import partition_of
from service.store import Store
from service.store.database import WRITES_SAMPLES
from service.store.identity import Witness
from service.store.opening import database_address
from service.store.ownership import Ownership, run_name

#: A full hour.
BEGIN_US = 1_699_999_200_000_000
MEASURED = ("t_outer_ring_c", "ambient_c", "speed_rpm", "load_n")
#: What a twin stores of its own, once a minute.
DERIVED = ("t_outer_ring_c.twin", "t_outer_ring_c.residual")
CHANNELS = MEASURED + DERIVED
PARTITIONS = 64
_DERIVED_EVERY_S = 60.0
_NEW_AT_ONCE = 5000
_LOOK_S = 0.2
#: Cells whose shares have not changed for so many wall seconds have them.
_QUIET_S = 2.0
_JITTER_US = 3000


@dataclass(frozen=True, slots=True)
class Task:
    """What one cell is to do.

    - ``url``: of the database.
    - ``folder``: data directory of this cell.
    - ``number``, ``cells``: which of how many cells it is.
    - ``assets``: of all cells.
    - ``period_s``: process seconds between two polls of an asset.
    - ``batch_s``: process seconds of samples in one transaction.
    - ``state_s``: process seconds between two saves of a state.
    - ``rate``: process seconds a wall second; 0: as fast as possible.
    """

    url: str
    folder: str
    number: int
    cells: int
    assets: int
    period_s: float
    batch_s: float
    state_s: float
    rate: float


@dataclass(slots=True)
class Written:
    """What was written in one part of the run, and at what cost.

    - ``samples``, ``states``: how many.
    - ``samples_s``, ``states_s``: processor seconds of this process to store them.
    - ``made_s``: those to make the samples: the work of drivers, not of the store.
    - ``late_s``: of each transaction with samples, from when it was due until it was on the disk.
    """

    samples: int = 0
    states: int = 0
    samples_s: float = 0.0
    states_s: float = 0.0
    made_s: float = 0.0
    late_s: list[float] = field(default_factory=list)


class Turns:
    """The witness of the product, and for how long each transaction had its turn.

    A turn of samples is shared with other cells; the other one, of states, is alone in the store.
    """

    def __init__(self, witness: Witness) -> None:
        self._witness = witness
        self._begun_s, self._kind = 0.0, ""
        self.held_s: dict[str, list[float]] = defaultdict(list)

    def admit(self, connection: Connection) -> int:
        """See `service.store.database.StoreWitness`."""
        self._begun_s = time.perf_counter()
        is_shared = connection.get_execution_options().get(WRITES_SAMPLES, False)
        self._kind = "shared" if is_shared else "alone"
        return self._witness.admit(connection)

    def committed(self, number: int) -> None:
        """See `service.store.database.StoreWitness`."""
        self._witness.committed(number)
        self.held_s[self._kind].append(time.perf_counter() - self._begun_s)

    def check(self, connection: Connection) -> None:
        """See `service.store.database.StoreWitness`."""
        self._witness.check(connection)


class HollowCell:
    """Writes for the assets whose partitions it owns."""

    def __init__(self, task: Task, store: Store, share: Share, turns: Turns) -> None:
        self._task, self._store, self._share, self._turns = task, store, share, turns
        self._stop = threading.Event()
        # Each tick has its own assets: all of a period, evenly.
        self._polls = max(round(task.period_s / task.batch_s), 1)
        self._minute = max(round(_DERIVED_EVERY_S / task.batch_s), 1)
        self._saves = max(round(task.state_s / task.batch_s), 1)
        self._random = np.random.default_rng(task.number)

    def settle(self) -> None:
        """Wait until all cells own their share, and have one time of each channel stored."""
        self._share_evenly()
        names = (f"bearing-{number}" for number in range(self._task.assets))
        self.assets = [name for name in names if self._share.owns(name)]
        self._values = 50.0 + self._random.normal(0.0, 5.0, (len(self.assets), len(CHANNELS)))
        first = self._samples(BEGIN_US, np.arange(len(self.assets)), range(len(CHANNELS)))
        for begin in range(0, len(first), _NEW_AT_ONCE):
            self._store.samples.write(first[begin : begin + _NEW_AT_ONCE])
        self.known = len(first)

    def _share_evenly(self) -> None:
        ownership = self._share.ownership
        quiet_s, before = time.monotonic(), dict[int, int]()
        while True:
            ownership.leave(ownership.leaving)
            time.sleep(_LOOK_S)
            owners = {owner for _, owner in self._store.partition_owners.load().values()}
            now = dict(ownership.owned)
            if "" in owners or len(owners) < self._task.cells or ownership.leaving or now != before:
                before, quiet_s = now, time.monotonic()
            elif time.monotonic() - quiet_s > _QUIET_S:
                return

    def write_hour(self) -> Written:
        """Write the hour, at the pace of the task."""
        ticks = round(3600.0 / self._task.batch_s)
        return self._write(1, ticks, lambda: False)

    def write_on(self) -> Written:
        """Write on into the next hour until `stop`."""
        ticks = round(3600.0 / self._task.batch_s)
        return self._write(ticks, 2 * ticks, self._stop.is_set)

    def stop(self) -> None:
        """End `write_on`."""
        self._stop.set()

    def _write(self, first: int, end: int, is_over: Callable[[], bool]) -> Written:
        done = Written()
        document = json.loads((Path(self._task.folder).parent / "state.json").read_text())
        pace_s = self._task.batch_s / self._task.rate if self._task.rate else 0.0
        begun_s = time.perf_counter()
        for tick in range(first, end):
            if is_over():
                break
            due_s = begun_s + (tick - first + 1) * pace_s
            time.sleep(max(due_s - time.perf_counter(), 0.0))
            at_s = time.thread_time()
            samples = self._of_tick(tick)
            made_s = time.thread_time()
            done.made_s += made_s - at_s
            if samples:
                asked_s = time.perf_counter()
                self._store.samples.write(samples)
                done.late_s.append(time.perf_counter() - (due_s if pace_s else asked_s))
            stored_s = time.thread_time()
            done.samples_s += stored_s - made_s
            done.samples += len(samples)
            saved = self.assets[tick % self._saves :: self._saves]
            states = dict.fromkeys(saved, document)
            self._store.states.save_all(states)
            done.states += len(states)
            done.states_s += time.thread_time() - stored_s
        return done

    def _of_tick(self, tick: int) -> list[Sample]:
        time_us = BEGIN_US + round(tick * self._task.batch_s * MICROSECONDS)
        every = np.arange(len(self.assets))
        measured = every[tick % self._polls :: self._polls]
        derived = every[tick % self._minute :: self._minute]
        return self._samples(time_us, measured, range(len(MEASURED))) + self._samples(
            time_us, derived, range(len(MEASURED), len(CHANNELS))
        )

    def _samples(self, time_us: int, assets: NDArray[np.int64], channels: range) -> list[Sample]:
        """What one poll of each of these assets brings."""
        place = slice(channels.start, channels.stop)
        self._values[assets, place] += self._random.normal(0.0, 0.05, (assets.size, len(channels)))
        rows = np.round(self._values[assets, place], 1).tolist()
        times = (time_us + self._random.integers(0, _JITTER_US, assets.size)).tolist()
        names = CHANNELS[place]
        samples: list[Sample] = []
        for asset, poll_us, row in zip(assets.tolist(), times, rows, strict=True):
            fields = zip(
                *(repeat(self.assets[asset]), names, repeat(poll_us), row),
                *(repeat(Quality.GOOD), repeat(poll_us)),
                strict=False,
            )
            samples += map(make_sample, fields)
        return samples

    def condense(self) -> int:
        """Compute the rollups of the hour; how many hours of channels."""
        return _all(partial(self._store.rollups.refresh, BEGIN_US + HOUR_US, self._share.owns))

    def pack(self) -> int:
        """Pack the hour; how many hours of channels."""
        pack = self._store.packing.pack
        return _all(partial(pack, BEGIN_US + HOUR_US, math.inf, self._share.owns))

    def turns(self) -> dict[str, list[float]]:
        """Give how long the turns were since the last question."""
        held_s, self._turns.held_s = self._turns.held_s, defaultdict(list)
        return held_s


def _all(work: Callable[[], int]) -> int:
    total = 0
    while done := work():
        total += done
    return total


def _say(**facts: object) -> None:
    sys.stdout.write(f"{json.dumps(facts)}\n")
    sys.stdout.flush()


def _await(word: str) -> None:
    heard = sys.stdin.readline().strip()
    if heard != word:
        raise SystemExit(f"expected {word!r}, heard {heard!r}")


def run(task: Task) -> None:
    """Do all of it."""
    run = run_name()
    folder = Path(task.folder)
    with Store.open(task.url, folder, run=run) as store, Witness(folder, store.name) as witness:
        turns = Turns(witness)
        store.write_if(turns)
        names = (f"asset bearing-{number}" for number in range(task.assets))
        ownership = Ownership(
            database_address(task.url, folder),
            run,
            PARTITIONS,
            lambda: None,
            lambda: None,
            assets=Counter(partition_of(name, PARTITIONS) for name in names),
        )
        with ownership:
            share = Share(ownership, asyncio.Event())
            store.write_only_what(share)
            cell = HollowCell(task, store, share, turns)
            cell.settle()
            _say(assets=len(cell.assets), known=cell.known)
            _await("begin")
            cell.turns()
            written = cell.write_hour()
            _say(**asdict(written), turns=cell.turns())
            _await("condense")
            on: list[Written] = []
            writer = threading.Thread(target=lambda: on.append(cell.write_on()))
            writer.start()
            for work, following in ((cell.condense, "pack"), (cell.pack, "stop")):
                begun_s, processor_s = time.perf_counter(), time.thread_time()
                hours = work()
                _say(
                    hours=hours,
                    wall_s=time.perf_counter() - begun_s,
                    processor_s=time.thread_time() - processor_s,
                )
                _await(following)
            cell.stop()
            writer.join()
            _say(**asdict(on[0]), turns=cell.turns(), lost=ownership.lost)
            _await("end")  # who leaves early gives its partitions to the others


def main(arguments: list[Any]) -> None:
    """Run a cell; the argument is its task."""
    configure_logging("error")
    run(Task(**json.loads(arguments[0])))


if __name__ == "__main__":
    main(sys.argv[1:])
