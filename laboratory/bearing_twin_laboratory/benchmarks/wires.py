"""CAN frames decoded and stored, and Modbus units polled together."""

import asyncio
import contextlib
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

import can
import cantools.database
from cantools.database.can import Database
from prometheus_client import CollectorRegistry
from pymodbus.client import AsyncModbusTcpClient

import adapters.virtual_bench
from adapters.drivers.can.config import CanChannel, CanSource
from adapters.drivers.can.driver import CanDriver
from adapters.drivers.modbus.config import ModbusChannel, ModbusTcpSource
from adapters.drivers.modbus.driver import ModbusDriver
from adapters.protocol import ChannelBinding
from adapters.samples import is_good
from bearing_twin_laboratory.benchmarks import peers
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from service.clock import ProcessClock
from service.ingest import Ingest, Spool
from service.store import Store

DBC = Path(adapters.virtual_bench.__file__).parent / "bench.dbc"
CAN_RATE = 10_000.0
_PATIENCE_S = 10.0  # without a further sample what is missing counts as lost

UNITS = 32
# Fast enough to poll without a pause between two cycles.
_HURRY = 100.0


def can_frames(
    progress: Progress, *, duration_s: float = 60.0, flat_out_s: float = 10.0
) -> Measurement:
    """Frames/s from the wire to the committed row, and 10,000 frames/s for a minute."""
    progress(0.0, "frames as fast as they are taken")
    sent, stored, seconds = asyncio.run(_store_frames(0.0, flat_out_s))
    progress(0.15, "python-can and cantools alone")
    reference = _decode_alone(flat_out_s)
    progress(0.3, f"{CAN_RATE:g} frames/s for {duration_s:g} s")
    paced_sent, paced_stored, paced_s = asyncio.run(_store_frames(CAN_RATE, duration_s))
    return Measurement(
        stored / seconds,
        "1/s",
        reference,
        "python-can's slcan receive and cantools' decode of the same frames, nothing stored",
        {
            "lost": paced_sent - paced_stored,
            "duration_s": paced_s,
            "paced_frames": paced_sent,
            "paced_frames_per_s": paced_sent / paced_s,
            "paced_lag_s": max(0.0, paced_s - duration_s),
            "flat_out_frames": sent,
            # Beyond any bus's rate: the driver keeps the newest and counts what it leaves out.
            "flat_out_left_out": sent - stored,
        },
    )


async def _store_frames(rate: float, seconds: float) -> tuple[int, int, float]:
    """Frames sent, samples stored (one per frame) and the seconds until the last commit."""
    with tempfile.TemporaryDirectory() as folder, peers.running("can", rate, seconds) as peer:
        source = CanSource(name="can", channel=f"socket://127.0.0.1:{peer.port}", dbc=DBC)
        channels = [
            ChannelBinding("bench", channel, CanChannel(source="can", message=message, signal=name))
            for channel, message, name in (
                ("speed_rpm", "DriveStatus", "Speed"),
                ("load_n", "LoadCell", "RadialLoad"),
            )
        ]
        with Store.open("", Path(folder)) as store:
            clock = ProcessClock()
            spool = Spool.open(Path(folder), 64)
            ingest = Ingest(store, spool, clock, lambda batch: None, registry=CollectorRegistry())
            pump = asyncio.create_task(ingest.run([CanDriver(source, channels, [], clock)]))
            try:
                began = (await asyncio.to_thread(peer.says))["began"]
                sent = int((await asyncio.to_thread(peer.says))["sent"])
                ended = await _until_stored(ingest, sent)
                stored = ingest.counts()["stored"]
            finally:
                pump.cancel()
                await asyncio.gather(pump, return_exceptions=True)
                spool.close()
    return sent, stored, ended - began


async def _until_stored(ingest: Ingest, expected: int) -> float:
    """Moment (monotonic) of the last progress towards this many stored samples."""
    seen, moment = -1, time.monotonic()
    while seen < expected and time.monotonic() - moment < _PATIENCE_S:
        stored = ingest.counts()["stored"]
        if stored != seen:
            seen, moment = stored, time.monotonic()
        await asyncio.sleep(0.01)
    return moment


def _decode_alone(seconds: float) -> float:
    database = cantools.database.load_file(DBC)
    if not isinstance(database, Database):
        raise BenchmarkError(f"{DBC}: expected a CAN database")
    with peers.running("can", 0.0, seconds) as peer:
        bus = can.Bus(
            channel=f"socket://127.0.0.1:{peer.port}", interface="slcan", sleep_after_open=0.0
        )
        with bus:
            began = peer.says()["began"]
            received = 0
            while time.monotonic() - began < seconds:
                frame = bus.recv(1.0)
                if frame is None:
                    break
                database.decode_message(frame.arbitration_id, bytes(frame.data))
                received += 1
            return float(received / (time.monotonic() - began))


def modbus_reads(progress: Progress, *, duration_s: float = 60.0) -> Measurement:
    """Reads/s of 32 units behind one gateway, and what one dead unit costs the others."""
    return asyncio.run(_modbus_reads(progress, duration_s))


async def _modbus_reads(progress: Progress, duration_s: float) -> Measurement:
    rounds = 6
    ours = alone = 0.0
    busy_s = {"ours": 0.0, "alone": 0.0}
    with peers.running("modbus") as peer:
        for number in range(rounds):  # in turn, as the machine may have other things to do
            progress(0.5 * number / rounds, "32 units, driver and client in turn")
            seconds = duration_s / rounds / 2
            began_s = time.process_time()
            ours += await _driver_reads(peer.port, seconds)
            between_s = time.process_time()
            alone += await _client_reads(peer.port, seconds)
            busy_s["ours"] += between_s - began_s
            busy_s["alone"] += time.process_time() - between_s
        progress(0.5, "10 polls/s, all units alive")
        alive = await _paced_reads(peer, duration_s, dead=None)
        progress(0.75, "10 polls/s, one unit dies")
        with_dead = await _paced_reads(peer, duration_s, dead=UNITS)
    return Measurement(
        ours / rounds,
        "1/s",
        alone / rounds,
        "pymodbus client alone, the same reads one after the other",
        {
            "units": UNITS,
            # Of this process, per read; on a machine with other work the fairer figure.
            "processor_time_ratio": busy_s["alone"] / alone / (busy_s["ours"] / ours),
            "dead_unit_slowdown": max(0.0, 1.0 - with_dead / alive),
            "dead_unit_duration_s": duration_s,
        },
    )


@contextlib.asynccontextmanager
async def _driver(port: int, poll_interval_s: float, rate: float) -> AsyncIterator[ModbusDriver]:
    source = ModbusTcpSource(
        name="gateway", host="127.0.0.1", port=port, poll_interval_s=poll_interval_s
    )
    bindings = [
        ChannelBinding(
            f"bench-{unit}",
            f"t_node_{1 + number}_c",
            ModbusChannel.model_validate(
                {
                    "source": "gateway",
                    "register": number,
                    "kind": "input",
                    "scale": 0.1,
                    "unit_id": unit,
                    "sentinels": [-32768],
                }
            ),
        )
        for unit in range(1, UNITS + 1)
        for number in range(peers.REGISTERS)
    ]
    async with ModbusDriver(source, bindings, [], ProcessClock(rate)) as driver:
        yield driver


async def _driver_reads(port: int, seconds: float) -> float:
    async with _driver(port, 0.01, _HURRY) as driver:
        samples = 0
        began = 0.0
        async for batch in driver.batches():
            if not began:  # the first cycle connects
                began = time.perf_counter()
                continue
            samples += len(batch.samples)
            if (passed_s := time.perf_counter() - began) >= seconds:
                break
        return samples / peers.REGISTERS / passed_s


async def _client_reads(port: int, seconds: float) -> float:
    client = AsyncModbusTcpClient("127.0.0.1", port=port)
    try:
        if not await client.connect():
            raise BenchmarkError("the benchmark's own Modbus server does not answer")
        reads = 0
        began = time.perf_counter()
        while (passed_s := time.perf_counter() - began) < seconds:
            for unit in range(1, UNITS + 1):
                answer = await client.read_input_registers(0, count=peers.REGISTERS, device_id=unit)
                assert len(answer.registers) == peers.REGISTERS  # noqa: S101
            reads += UNITS
        return reads / passed_s
    finally:
        client.close()


async def _paced_reads(peer: peers.Peer, seconds: float, dead: int | None) -> float:
    """Good samples of the units that live, at 10 polls/s; one unit may die at the beginning."""
    good = 0
    async with _driver(peer.port, 0.1, 1.0) as driver:
        batches = driver.batches()
        await anext(batches)
        if dead is not None:
            peer.send(f"dead {dead}")
        end = time.monotonic() + seconds
        async for batch in batches:
            if time.monotonic() > end:
                break
            good += sum(
                is_good(one.quality) for one in batch.samples if one.asset != f"bench-{UNITS}"
            )
    if dead is not None:
        peer.send(f"alive {dead}")
    return float(good)
