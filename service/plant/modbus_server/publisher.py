"""The Modbus server as a publisher: it listens, and counts its heartbeat."""

import asyncio
from collections.abc import Collection, Mapping
from typing import Final

import structlog

from service.plant.modbus_server.image import Image
from service.plant.modbus_server.register_map import RegisterMap
from service.plant.modbus_server.wire import ReadingServer
from service.plant.protocol import Host, TagValue
from service.site.settings import ModbusServerSection

HEARTBEAT_S: Final = 1.0

_log = structlog.get_logger(__name__)


class ModbusPublisher:
    """The server, a new one for each round; see `service.plant.protocol.Publisher`.

    Each request is answered from the snapshot of its moment (`Host.tags_of`), so that there is
    nothing to publish and no copy that could get old unnoticed.
    """

    def __init__(self, section: ModbusServerSection, map: RegisterMap) -> None:
        self._section = section
        self._map = map
        self._heartbeat = 0
        self._image: Image
        self._server: ReadingServer | None = None

    async def open(self, host: Host) -> None:
        """Make the registers; `run` listens."""
        self._image = Image(self._map, host.tags_of, host.now_us)
        self._server = ReadingServer(self._image.registers, self._image.bits)

    async def run(self) -> None:
        """Listen, and count, until cancelled."""
        if self._server is None:
            raise RuntimeError("not opened")
        section = self._section
        self._image.heartbeat = self._heartbeat
        await self._server.listen(section.host, section.port)
        _log.info(
            "modbus_server_listens",
            host=section.host,
            port=section.port,
            tags=len(self._map.tags),
            map_version=self._map.version,
        )
        while True:
            await asyncio.sleep(HEARTBEAT_S)
            self._heartbeat = self._image.heartbeat = (self._heartbeat + 1) & 0xFFFF

    async def publish_tags(self, asset: str, tags: Mapping[str, TagValue]) -> Collection[str]:
        """Do nothing: requests are answered from the snapshot itself."""
        return ()

    async def withdraw_tags(self, asset: str, tags: Collection[str]) -> None:
        """Do nothing: what is gone is not in the snapshot."""

    async def publish_alarm(self, asset: str | None, alarm: Mapping[str, object]) -> None:
        """Do nothing: the number of active alarms is a tag."""

    async def close(self) -> None:
        """End all connections, and listen no more."""
        server, self._server = self._server, None
        if server is not None:
            await server.close()
