"""A client of MQTT that leaves alone the sockets of others, and ends when it is cancelled."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from aiomqtt import Client, MqttError
from paho.mqtt.client import Client as Paho


class MqttClient(Client):
    """`aiomqtt.Client`, which listens to a socket only as long as it is its own.

    aiomqtt (2.5.1, the newest) asks the loop to listen to the *number* of a socket, some time
    later. Where the connection ended meanwhile, the number may be that of any other socket of the
    process, and the loop takes it for known when that is gone: the next socket with this number
    is never heard, be it of OPC UA, of Modbus or of the next connection to the broker.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        # Where it asks for all that it wants of the loop.
        self._loop: Any = _OwnSockets(self._loop, self._client)

    async def _wait_for(self, fut: Awaitable[Any], timeout: float | None) -> Any:
        """Wait for an answer of the broker.

        aiomqtt uses `asyncio.wait_for`, which in Python 3.11 swallows a cancellation that comes
        together with the answer: the task would then go on, and its group wait for it without end.
        """
        try:
            async with asyncio.timeout(self.timeout if timeout is None else timeout):
                return await fut
        except TimeoutError:
            raise MqttError("Operation timed out") from None


class _OwnSockets:
    """An event loop that is asked about sockets by their numbers, some time after."""

    def __init__(self, loop: asyncio.AbstractEventLoop, client: Paho) -> None:
        self._loop = loop
        self._client = client

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loop, name)

    def add_reader(self, number: int, callback: Callable[[], None]) -> None:
        if self._is_own(number):
            self._loop.add_reader(number, callback)

    def add_writer(self, number: int, callback: Callable[[], None]) -> None:
        if self._is_own(number):
            self._loop.add_writer(number, callback)

    def _is_own(self, number: int) -> bool:
        socket = self._client.socket()
        return socket is not None and socket.fileno() == number
