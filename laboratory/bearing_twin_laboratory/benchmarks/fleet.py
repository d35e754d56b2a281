"""What an asset costs: a service that reads ever more virtual benches through one gateway."""

import asyncio
import json
import math
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from pymodbus.client import AsyncModbusTcpClient

from adapters.virtual_bench.announcements import GatewayAddress
from adapters.virtual_bench.fleet_server import COUNTER_ADDRESS, UNITS
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from service.demo.fleet_configuration import CHANNELS, fleet_assets, write_fleet_configuration
from service.demo.processes import running
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

SIZES = (10, 50, 200)
_PATIENCE_S = 600.0
# Until the machines run at their first operating points and have a forecast there.
_SETTLE_S = 120.0
_LOOK_EVERY_S = 10.0
_MOST_SAMPLES = 10_000_000
_FORECAST_AGE = "bearing_twin_forecast_age_seconds{"


@dataclass(frozen=True, slots=True)
class _Cost:
    """What a service of some assets took over some wall seconds.

    - ``assets``: number of assets.
    - ``processor_s``: processor seconds a second of all its processes.
    - ``cell_s``: those of the cell alone.
    - ``memory_bytes``: proportional set size of all its processes.
    - ``forecast_age_s``: greatest age of a forecast that was seen.
    - ``polled``: samples taken, as a share of those that were due.
    - ``sent``, ``lost``, ``doubled``: samples that the benches sent, and of those the ones that the
      store lacks or has twice.
    """

    assets: int
    processor_s: float
    cell_s: float
    memory_bytes: int
    forecast_age_s: float
    polled: float
    sent: int
    lost: int
    doubled: int


def assets_cpu(
    progress: Progress,
    *,
    sizes: Sequence[int] = SIZES,
    duration_s: float = 120.0,
    settle_s: float = _SETTLE_S,
) -> Measurement:
    """Processor time and memory per asset, at growing numbers of assets."""
    costs = []
    for number, size in enumerate(sizes):
        progress(number / len(sizes), f"{size} assets")
        costs.append(asyncio.run(_cost(size, duration_s, settle_s)))
    first, last = costs[0], costs[-1]
    assets = np.array([cost.assets for cost in costs], np.float64)
    spent = np.array([cost.processor_s for cost in costs])
    held = np.array([cost.memory_bytes for cost in costs], np.float64)
    more = max(last.assets - first.assets, 1)
    return Measurement(
        last.processor_s / last.assets,
        "s/s",
        first.processor_s / first.assets,
        f"the same of {first.assets} assets",
        {
            "assets": last.assets,
            "duration_s": duration_s,
            "cell_share": last.cell_s / last.processor_s,
            "more_s_per_asset": (last.processor_s - first.processor_s) / more,
            "memory_bytes_per_asset": (last.memory_bytes - first.memory_bytes) / more,
            "slope_cpu": _slope(assets, spent),
            "slope_memory": _slope(assets, held),
            "forecast_age_s": last.forecast_age_s,
            "polled_share": last.polled,
            "lost": sum(cost.lost for cost in costs),
            "doubled": sum(cost.doubled for cost in costs),
            "by_size": {
                str(cost.assets): {
                    "s_per_asset": cost.processor_s / cost.assets,
                    "memory_bytes": cost.memory_bytes,
                    "forecast_age_s": cost.forecast_age_s,
                    "polled_share": cost.polled,
                    "sent": cost.sent,
                    "lost": cost.lost,
                }
                for cost in costs
            },
        },
    )


def _slope(assets: Any, values: Any) -> float | None:
    """Exponent of a growth: 1 where twice the assets cost twice as much."""
    if len(assets) < 2:
        return None
    return float(np.polyfit(np.log(assets), np.log(values), 1)[0])


async def _cost(assets: int, duration_s: float, settle_s: float) -> _Cost:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = ("virtual-fleet", "--benches", str(assets), "--modbus-port", "0", "--json")
        async with running("benches", bench, folder / "benches.log") as benches:
            facts = json.loads(benches.first_line)
            file = write_fleet_configuration(folder / "fleet.toml", facts)
            settings = load_settings(file)
            with Store.open(settings.service.database_url, settings.data_dir) as store:
                key = create_key(store, "admin").text
            async with running(
                "service", ("serve", "-c", str(file)), folder / "service.log"
            ) as service:
                port = int(service.first_line.rstrip("/").rpartition(":")[2])
                client = httpx2.AsyncClient(
                    base_url=f"http://127.0.0.1:{port}",
                    headers={"X-API-Key": key},
                    timeout=_PATIENCE_S,
                )
                async with client:
                    await until_forecasts(client, assets)
                    await asyncio.sleep(settle_s)
                    before, cell_before = processor_s_of(service.pid)
                    polls = await answers_of(facts["modbus"])
                    began = time.monotonic()
                    oldest_s = 0.0
                    while (left_s := began + duration_s - time.monotonic()) > 0:
                        await asyncio.sleep(min(left_s, _LOOK_EVERY_S))
                        oldest_s = max(oldest_s, *await forecast_ages(client))
                    passed_s = time.monotonic() - began
                    after, cell_after = processor_s_of(service.pid)
                    polled = sum(await answers_of(facts["modbus"])) - sum(polls)
                    memory_bytes = memory_bytes_of(service.pid)
            answers = await answers_of(facts["modbus"])
        with Store.open(settings.service.database_url, settings.data_dir) as store:
            stored = store.samples.counts(_MOST_SAMPLES)
    lost, doubled = _compared(answers, stored)
    return _Cost(
        assets=assets,
        processor_s=(after - before) / passed_s,
        cell_s=(cell_after - cell_before) / passed_s,
        memory_bytes=memory_bytes,
        forecast_age_s=oldest_s,
        polled=polled / (assets * passed_s),
        sent=sum(answers) * len(CHANNELS),
        lost=lost,
        doubled=doubled,
    )


def _compared(answers: Sequence[int], stored: Mapping[tuple[str, str], int]) -> tuple[int, int]:
    """Samples lost and doubled; the last answer of a unit may have come while the service ended."""
    lost = doubled = 0
    for asset, sent in zip(fleet_assets(len(answers)), answers, strict=True):
        for channel in CHANNELS:
            kept = stored.get((asset, channel), 0)
            lost += max(sent - 1 - kept, 0)
            doubled += max(kept - sent, 0)
    return lost, doubled


async def until_forecasts(client: httpx2.AsyncClient, assets: int) -> None:
    """Wait until so many twins have a forecast."""
    deadline = time.monotonic() + _PATIENCE_S
    known = 0
    while time.monotonic() < deadline:
        known = len(await forecast_ages(client))
        if known == assets:
            return
        await asyncio.sleep(1.0)
    raise BenchmarkError(f"{known} of {assets} twins have a forecast after {_PATIENCE_S:g} s")


async def forecast_ages(client: httpx2.AsyncClient) -> list[float]:
    """How old the forecasts are, in process seconds."""
    answer = await client.get("/metrics")
    ages = [
        float(line.rpartition(" ")[2])
        for line in answer.text.splitlines()
        if line.startswith(_FORECAST_AGE)
    ]
    return [age for age in ages if not math.isnan(age)]


async def answers_of(gateways: Sequence[GatewayAddress]) -> list[int]:
    """How many polls each bench has answered, as it says itself."""
    counts = []
    for gateway in gateways:
        client = AsyncModbusTcpClient(gateway["host"], port=gateway["port"], timeout=_PATIENCE_S)
        try:
            if not await client.connect():
                raise BenchmarkError("the benchmark's own benches do not answer")
            for unit in range(1, min(gateway["units"], UNITS) + 1):
                answer = await client.read_input_registers(COUNTER_ADDRESS, count=2, device_id=unit)
                high, low = answer.registers
                counts.append(high << 16 | low)
        finally:
            client.close()
    return counts


def processes_of(pid: int) -> dict[int, str]:
    """A process and all that descend from it, with their names."""
    children: dict[int, list[int]] = {}
    names = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = status.read_text().partition("(")[2].rpartition(")")
        except OSError:
            continue  # it has just ended
        child = int(status.parent.name)
        names[child] = name
        children.setdefault(int(rest.split()[1]), []).append(child)
    found, waiting = {}, [pid]
    while waiting:
        one = waiting.pop()
        found[one] = names.get(one, "")
        waiting += children.get(one, [])
    return found


def processor_s_of(pid: int) -> tuple[float, float]:
    """Processor seconds that all processes of a service have used, and its cell alone."""
    ticks = os.sysconf("SC_CLK_TCK")
    spent = {}
    for one, name in processes_of(pid).items():
        user, system = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()[11:13]
        spent[one, name] = (int(user) + int(system)) / ticks
    return sum(spent.values()), sum(s for (_, name), s in spent.items() if name == "twin-cell")


def memory_bytes_of(pid: int) -> int:
    """Memory of all processes of a service; what several share is counted once."""
    total = 0
    for one in processes_of(pid):
        lines = Path(f"/proc/{one}/smaps_rollup").read_text().splitlines()
        total += next(1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total
