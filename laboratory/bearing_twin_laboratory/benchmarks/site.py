"""A whole site for benchmarks of the web side: virtual bench, service, data to identify from."""

import asyncio
import contextlib
import json
import os
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx2

from adapters.samples import Quality, Sample
from bearing_twin_laboratory.benchmarks.common import BenchmarkError
from bearing_twin_laboratory.benchmarks.identification import bench_run
from service.clock import rfc3339
from service.demo.configuration import ASSET, write_configuration
from service.demo.processes import running
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

_MINUTE_US = 60_000_000
_PATIENCE_S = 60.0


class Site:
    """A running service that polls a virtual bench, in processes of their own.

    - ``port``: port of the service.
    - ``key``: a key of role admin.
    - ``pid``: process of the service.
    - ``window``: span of stored data that can be identified from, RFC 3339.
    """

    def __init__(self, port: int, key: str, pid: int, window: tuple[str, str]) -> None:
        self.port, self.key = port, key
        self.headers = {"X-API-Key": key}
        self._window = {"start": window[0], "end": window[1]}
        self._proc = Path(f"/proc/{pid}")
        self._client = httpx2.AsyncClient(
            base_url=f"http://127.0.0.1:{port}/api/v1/assets/{ASSET}",
            headers=self.headers,
            timeout=_PATIENCE_S,
        )

    @property
    def snapshot_path(self) -> str:
        """Path of the snapshot."""
        return f"/api/v1/assets/{ASSET}/snapshot"

    @property
    def forecasts_path(self) -> str:
        """Path of what-if forecasts."""
        return f"/api/v1/assets/{ASSET}/forecasts"

    def memory_mib(self) -> float:
        """Resident memory of the service, without its workers."""
        resident_pages = int((self._proc / "statm").read_text().split()[1])
        return resident_pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def cpu_s(self) -> float:
        """Processor time that the service has used, without its workers."""
        user, system = (self._proc / "stat").read_text().rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    async def close(self) -> None:
        """Close the connection to the service."""
        await self._client.aclose()

    async def until_forecast(self) -> None:
        """Wait until the twin follows the bench and has made its first forecast."""
        await self._until(lambda: self._client.get("/forecast"))

    @contextlib.asynccontextmanager
    async def identifying(self) -> AsyncIterator[None]:
        """Keep an identification job busy for the length of the context."""
        given = {"windows": [self._window], "method": "noa", "budget": 5_000_000}

        async def another() -> httpx2.Response:
            await self._cancel_jobs()
            return await self._client.post("/identifications", json=given)

        await self._until(another)
        await self._until(self._job_that_runs)
        try:
            yield
            if await self._job_that_runs() is None:
                raise BenchmarkError("the identification job ended before the measurement")
        finally:
            await self._cancel_jobs()

    async def _job_that_runs(self) -> httpx2.Response | None:
        answer = await self._client.get("/identifications")
        jobs = answer.json()["items"]
        return answer if any(job["status"] == "running" for job in jobs) else None

    async def _cancel_jobs(self) -> None:
        jobs = (await self._client.get("/identifications")).json()["items"]
        for job in jobs:
            if job["status"] in ("queued", "running"):
                await self._client.delete(f"/identifications/{job['id']}")

    async def _until(self, ask: Any) -> None:
        deadline = time.monotonic() + _PATIENCE_S
        said = "nothing"
        while time.monotonic() < deadline:
            answer = await ask()
            if answer is not None and answer.is_success:
                return
            said = "nothing" if answer is None else answer.text
            await asyncio.sleep(0.5)
        raise BenchmarkError(f"the benchmark's service is not ready, it says {said}")


@contextlib.asynccontextmanager
async def site() -> AsyncIterator[Site]:
    """Run a virtual bench and a service at real time, with some hours of stored history."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench_log, log = folder / "bench.log", folder / "service.log"
        ports = ("--modbus-port", "0", "--can-port", "0", "--json")
        async with running("bench", ("virtual-bench", *ports), bench_log) as bench:
            file = write_configuration(folder, [json.loads(bench.first_line)], 1.0, 0)
            key, window = await asyncio.to_thread(_prepare, file)
            async with running("service", ("serve", "-c", str(file)), log) as service:
                port = int(service.first_line.rstrip("/").rpartition(":")[2])
                found = Site(port, key, service.pid, window)
                try:
                    await found.until_forecast()
                    yield found
                finally:
                    await found.close()


def _prepare(configuration: Path) -> tuple[str, tuple[str, str]]:
    """Put a bench's run of some hours into the store, ending an hour ago, and make a key."""
    settings = load_settings(configuration)
    run = bench_run()
    minutes = run.minutes
    end_us = (time.time_ns() // 1000 // _MINUTE_US - 60) * _MINUTE_US
    start_us = end_us - minutes.time_s.size * _MINUTE_US
    rows = {
        "speed_rpm": minutes.speed_rpm,
        "load_n": minutes.load_n,
        "ambient_c": minutes.ambient_c,
        "t_inner_ring_c": minutes.temperatures_c["t_inner_ring_c"],
        "t_outer_ring_c": minutes.temperatures_c["t_outer_ring_c"],
    }
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        store.samples.write(
            [
                Sample(ASSET, channel, time_us, float(value), Quality.GOOD, time_us)
                for channel, values in rows.items()
                for row, value in enumerate(values)
                # Twice a minute: in the middle of the minute, and of the one around its beginning.
                for time_us in (
                    start_us + row * _MINUTE_US,
                    start_us + row * _MINUTE_US + _MINUTE_US // 2,
                )
            ]
        )
        return create_key(store, "admin").text, (rfc3339(start_us), rfc3339(end_us))
