"""What a client without a key can make the OPC UA server keep: very little, and not for long."""

import asyncio
import socket
import struct
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client
from opcua_site import RING, Asset, Serving, apart, inside, make_client, read
from patience import patience, wait_for, within

from service.plant.opcua.wire import (
    MOST_BYTES_BEFORE_ACTIVATION,
    MOST_MESSAGES_BEFORE_ACTIVATION,
    MOST_STRANGERS,
)
from service.security.keys import create_key
from service.store import Outbox, Store

PATIENCE_S = 60.0
MIB = 1 << 20
#: What the sockets between the two may hold.
ON_THE_WAY = 16 * MIB
GET_ENDPOINTS = b"\x01\x00\xac\x01"  # the number of the request, 428


def connect(served: Serving) -> socket.socket:
    port = int(served.address.rsplit(":", 1)[1].split("/")[0])
    return socket.create_connection(("127.0.0.1", port), timeout=patience(PATIENCE_S))


def is_closed(line: socket.socket) -> bool:
    """Return whether the server has closed a connection; waits for it."""
    try:
        return line.recv(1) == b""
    except ConnectionError:
        return True


def pump(line: socket.socket, most: int) -> int:
    """Send until the server closes; tells how much went."""
    sent, piece = 0, b"x" * 65_536
    try:
        while sent < most:
            sent += line.send(piece)
    except ConnectionError:
        pass
    return sent


@pytest.mark.wires
@pytest.mark.parametrize("kind", [b"HEL", b"OPN", b"MSG", b"XYZ"])
async def test_a_piece_that_announces_4_gb_ends_the_connection(
    tmp_path: Path, store: Store, outbox: Outbox, kind: bytes
) -> None:
    async with inside(Asset(), tmp_path, store, outbox) as served:
        with connect(served) as line:
            line.sendall(struct.pack("<3scI", kind, b"F", 0xFFFF_FFFF))
            sent = await asyncio.to_thread(pump, line, 4 * ON_THE_WAY)
            assert sent < ON_THE_WAY

        async def look() -> Any:
            async with Client(served.address) as client:
                return (await read(client, RING)).Value.Value

        assert await apart(look) == 61.5


@pytest.mark.wires
@pytest.mark.parametrize("size", [0, 7, MOST_BYTES_BEFORE_ACTIVATION + 1])
async def test_a_size_that_no_piece_has_ends_the_connection(
    tmp_path: Path, store: Store, outbox: Outbox, size: int
) -> None:
    async with inside(Asset(), tmp_path, store, outbox) as served:
        with connect(served) as line:
            line.sendall(struct.pack("<3scI", b"HEL", b"F", size))
            assert await asyncio.to_thread(is_closed, line)


@pytest.mark.wires
async def test_a_message_without_end_and_messages_without_end_close_the_connection(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    async with inside(Asset(), tmp_path, store, outbox) as served:

        async def closes(data: bytes, times: int) -> bool:
            """Open a channel and send; returns whether the server hangs up."""
            client = Client(served.address)
            await client.connect_sessionless()
            protocol = client.uaclient.protocol
            gone = asyncio.Event()
            protocol.on_connection_lost = lambda error: gone.set()
            connection = protocol._connection
            try:
                for _ in range(times):
                    if protocol.transport is None:
                        break
                    binary = connection.message_to_binary(data, request_id=7)
                    first = int.from_bytes(binary[4:8], "little")
                    whole = first == len(binary)
                    protocol.transport.write(
                        binary if whole else binary[: first * (len(binary) // first)]
                    )
                await wait_for(gone.wait(), PATIENCE_S)
            finally:
                client.disconnect_socket()
            return True

        async def look() -> None:
            # Pieces of one message of which the last never comes.
            assert await closes(GET_ENDPOINTS + b"\0" * (3 * 65_000), 1)
            # Requests that are answered, one after the other: encrypting alone costs time.
            assert await closes(
                b"\x01\x00\xac\x01" + b"\0" * 64, MOST_MESSAGES_BEFORE_ACTIVATION + 2
            )

        await apart(look)


@pytest.mark.wires
async def test_idle_connections_leave_room_for_whoever_has_a_key(
    tmp_path: Path, store: Store, outbox: Outbox
) -> None:
    key = create_key(store, "viewer").text
    async with inside(Asset(), tmp_path, store, outbox) as served:

        async def look() -> None:
            async with await make_client(served.address, key) as client:
                lines = [connect(served) for _ in range(3 * MOST_STRANGERS)]
                try:
                    refused = lines[MOST_STRANGERS:]
                    closed = [await asyncio.to_thread(is_closed, line) for line in refused]
                    assert all(closed)
                    assert (await read(client, RING)).Value.Value == 61.5
                finally:
                    for line in lines:
                        line.close()
            async with within(PATIENCE_S):
                while True:  # as soon as they are gone
                    try:
                        async with await make_client(served.address, key) as client:
                            return
                    except (ConnectionError, asyncio.IncompleteReadError):
                        await asyncio.sleep(0.05)

        await apart(look)
