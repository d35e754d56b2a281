"""Real servers and processes for the drivers to meet."""

import asyncio
import math
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import processes
import pytest
from patience import patience

from adapters.protocol import ChannelBinding, Driver, PlanBinding
from adapters.registry import driver_spec
from adapters.samples import Batch, PlannedProfile, Sample
from service.domain.channels import unit_of

PEERS = Path(__file__).parent / "peers"


class RunningClock:
    """A process clock that starts at a fixed moment."""

    def __init__(self, rate: float = 1.0) -> None:
        self.rate = rate
        self.began = time.monotonic()

    def now_us(self) -> int:
        return 1_900_000_000_000_000 + round((time.monotonic() - self.began) * self.rate * 1e6)

    async def sleep(self, process_seconds: float) -> None:
        await asyncio.sleep(process_seconds / self.rate)


class Record:
    """What a running driver has handed over."""

    def __init__(self, driver: Driver, clock: RunningClock) -> None:
        self.driver = driver
        self.clock = clock
        self.batches: list[Batch] = []
        self.clock_was_set_back = False

    @property
    def samples(self) -> list[Sample]:
        return [sample for batch in self.batches for sample in batch.samples]

    @property
    def plans(self) -> list[PlannedProfile]:
        return [plan for batch in self.batches for plan in batch.plans]

    def of(self, channel: str) -> list[Sample]:
        return [sample for sample in self.samples if sample.channel == channel]

    def qualities(self, channel: str) -> list[int]:
        return [sample.quality for sample in self.of(channel)]

    async def until(self, condition: Callable[[], Any], timeout_s: float = 30.0) -> None:
        """Wait until the condition holds; say what there is when it does not."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end:
                latest = {s.channel: s for s in self.samples}
                pytest.fail(f"waited {timeout_s} s; {self.driver.health()}; latest {latest}")
            await asyncio.sleep(0.01)

    def check(self) -> None:
        """What must hold whatever happened: no sample twice, times ascend, no value when bad."""
        last: dict[str, int] = {}
        for sample in self.samples:
            assert self.clock_was_set_back or sample.time_us > last.get(sample.channel, 0), sample
            last[sample.channel] = sample.time_us
            assert math.isnan(sample.value) == (sample.quality < 64), sample
            assert sample.received_us >= sample.time_us
        assert len({(s.channel, s.time_us) for s in self.samples}) == len(self.samples)
        assert self.driver.health().samples == len(self.samples)


@asynccontextmanager
async def running_driver(
    source: dict[str, Any],
    channels: dict[str, dict[str, Any]],
    plan: dict[str, Any] | None = None,
    rate: float = 1.0,
    clock: Any = None,
) -> AsyncIterator[Record]:
    spec = driver_spec(source["driver"])
    bindings = [
        ChannelBinding(
            "bench",
            name,
            spec.channel_model.model_validate({"source": "s", **keys}),
            unit_of(name),
        )
        for name, keys in channels.items()
    ]
    plans = []
    if plan is not None:
        assert spec.plan_model is not None
        plans = [PlanBinding("bench", spec.plan_model.model_validate({"source": "s", **plan}))]
    clock = clock or RunningClock(rate)
    settings = spec.source_model.model_validate({"name": "s", **source})
    driver = spec.create(settings, bindings, plans, clock)
    record = Record(driver, clock)

    async def consume() -> None:
        async with driver:
            async for batch in driver.batches():
                record.batches.append(batch)

    task = asyncio.create_task(consume())
    try:
        yield record
        assert not task.done(), task.exception()
    finally:
        began = time.monotonic()
        while not task.done():
            # `asyncio.wait_for` of Python 3.11, which pymodbus uses, now and then swallows one.
            task.cancel()
            await asyncio.wait({task}, timeout=patience(1.0))
        stopped_after_s = time.monotonic() - began
    record.check()
    assert stopped_after_s < 60.0


class Peer:
    """Another process on the other end of the wire."""

    def __init__(self, script: str, *arguments: str) -> None:
        self._command = [sys.executable, str(PEERS / script), *arguments]
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == "listening"

    def tell(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def pause(self) -> None:
        """Have it send nothing more; what it has sent may still be on its way."""
        self.tell("pause")
        assert self._process is not None
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == "paused"

    def kill(self) -> None:
        """End it the hard way, as by SIGKILL or a power failure."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()
            self._process = None


@pytest.fixture
def drive() -> Callable[..., Any]:
    """Run a driver: ``async with drive(source, channels, plan, rate) as record``."""
    return running_driver


@pytest.fixture
def free_port() -> int:
    return processes.free_port()


@pytest.fixture
def peer() -> Iterator[Callable[..., Peer]]:
    """Make peers that are gone after the test."""
    made: list[Peer] = []

    def make(script: str, *arguments: object) -> Peer:
        made.append(Peer(script, *(str(argument) for argument in arguments)))
        return made[-1]

    yield make
    for one in made:
        one.kill()
