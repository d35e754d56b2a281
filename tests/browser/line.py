"""A line between browser and service on which the stream can fall silent without an end."""

import asyncio
import contextlib
import threading
from collections.abc import Iterator

_CHUNK = 65536
_UPGRADE = b"upgrade: websocket"


class Line:
    """Passes everything on, but for the streams while they are held.

    Attributes
    ----------
    address
        Of the service as the browser sees it.
    opened
        How many streams were opened through it.
    """

    def __init__(self, host: str, port: int) -> None:
        self._service = host, port
        self._held: set[asyncio.Event] = set()
        self._holds_new = False
        self.opened = 0
        self.address = ""

    def hold(self, *, new_ones: bool) -> None:
        """Stop passing on what comes on the open streams, and on later ones where `new_ones`."""
        self._holds_new = new_ones
        for passing in self._held:
            passing.clear()

    async def serve(self, ready: threading.Event) -> None:
        """Pass connections on until cancelled."""
        server = await asyncio.start_server(self._attend, "127.0.0.1", 0)
        self.address = "http://{}:{}".format(*server.sockets[0].getsockname())
        ready.set()
        async with server:
            await server.serve_forever()

    async def _attend(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        passing = asyncio.Event()
        passing.set()
        # A task that ends by being cancelled is an error to the server of asyncio.
        with contextlib.suppress(asyncio.IncompleteReadError, OSError, asyncio.CancelledError):
            head = await reader.readuntil(b"\r\n\r\n")
            upstream = await asyncio.open_connection(*self._service)
            if _UPGRADE in head.lower():
                self.opened += 1
                self._held.add(passing)
                if self._holds_new:
                    passing.clear()
            upstream[1].write(head)
            try:
                await asyncio.gather(
                    _copy(reader, upstream[1]), _copy(upstream[0], writer, passing)
                )
            finally:
                upstream[1].close()
        self._held.discard(passing)
        writer.close()


async def _copy(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    passing: asyncio.Event | None = None,
) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(_CHUNK):
            if passing is not None:
                await passing.wait()
            writer.write(data)
            await writer.drain()
    writer.close()


@contextlib.contextmanager
def running_line(host: str, port: int) -> Iterator[Line]:
    """Run a line in a thread of its own."""
    line, ready = Line(host, port), threading.Event()
    loop = asyncio.new_event_loop()
    task = loop.create_task(line.serve(ready))

    def run() -> None:
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(task)
        rest = asyncio.all_tasks(loop)
        for one in rest:
            one.cancel()
        loop.run_until_complete(asyncio.gather(*rest, return_exceptions=True))
        loop.run_until_complete(asyncio.sleep(0))  # what was closed goes
        loop.close()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert ready.wait(10)
        yield line
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()
