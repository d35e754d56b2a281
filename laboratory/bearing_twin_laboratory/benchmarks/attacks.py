"""Callers that take all they can get, all at once: how many polls of the devices they cost."""

import asyncio
import contextlib
import json
import math
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import httpx2

from adapters.samples import Sample
from adapters.virtual_bench.announcements import FleetAnnouncement
from bearing_twin_laboratory.benchmarks.attackers import (
    ASSET_NAME,
    OPCUA_PORT,
    PUSHED,
    PUSHED_ASSET,
    attack_names,
    begin_attack,
)
from bearing_twin_laboratory.benchmarks.common import BenchmarkError, Measurement, Progress
from bearing_twin_laboratory.benchmarks.fleet import (
    answers_of,
    forecast_ages,
    memory_bytes_of,
    until_forecasts,
)
from service.demo.fleet_configuration import fleet_assets, write_fleet_configuration
from service.demo.processes import running
from service.domain.roles import Role
from service.security.keys import create_key
from service.site.settings import load_settings
from service.store import Store

BENCHES = 20
_ROLES: tuple[Role, ...] = ("viewer", "operator", "gateway", "admin")
#: For those who read much: some hours of many channels.
_ROWS_PER_CHANNEL = 30_000
_PATIENCE_S = 300.0
_LOOK_EVERY_S = 1.0

_MORE = """
[opcua]
enabled = true
endpoint = "opc.tcp://127.0.0.1:{opcua_port}/"

[[assets]]
id = "{asset}"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.channels]
{channels}
"""


def attacks(progress: Progress, *, benches: int = BENCHES, duration_s: float = 60.0) -> Measurement:
    """Share of the polls that are skipped while all attackers are at work."""
    return asyncio.run(_attacked(progress, benches, duration_s))


async def _attacked(progress: Progress, benches: int, duration_s: float) -> Measurement:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = ("virtual-fleet", "--benches", str(benches), "--modbus-port", "0", "--json")
        async with running("benches", bench, folder / "benches.log") as running_benches:
            facts: FleetAnnouncement = json.loads(running_benches.first_line)
            file = write_fleet_configuration(folder / "attacked.toml", facts)
            opcua_port = _free_port()
            channels = "\n".join(f'{name} = {{ source = "push" }}' for name in PUSHED)
            with file.open("a") as configuration:
                configuration.write(
                    _MORE.format(opcua_port=opcua_port, asset=PUSHED_ASSET, channels=channels)
                )
            keys = await asyncio.to_thread(_prepare, file)
            log = folder / "service.log"
            async with running("service", ("serve", "-c", str(file)), log) as service:
                port = int(service.first_line.rstrip("/").rpartition(":")[2])
                client = httpx2.AsyncClient(
                    base_url=f"http://127.0.0.1:{port}",
                    headers={"X-API-Key": keys["viewer"]},
                    timeout=_PATIENCE_S,
                    # Not from the address that an attacker fills with connections.
                    transport=httpx2.AsyncHTTPTransport(local_address="127.0.0.2"),
                )
                async with client:
                    progress(0.1, "the service starts")
                    await until_forecasts(client, benches)
                    progress(0.3, "without attacks")
                    without, _, before = await _watch(client, facts, service.pid, duration_s)
                    progress(0.6, "all attacks at once")
                    # They do not begin at the same moment, and are ended at the end.
                    seconds = duration_s + _PATIENCE_S
                    there = {OPCUA_PORT: str(opcua_port), ASSET_NAME: fleet_assets(1)[0]}
                    with contextlib.ExitStack() as stack:
                        attackers = [
                            stack.enter_context(
                                begin_attack(attack, port, keys[role], seconds, there)
                            )
                            for attack, role in attack_names().items()
                        ]
                        for one in attackers:
                            stack.callback(one.kill)
                        await asyncio.gather(*(_until_attacking(one) for one in attackers))
                        under, oldest_s, after = await _watch(
                            client, facts, service.pid, duration_s
                        )
                        if any(one.poll() is not None for one in attackers):
                            raise BenchmarkError("an attacker has ended early")
    return Measurement(
        under,
        "",
        without,
        "the same service without them",
        {
            "attackers": len(attackers),
            "benches": benches,
            "duration_s": duration_s,
            "forecast_age_s": oldest_s,
            "memory_bytes": after,
            "memory_bytes_without": before,
        },
    )


async def _until_attacking(attacker: "subprocess.Popen[str]") -> None:
    output = attacker.stdout
    line = "" if output is None else await asyncio.to_thread(output.readline)
    if line != "attacking\n":
        raise BenchmarkError(f"an attacker did not begin: {line!r}")


async def _watch(
    client: httpx2.AsyncClient, facts: FleetAnnouncement, pid: int, duration_s: float
) -> tuple[float, float, int]:
    """Share of the polls that were skipped, oldest forecast in s, greatest memory in bytes."""
    began_s = time.monotonic()
    before = await answers_of(facts["modbus"])
    # The units are asked one after the other, at the end in the same order and as quickly: each
    # has the same time, but for what the asking takes longer then.
    asked_s = time.monotonic() - began_s
    oldest_s, most_bytes = math.nan, 0
    while (left_s := began_s + duration_s - time.monotonic()) > 0:
        await asyncio.sleep(min(left_s, _LOOK_EVERY_S))
        # Without the answer of a busy service the next look finds the age greater.
        with contextlib.suppress(httpx2.TransportError):
            oldest_s = max(
                (age_s for age_s in (oldest_s, *await forecast_ages(client)) if age_s >= 0.0),
                default=math.nan,
            )
        with contextlib.suppress(OSError):
            most_bytes = max(most_bytes, memory_bytes_of(pid))
    if math.isnan(oldest_s):
        raise BenchmarkError("the service never reported how old its forecasts are")
    passed_s = time.monotonic() - began_s
    after = await answers_of(facts["modbus"])
    # What the last question took longer is time in which polls were due, too.
    passed_s += max(time.monotonic() - began_s - passed_s - asked_s, 0.0)
    polls = sum(after) - sum(before)
    return max(1.0 - polls / (facts["benches"] * passed_s), 0.0), oldest_s, most_bytes


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
    return port


def _prepare(configuration: Path) -> dict[Role, str]:
    """Put much into the store, and make a key of each role."""
    settings = load_settings(configuration)
    now_us = time.time_ns() // 1000
    with Store.open(settings.service.database_url, settings.data_dir) as store:
        for name in PUSHED:
            store.samples.write(
                [
                    Sample(PUSHED_ASSET, name, now_us - 40_000 * number, 60.0, 192, now_us)
                    for number in range(1, _ROWS_PER_CHANNEL)
                ]
            )
        return {role: create_key(store, role).text for role in _ROLES}
