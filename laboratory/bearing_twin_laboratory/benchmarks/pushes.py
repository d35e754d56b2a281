"""A gateway that speaks for many assets: how many samples a second the service stores."""

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx2
from pydantic_core import to_json

from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.fleet import processor_s_of, until_forecasts
from service.clock import rfc3339
from service.demo.fleet_configuration import CHANNELS, fleet_assets
from service.demo.processes import running
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

ASSETS = 500
#: Samples in one call, and calls at once.
CALL_SAMPLES, AT_ONCE = 1000, 4
#: Wall seconds between two samples of a channel in the reference: the period of the twins.
SELDOM_S = 5.0
#: Until ensembles of the first minute, while the twins still moved, need not be made again.
SETTLE_S = 120.0
_MOST_SAMPLES = 100_000_000
_PATIENCE_S = 120.0
_FORECASTS_S = 600.0
_SECOND_US = 1_000_000

_HEAD = """
[service]
host = "127.0.0.1"
port = 0
data_dir = "data"
"""
_ASSET = """
[[assets]]
id = "{asset}"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
{channels}
"""
_VALUES = dict(zip(CHANNELS, (45.0, 40.0, 22.0, 1500.0, 2650.0), strict=True))


@dataclass
class _Gateway:
    """Pushes samples, and counts what was acknowledged."""

    client: httpx2.AsyncClient
    assets: list[str]
    time_us: int
    acknowledged: int = 0
    seconds: list[float] = field(default_factory=list)

    def rows(self, assets: list[str]) -> list[dict[str, object]]:
        """One sample of each channel of some assets, at a time of their own."""
        self.time_us += 1000
        at = rfc3339(self.time_us)
        return [
            {"asset": asset, "channel": channel, "time": at, "value": value}
            for asset in assets
            for channel, value in _VALUES.items()
        ]

    async def push(self, path: str, rows: list[dict[str, object]]) -> None:
        """Push once; raises `BenchmarkError` where not all is new and stored."""
        began_s = time.perf_counter()
        answer = await self.client.post(path, content=to_json({"samples": rows}))
        self.seconds.append(time.perf_counter() - began_s)
        if answer.status_code != 200 or answer.json()["accepted"] != len(rows):
            raise BenchmarkError(f"a push was answered {answer.status_code}: {answer.text[:200]}")
        self.acknowledged += len(rows)

    async def flood(self, push: Callable[[], "asyncio.Future[None]"], duration_s: float) -> float:
        """Push as fast as the answers come, some at once; gives samples a second."""
        before, began_s = self.acknowledged, time.perf_counter()

        async def one_after_the_other() -> None:
            while time.perf_counter() - began_s < duration_s:
                await push()

        await asyncio.gather(*(one_after_the_other() for _ in range(AT_ONCE)))
        return (self.acknowledged - before) / (time.perf_counter() - began_s)


@dataclass(frozen=True, slots=True)
class _Paced:
    """What it takes to push each channel of all assets once in a period."""

    share: float
    p99_s: float


def pushes(
    progress: Progress,
    *,
    assets: int = ASSETS,
    duration_s: float = 30.0,
    settle_s: float = SETTLE_S,
) -> Measurement:
    """Pushed samples a second that are accepted and stored, in calls of `CALL_SAMPLES`."""
    return asyncio.run(_measured(progress, assets, duration_s, settle_s))


async def _measured(
    progress: Progress, assets: int, duration_s: float, settle_s: float
) -> Measurement:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "pushed.toml"
        names = fleet_assets(assets)
        channels = "\n".join(f'{channel} = {{ source = "push" }}' for channel in CHANNELS)
        tables = (_ASSET.format(asset=asset, channels=channels) for asset in names)
        file.write_text("".join([_HEAD, *tables]))
        settings = load_settings(file)
        with Store.open(settings.service.database_url, settings.data_dir) as store:
            key = create_key(store, "gateway").text
        async with _service(file, folder / "service.log", key) as (client, pid):
            gateway = _Gateway(client, names, time.time_ns() // 1000)
            progress(0.05, "the service starts")
            await _until_all_are_followed(gateway)
            progress(0.1, f"the forecasts of {assets} assets begin")
            begins = await _until_forecasts(gateway, pid)
            await _each(gateway, pid, 1.0, settle_s)
            progress(0.4, f"{assets} assets, each channel every {SELDOM_S:g} s")
            before = await _each(gateway, pid, SELDOM_S, duration_s)
            progress(0.5, f"{assets} assets, each channel every second")
            often = await _each(gateway, pid, 1.0, duration_s)
            progress(0.6, f"{assets} assets, each channel every {SELDOM_S:g} s")
            after = await _each(gateway, pid, SELDOM_S, duration_s)
            progress(0.7, f"{CALL_SAMPLES} samples a call, as fast as they are taken")
            some = names[: CALL_SAMPLES // len(CHANNELS)]
            before_s, _ = processor_s_of(pid)
            acknowledged = gateway.acknowledged
            gateway.seconds.clear()
            a_second = await gateway.flood(
                lambda: asyncio.ensure_future(gateway.push("/measurements", gateway.rows(some))),
                duration_s,
            )
            cost_s = (processor_s_of(pid)[0] - before_s) / (gateway.acknowledged - acknowledged)
            flood_p99_s = _p99(gateway.seconds)
            progress(0.9, "one asset a call")
            path = f"/assets/{names[0]}/measurements"

            def of_one() -> "asyncio.Future[None]":
                rows = gateway.rows(names[:1])
                for row in rows:
                    del row["asset"]
                return asyncio.ensure_future(gateway.push(path, rows))

            singly = await gateway.flood(of_one, duration_s / 3)
        with Store.open(settings.service.database_url, settings.data_dir) as store:
            kept = store.samples.counts(_MOST_SAMPLES)
    stored = sum(number for (_, channel), number in kept.items() if channel in _VALUES)
    # The twins do the same with a sample every five seconds, which is how often they are stepped.
    seldom = (before.share + after.share) / 2
    of_pushes = (often.share - seldom) * SELDOM_S / (SELDOM_S - 1.0)
    return Measurement(
        a_second,
        "1/s",
        singly,
        "pushes of one asset, five samples each",
        {
            "assets": assets,
            "duration_s": duration_s,
            "p99_s": often.p99_s,
            "flood_p99_s": flood_p99_s,
            "begin_p99_s": begins.p99_s,
            "processor_s_per_sample": cost_s,
            f"cpu_share_{assets}_assets": often.share,
            "cpu_share_of_pushes": of_pushes,
            "cpu_share_without_pushes": often.share - of_pushes,
            "cpu_share_while_forecasts_begin": begins.share,
            "acknowledged": gateway.acknowledged,
            "stored": stored,
        },
    )


async def _until_forecasts(gateway: _Gateway, pid: int) -> _Paced:
    """Push each channel once a second until all twins have a forecast."""
    url, headers = gateway.client.base_url, gateway.client.headers
    async with httpx2.AsyncClient(
        base_url=f"http://{url.host}:{url.port}", headers=headers
    ) as root:
        waiting = asyncio.create_task(until_forecasts(root, len(gateway.assets)))
        paced = await _each(gateway, pid, 1.0, _FORECASTS_S, waiting.done)
        await waiting
    return paced


async def _each(
    gateway: _Gateway,
    pid: int,
    period_s: float,
    duration_s: float,
    ended: Callable[[], bool] = lambda: False,
) -> _Paced:
    """Push each channel of all assets once in a period, the calls spread over it."""
    size = CALL_SAMPLES // len(CHANNELS)
    groups = [gateway.assets[at : at + size] for at in range(0, len(gateway.assets), size)]
    rounds = max(round(duration_s / period_s), 1)
    gateway.seconds.clear()
    before_s, began_s = processor_s_of(pid)[0], time.perf_counter()
    number = 0
    while number < rounds and not ended():
        for place, group in enumerate(groups):
            due_s = began_s + period_s * (number + place / len(groups))
            await asyncio.sleep(max(due_s - time.perf_counter(), 0.0))
            gateway.time_us = max(gateway.time_us, time.time_ns() // 1000)
            await gateway.push("/measurements", gateway.rows(group))
        number += 1
    await asyncio.sleep(max(began_s + period_s * number - time.perf_counter(), 0.0))
    passed_s = time.perf_counter() - began_s
    return _Paced((processor_s_of(pid)[0] - before_s) / passed_s, _p99(gateway.seconds))


def _p99(seconds: list[float]) -> float:
    """Give what one call in a hundred is longer than."""
    return sorted(seconds)[-1 - len(seconds) // 100]


@asynccontextmanager
async def _service(
    file: Path, log: Path, key: str
) -> AsyncIterator[tuple[httpx2.AsyncClient, int]]:
    async with running("service", ("serve", "-c", str(file)), log) as service:
        address = service.first_line.rstrip("/").rpartition(":")[2]
        headers = {"X-API-Key": key, "Content-Type": "application/json"}
        async with httpx2.AsyncClient(
            base_url=f"http://127.0.0.1:{address}/api/v1", headers=headers, timeout=_PATIENCE_S
        ) as client:
            yield client, service.pid


async def _until_all_are_followed(gateway: _Gateway) -> None:
    deadline_s = time.monotonic() + _PATIENCE_S
    size = CALL_SAMPLES // len(CHANNELS)
    for at in range(0, len(gateway.assets), size):
        while True:
            rows = gateway.rows(gateway.assets[at : at + size])
            answer = await gateway.client.post("/measurements", content=to_json({"samples": rows}))
            accepted = answer.json()["accepted"] if answer.status_code == 200 else 0
            gateway.acknowledged += accepted
            if accepted == len(rows):
                break
            if time.monotonic() > deadline_s:
                raise BenchmarkError(f"not all assets are followed: {answer.text[:200]}")
            await asyncio.sleep(0.5)
