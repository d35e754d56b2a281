"""What happens to a fleet, and what must be true when it is quiet again."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from simulation.fleet import ASSETS, Cell, Fleet, Join, product_order, simulated
from simulation.world import Killed, World

#: Faults of a simulated day: one an hour. Between them nothing changes; that time is left out.
ACTS_A_DAY = 24
OWNED_WITHIN_S = 10.0
_SECTOR = 512
#: Seconds until a cell that has ended has begun again, and has sent what waited.
_STORED_WITHIN = 30
_AGREE_WITHIN_S = 10.0


class Acts:
    def __init__(self, fleet: Fleet) -> None:
        self.fleet, self.world, self.chance = fleet, fleet.world, fleet.world.chance
        self._copy: Any = None
        self.all: dict[str, Callable[[], float]] = {
            "kill": self.kill,
            "kill inside": self.kill_inside,
            "pause": self.pause,
            "pause inside": self.pause_inside,
            "cut": self.cut,
            "cut inside": self.cut_inside,
            "cut and kill": self.cut_and_kill,
            "freeze the server": self.freeze,
            "freeze and kill": self.freeze_and_kill,
            "freeze inside": self.freeze_inside,
            "restart the server": self.restart,
            "step the server's clock": self.step_clock,
            "kill all": self.kill_all,
            "tear a file": self.tear,
            "fill a disk": self.fill,
            "fail over to an older copy": self.fail_over,
        }

    # ------------------------------------------------------------------ each gives its seconds
    def kill(self) -> float:
        self._any().end("killed")
        return 0.0

    def kill_all(self) -> float:
        for cell in self.fleet.cells:
            cell.end("killed")
        return 0.0

    def kill_inside(self) -> float:
        def kill(place: str) -> None:
            raise Killed

        self.world.arm(self._any().name, self.chance.randrange(60), kill)
        return 0.0

    def tear(self) -> float:
        """The process ends, and a sector of one of its files is not what was written."""
        cell = self._any()
        self.fleet.gone |= self.fleet.waiting([cell])  # as many as are lost, which is counted
        cell.end("killed")
        file = cell.folder / self.chance.choice(["outbox.db", "spool.db"])
        content = bytearray(file.read_bytes())
        begin = self.chance.randrange(0, max(len(content), 1), _SECTOR)
        content[begin : begin + _SECTOR] = bytes(len(content[begin : begin + _SECTOR]))
        file.write_bytes(content)
        return 0.0

    def fill(self) -> float:
        cell, seconds = self._any(), self._seconds()
        self.world.full_until_s[cell.name] = self.world.now_s + seconds
        return seconds

    def pause(self) -> float:
        seconds = self._seconds()
        cell = self._any()
        cell.next_s = self.world.now_s + seconds
        cell.is_disturbed = True
        return seconds

    def pause_inside(self) -> float:
        cell, seconds = self._any(), self._seconds()

        def pause(place: str) -> None:
            if place in ("a commit",):  # others wait for the turn of the writers
                self.world.arm(cell.name, 0, pause)
                return
            cell.is_disturbed = True
            self.world.run_for(seconds)

        self.world.arm(cell.name, self.chance.randrange(60), pause)
        return seconds

    def cut(self) -> float:
        cell, seconds = self._any(), self._seconds()
        self._cut(cell, seconds)
        return seconds

    def cut_inside(self) -> float:
        cell, seconds = self._any(), self._seconds()

        def cut(place: str) -> None:
            self._cut(cell, seconds)

        self.world.arm(cell.name, self.chance.randrange(60), cut)
        return seconds

    def cut_and_kill(self) -> float:
        cell, seconds = self._any(), self._seconds()
        self._cut(cell, seconds)
        return self._killed_meanwhile(cell, seconds)

    def freeze_and_kill(self) -> float:
        seconds = self.freeze()
        return self._killed_meanwhile(self._any(), seconds)

    def _killed_meanwhile(self, cell: Cell, seconds: float) -> float:
        after_s = self.chance.uniform(0.0, seconds)
        self._work(after_s)
        cell.end("killed")
        return max(seconds - after_s, 0.0)

    def freeze(self) -> float:
        seconds = self._seconds()
        self.fleet.server.freeze(seconds)
        return seconds

    def freeze_inside(self) -> float:
        seconds = self._seconds()

        def freeze(place: str) -> None:
            self.fleet.server.freeze(seconds)

        self.world.arm(self._any().name, self.chance.randrange(60), freeze)
        return seconds

    def restart(self) -> float:
        seconds = self.chance.uniform(0.0, 8.0)
        self.fleet.server.restart(seconds)
        return seconds

    def step_clock(self) -> float:
        self.fleet.server.clock_ahead_s += self.chance.choice([-3600.0, -5.0, 5.0, 3600.0])
        return 0.0

    def fail_over(self) -> float:
        """The database is an older copy of itself; a person sees what is named, and confirms it."""
        fleet = self.fleet
        copy = self._copy or fleet.copy()
        self._work(self.chance.uniform(0.0, 20.0))
        fleet.fail_over(copy)
        fleet.verified.clear()
        self._work(self.chance.uniform(0.0, 20.0))
        if fleet.knows_its_store:
            fleet.confirm()
        return 3.0

    def _cut(self, cell: Cell, seconds: float) -> None:
        cell.is_disturbed = True
        server = self.fleet.server
        server.cut[cell.name] = self.world.now_s + seconds
        if cell.runs:
            server.end(cell.runs[-1])

    def _any(self) -> Cell:
        return self.chance.choice(self.fleet.cells)

    def _seconds(self) -> float:
        return self.chance.choice([1.0, 3.0, 5.0, 9.0, 20.0]) * self.chance.uniform(0.8, 1.2)

    # ------------------------------------------------------------------ rounds
    def round(self) -> None:
        """Do something to the fleet while it works, and wait until it is quiet."""
        chance, world = self.chance, self.world
        names = chance.sample(sorted(self.all), min(chance.choice([1, 1, 1, 2]), len(self.all)))
        lasts_s = 0.0
        for name in names:
            world.note(f"act: {name}")
            lasts_s = max(lasts_s, self.all[name]())
            self._work(chance.uniform(0.0, 3.0))
        self._work(lasts_s + chance.uniform(0.0, 6.0))
        world.traps.clear()
        self._until_up()
        world.note("quiet")
        world.run_for(OWNED_WITHIN_S)
        self.require_owned()
        self.require_agreed()
        self.require_stored()
        for cell in self.fleet.cells:
            cell.is_disturbed = False
        if chance.random() < 0.1:
            self._copy = self.fleet.copy()
        if chance.random() < 0.2:  # what was known of the dead is forgotten
            world.run_for(60.0)

    def _work(self, seconds: float) -> None:
        """Let machines get hot and cold, and operators work, meanwhile."""
        until_s = self.world.now_s + seconds
        while self.world.now_s < until_s:
            self.world.run_for(min(self.chance.uniform(0.1, 1.5), until_s - self.world.now_s))
            act = self.chance.random()
            if act < 0.5:
                self.fleet.hot ^= {self.chance.choice(ASSETS)}
            elif act < 0.8:
                self.fleet.acknowledge_one()

    def _until_up(self) -> None:
        server, world = self.fleet.server, self.world
        for _ in range(120):
            over_s = max([server.frozen_until_s, server.down_until_s, *server.cut.values()])
            if world.now_s >= over_s and all(cell.is_up for cell in self.fleet.cells):
                return
            world.run_for(0.5)
        world.require(False, "the cells do not come back")

    # ------------------------------------------------------------------ invariants of quiet
    def require_owned(self) -> None:
        server = self.fleet.server
        runs = {cell.runs[-1]: cell for cell in self.fleet.cells if cell.is_up}
        free = [
            id
            for id, (_, owner) in server.partitions.items()
            if owner not in runs or id not in server.locks or server.locks[id]._cell != owner
        ]
        self.world.require(not free, f"partitions {free} are not owned {OWNED_WITHIN_S:g} s on")

    def require_agreed(self) -> None:
        differing = self._differing()
        for _ in range(round(_AGREE_WITHIN_S)):
            if not differing:
                break
            self.world.run_for(1.0)
            differing = self._differing()
        self.world.require(not differing, f"open alarms differ: {differing}")
        revived = self.fleet.file.execute("SELECT id FROM sim_revived").fetchall()
        self.world.require(not revived, f"alarms that had ended have come back: {revived}")

    def _differing(self) -> list[str]:
        stored = {(one.asset, one.id, one.state) for one in self.fleet.store.alarms.load()}
        owned = {
            (one.asset, one.id, one.state)
            for cell in self.fleet.cells
            for one in cell.book.active()
        }
        hot = {asset for asset, _, state in stored if state in ("UNACK", "ACKED")}
        return [
            *(f"only stored: {one}" for one in sorted(stored - owned)),
            *(f"only owned: {one}" for one in sorted(owned - stored)),
            *(f"hot without an alarm, or cold with one: {one}" for one in hot ^ self.fleet.hot),
        ]

    def require_stored(self) -> None:
        fleet = self.fleet
        for number in sorted(fleet.acknowledged.keys() - fleet.verified):
            rows = fleet.rows_of(number)
            for _ in range(_STORED_WITHIN):  # it may wait on the disk of a cell that begins again
                if rows or number in fleet.gone:
                    break
                self.world.run_for(1.0)
                rows = fleet.rows_of(number)
            if not rows and number in fleet.gone:
                continue
            self.world.require(
                rows == [(float(number),)],
                f"sample {number} of {fleet.acknowledged[number]} is stored as {rows}",
            )
            fleet.verified.add(number)


def simulate(
    seed: int,
    folder: Path,
    days: float,
    join: Join = product_order,
    knows_its_store: bool = True,
    only: Collection[str] = (),
) -> Fleet:
    """Simulate so many service-days; raises `BrokenError` where an invariant does not hold."""
    world = World(seed)
    with simulated(world):
        fleet = Fleet(world, folder, world.chance.choice([2, 3, 3, 4]), join, knows_its_store)
        try:
            acts = Acts(fleet)
            acts.all = {name: one for name, one in acts.all.items() if not only or name in only}
            world.run_for(30.0)
            for _ in range(max(round(days * ACTS_A_DAY), 1)):
                acts.round()
        finally:
            fleet.close()
    return fleet
