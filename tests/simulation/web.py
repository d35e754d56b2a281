"""A web process over cells that come, go, hang and are cut off: routing, copies, and resuming.

`Fleet`, `CellLink`, `NatsCellBus`, `FleetFollowing`, `Following`, `LiveMessages`, `Replicas` and
`AssetReplica` are the product's; NATS is a fake that loses what a real one loses, and the clock is
that of a loop that jumps.
"""

import asyncio
import contextlib
import json
import random
from collections import deque
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import structlog
from jumping import JumpingLoop, LoopClock
from simulation.nats import _TRAVEL_S, Connection, Nats
from simulation.world import BrokenError, replaced

from service import pauses
from service.bus import asking, dispatch, fleet_cells, loop_share, nats_bus, replica, replicas
from service.bus.calls import answering, command_type
from service.bus.commands import Assets, LiveStream, PackedDocument, Wanted
from service.bus.fleet_cells import Fleet
from service.bus.fleet_following import FleetFollowing
from service.bus.following import packed
from service.bus.interface import STREAM_TOPIC
from service.bus.messages import CellState
from service.bus.nats_bus import NatsCellBus
from service.bus.replica import UNCERTAIN_AFTER_S, digest
from service.bus.replicas import Replicas
from service.bus.stream import LiveMessages
from service.bus.subscription import SubscriptionClosedError
from service.cell.answers import StreamAnswers
from service.domain.errors import CellUnavailableError

PARTITIONS = 4
ASSETS = tuple(f"axle-{number}" for number in range(4))
ACTS_A_DAY = 24
QUIET_S = 10.0
_START_US = 1_700_000_000_000_000


class WebCell:
    """One run of a cell: what it owns, it says; what it follows, it tells."""

    def __init__(self, site: "Site", run: str) -> None:
        self.site, self.run = site, run
        self.connection = Connection(site.nats)
        self.bus = NatsCellBus(cast(Any, self.connection), run)
        self.stream = LiveMessages(
            site.clock,
            self.bus.epoch,
            history_messages=300,
            on_message=lambda one: self.bus.publish(STREAM_TOPIC, one.seq, packed(one)),
        )
        self.owned: dict[int, int] = {}
        self._followed = 0
        self.tasks = [asyncio.create_task(one) for one in (self._serve(), self._live())]

    @property
    def assets(self) -> list[str]:
        return [one for one in ASSETS if self.site.partition(one) in self.owned]

    def change(self, partition: int, epoch: int | None) -> None:
        self._followed += 1
        if epoch is None:
            self.owned.pop(partition, None)
        else:
            self.owned[partition] = epoch

    async def _serve(self) -> None:
        async def names() -> dict[str, int]:
            return dict.fromkeys(self.assets, 1)

        async def documents(wanted: list[Wanted]) -> list[PackedDocument]:
            return [self._document(one.asset, one.kind) for one in wanted]

        await self.bus.serve(
            {
                command_type(Assets.names): lambda _: names(),
                command_type(Assets.documents): lambda command: documents(command.wanted),
                **answering(LiveStream)(StreamAnswers(self.stream)),
            }
        )

    def _document(self, asset: str, kind: str) -> PackedDocument:
        if asset not in self.assets:
            return PackedDocument(b"", None)
        now_s = asyncio.get_running_loop().time()
        text = b"{}"
        if kind == "verdict":
            word = {
                "word": "safe", "reasons": [f"{now_s} {self.run}"], "limit": None,
                "probability": None, "seconds_to_limit": None, "alarm_probability": None,
            }  # fmt: skip
            text = json.dumps(self.site.verdict(word)).encode()
        return PackedDocument(digest(text), text)

    async def _live(self) -> None:
        while True:
            await asyncio.sleep(0.25)
            if self.connection.is_paused:
                continue
            for asset in self.assets:
                # One that has lost it and does not know it yet says things that nobody counts.
                if self.stream.is_followed(asset):
                    is_owner = self.site.owner(self.site.partition(asset)) is self
                    self.site.told[asset] += is_owner
                    number = self.site.told[asset] if is_owner else None
                    self.stream.publish("measurement", asset, {"number": number})
            self.bus.report(
                CellState(
                    ready=True, stream=self.stream.seq, assets=self._followed,
                    partitions=dict(self.owned), followed=self._followed,
                )
            )  # fmt: skip

    async def end(self) -> None:
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        self.connection.close()


class Site:
    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.chance = random.Random(seed)
        self.nats = Nats()
        self.clock = LoopClock(1.0, _START_US)
        self.told = dict.fromkeys(ASSETS, 0)
        self.cells: list[WebCell] = []
        self.epochs = dict.fromkeys(range(PARTITIONS), 0)
        # What the database says: epoch and owner.
        self.recorded: dict[int, tuple[int, str]] = {}
        self.trace: deque[str] = deque(maxlen=40)
        self.broken = ""
        self.answers = self.safe = self.messages = self.gaps = 0
        self._runs = 0

    def verdict(self, word: dict[str, object]) -> dict[str, object]:
        from service.documents.verdicts import VerdictDocument

        document: dict[str, object] = dict.fromkeys(VerdictDocument.model_fields)
        for name in ("now", "next_step", "present_step"):
            if name in document:
                document[name] = word | ({"ends_at": None} if name == "present_step" else {})
        return document | {"missing": [], "time": "2026-01-01T00:00:00.000Z"}

    def chance_of(self, who: str) -> random.Random:
        """Chance of an actor of its own: the order of those that wake at one moment is not ours."""
        return random.Random(f"{self.seed} {who}")

    def partition(self, asset: str) -> int:
        return ASSETS.index(asset) % PARTITIONS

    def note(self, text: str) -> None:
        self.trace.append(f"{asyncio.get_running_loop().time():9.2f} {text}")

    def require(self, holds: bool, what: str) -> None:
        if not holds and not self.broken:
            self.broken = "\n".join([f"seed {self.seed}: {what}", *self.trace])

    # ------------------------------------------------------------------ ownership
    def begin(self) -> WebCell:
        self._runs += 1
        cell = WebCell(self, f"bearing-twin sim {self.seed:04}{self._runs:04}")
        self.cells.append(cell)
        return cell

    def owner(self, partition: int) -> WebCell | None:
        owners = [one for one in self.cells if partition in one.owned]
        return max(owners, key=lambda one: one.owned[partition], default=None)

    def give(self, partition: int, cell: WebCell) -> None:
        self.epochs[partition] += 1
        self.recorded[partition] = self.epochs[partition], cell.run
        cell.change(partition, self.epochs[partition])
        self.note(f"{cell.run[-4:]} owns {partition} at epoch {self.epochs[partition]}")

    def share_out(self) -> None:
        """Give to cells that work what others have no more, or hang with."""
        working = [one for one in self.cells if not one.connection.is_paused]
        for partition in range(PARTITIONS):
            owner = self.owner(partition)
            if working and (owner is None or owner.connection.is_paused):
                self.give(partition, self.chance.choice(working))

    def is_stale(self, cell: WebCell) -> bool:
        return any(epoch < self.epochs[one] for one, epoch in cell.owned.items())

    # ------------------------------------------------------------------ acts
    async def act(self) -> None:
        chance = self.chance
        cell = chance.choice(self.cells)
        seconds = chance.uniform(0.5, 15.0)
        what = chance.choice(["kill", "pause", "cut", "nats", "move", "older copy"])
        self.note(f"act: {what} {cell.run[-4:]} {seconds:.1f} s")
        if what == "kill":
            self.cells.remove(cell)
            await cell.end()
            await asyncio.sleep(chance.uniform(0.3, 5.0))
            self.share_out()
            self.begin()
        elif what == "pause":
            cell.connection.is_paused = True
            await asyncio.sleep(min(seconds, 4.5))
            if seconds > 4.5:
                self.share_out()
                await asyncio.sleep(seconds - 4.5)
            cell.connection.is_paused = False
            cell.connection.go_on()
            await asyncio.sleep(chance.uniform(0.0, 0.6))  # until it looks at its row
            if self.is_stale(cell):
                self.cells.remove(cell)
                await cell.end()
                self.begin()
        elif what == "cut":
            cell.connection.is_cut = True
            await asyncio.sleep(seconds)
            cell.connection.is_cut = False
        elif what == "nats":
            self.nats.is_down = True
            await asyncio.sleep(seconds)
            self.nats.is_down = False
        elif what == "older copy":
            # Epochs are given once more, and whoever had them begins again.
            self.epochs = {one: max(epoch - 3, 0) for one, epoch in self.epochs.items()}
            for one in list(self.cells):
                self.cells.remove(one)
                await one.end()
                self.begin()
            await asyncio.sleep(chance.uniform(0.0, 5.0))
        else:
            partition = chance.randrange(PARTITIONS)
            before = self.owner(partition)
            if before is not None:
                before.change(partition, None)
                await asyncio.sleep(chance.uniform(0.0, 1.0))
            self.give(partition, chance.choice(self.cells))


class Web:
    """One web process with its callers and its clients."""

    def __init__(self, site: Site) -> None:
        self.site = site

        async def none() -> list[Any]:
            return []

        async def recorded() -> dict[int, tuple[int, str]]:
            await asyncio.sleep(_TRAVEL_S)
            return dict(site.recorded)

        connection = cast(Any, Connection(site.nats))
        self.fleet = Fleet(connection, PARTITIONS, lambda: ASSETS, none, recorded)
        self.bus = LiveMessages(site.clock, self.fleet.epoch)
        self.following = FleetFollowing(self.fleet, self.bus, site.clock)
        self.replicas = Replicas(self.fleet)

    def work(self) -> list[asyncio.Task[None]]:
        parts = [self.fleet.run(), self.following.run(), self.replicas.follow()]
        parts += [self._call(asset) for asset in ASSETS]
        parts += [self._client(asset) for asset in ASSETS]
        return [asyncio.create_task(one) for one in parts]

    async def _call(self, asset: str) -> None:
        """Ask for the verdict again and again: never safe without inputs."""
        site, loop = self.site, asyncio.get_running_loop()
        chance = site.chance_of(f"caller of {asset}")
        while True:
            await asyncio.sleep(chance.uniform(0.1, 0.8))
            one = self.replicas.assets.get(asset)
            if one is None:
                continue
            with contextlib.suppress(CellUnavailableError):
                await one.refresh("verdict")
                document = json.loads(one.text("verdict")[0])
                site.answers += 1
                if document["now"]["word"] == "safe":
                    site.safe += 1
                    age_s = loop.time() - float(document["now"]["reasons"][0].split()[0])
                    site.require(
                        age_s <= UNCERTAIN_AFTER_S, f"{asset} is called safe, {age_s:.1f} s old"
                    )

    async def _client(self, asset: str) -> None:
        """Follow the stream, go, and come back: nothing is missing without a word."""
        site, bus = self.site, self.bus
        chance = site.chance_of(f"client of {asset}")
        last: int | None = None
        number = 0
        while True:
            await asyncio.sleep(chance.uniform(0.0, 6.0))
            try:
                complete: int | None = await self.following.follow([asset])
            except CellUnavailableError:
                complete = None
            resume = -1 if last is not None and complete is None else last
            subscription = bus.subscribe([asset], resume, complete_after=complete or 0)
            if last is None or subscription.gap:
                site.gaps += last is not None
                number = 0
            ends_s = asyncio.get_running_loop().time() + chance.uniform(1.0, 60.0)
            with contextlib.suppress(TimeoutError, SubscriptionClosedError):
                async with asyncio.timeout_at(ends_s):
                    while True:
                        message = await subscription.get()
                        last = message.seq
                        if message.type != "measurement":
                            continue
                        site.messages += 1
                        found = json.loads(message.text)["data"]["number"]
                        if found is None:
                            continue
                        site.require(
                            number in (0, found - 1),
                            f"{asset}: message {found} after {number}, and no gap was told",
                        )
                        number = found
            subscription.close()
            if last is None:
                last = subscription.start_seq


async def _simulate(seed: int, days: float) -> Site:
    site = Site(seed)
    for _ in range(site.chance.choice([2, 3])):
        site.begin()
    site.share_out()
    web = Web(site)
    tasks = web.work()
    try:
        await asyncio.sleep(5.0)
        for _ in range(max(round(days * ACTS_A_DAY), 1)):
            await site.act()
            site.share_out()
            site.note("quiet")
            await asyncio.sleep(QUIET_S)
            site.require(not web.fleet.missing(), f"{web.fleet.missing()} without a known owner")
            for asset in ASSETS:
                owner = site.owner(site.partition(asset))
                known = web.fleet._owner(asset)
                site.require(
                    owner is not None and known is not None and known.epoch == owner.bus.epoch,
                    f"questions on {asset} go to another than its owner",
                )
            failed = [one.exception() for one in tasks if one.done()]
            site.require(not failed, f"a part has ended: {failed}")
            if site.broken:
                raise BrokenError(site.broken)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for cell in site.cells:
            await cell.end()
    return site


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    try:
        yield
    finally:
        structlog.reset_defaults()


def simulate_web(seed: int, days: float) -> Site:
    """Simulate so many service-days; raises `BrokenError` where an invariant does not hold."""
    loop = JumpingLoop()
    # Also of what a step costs: a clock beside that of the loop pays no debt while it jumps.
    clock = SimpleNamespace(monotonic=loop.time, thread_time=loop.time, perf_counter=loop.time)
    modules = (asking, dispatch, fleet_cells, loop_share, nats_bus, pauses, replica, replicas)
    with _quiet(), replaced(*((module, "time", clock) for module in modules)):
        try:
            return loop.run_until_complete(_simulate(seed, days))
        finally:
            loop.close()
