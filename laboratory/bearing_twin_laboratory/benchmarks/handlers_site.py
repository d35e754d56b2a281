"""A cell with a thousand assets and all that makes its answers long, and the longest questions."""

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, get_args

from adapters.samples import Sample
from service.bus import commands as ask
from service.bus.calls import call
from service.bus.memory import MemoryBus
from service.bus.messages import Command
from service.bus.pushed_samples import PushedSamples
from service.bus.replicas import PORTION
from service.cell.acquisition import Acquisition
from service.cell.cell import Cell
from service.cell.cell_clock import CellClock
from service.cell.kernels import Kernels
from service.cell.start import be_prompt
from service.clock import DAY_US, ProcessClock, rfc3339
from service.documents.interfaces import DocumentKind
from service.domain.alarm_condition import AlarmCondition
from service.domain.requests import IdentificationRequest
from service.features.notifications.interface import Notifications
from service.features.silences.tables import Silence, Silences
from service.ingest import Spool
from service.kernels import load_live_kernels
from service.site.settings import load_settings
from service.site.wiring import wire
from service.store import Outbox, Store

ASSETS: Final = 1000
#: Conditions of an asset, and assets of which all are there.
CONDITIONS: Final = 20
ALARMING: Final = 250
#: The most samples of one push, and alarms of one call.
SAMPLES: Final = 20_000
IDS: Final = 500
SILENCES: Final = 200
#: Assets that are measured and have a forecast, and those whose tables change.
SOME: Final = 32
CHANNELS: Final = ("t_inner_ring_c", "t_outer_ring_c", "ambient_c", "speed_rpm", "load_n")
_READINGS: Final = (61.0, 55.0, 22.0, 1500.0, 2650.0)
_PATIENCE_S: Final = 60.0

_HEAD: Final = """
[service]
host = "127.0.0.1"
port = 0
data_dir = "data"

[clock]
rate = 5.0

[[notifications]]
id = "on-call"
kind = "webhook"
url = "http://127.0.0.1:9/"

[[templates]]
name = "axle"
bearing = "6311"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[templates.channels]
{channels}
"""
_ASSET: Final = """
[[assets]]
id = "{asset}"
bearing = "6311"
network = "bearing-14"
low_risk = {{ speed_rpm_max = 4300, load_n_max = 3400 }}
[assets.limits]
t_inner_ring_c = {{ warning = 90, alarm = 105 }}
t_outer_ring_c = {{ warning = 80, alarm = 95 }}
[assets.channels]
{channels}
"""


@contextlib.asynccontextmanager
async def site(assets: int, alarming: int = ALARMING) -> AsyncIterator[Cell]:
    """A cell with running estimates, open alarms, notifications that wait, and silences.

    - ``assets``: machines that it follows.
    - ``alarming``: those of them of which all conditions are there.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = load_settings(_configuration(folder, assets))
        settings.data_dir.mkdir()
        clock = CellClock(ProcessClock(), settings.data_dir)
        store = stack.enter_context(Store.open("", settings.data_dir))
        outbox = stack.enter_context(Outbox.open(settings.data_dir, store))
        spool = Spool.open(settings.data_dir, 64)
        stack.callback(spool.close)
        _silence(store, clock.now_us())
        wiring = wire(settings)
        acquisition = Acquisition(wiring, clock, spool)
        acquisition.ingest.attach(store, {})
        kernels = Kernels(load_live_kernels())
        make = partial(
            Cell, settings, wiring, store, outbox, clock, acquisition, MemoryBus(), kernels
        )
        cell = await asyncio.to_thread(make)
        be_prompt()
        stop = asyncio.Event()
        running = [
            asyncio.create_task(cell.run(stop)),
            asyncio.create_task(acquisition.ingest.run([])),
        ]
        try:
            await _until_forecasts(cell)
            for number, asset in enumerate(cell.core.assets):
                cell.core.alarms.evaluate_all(conditions(asset, active=number < alarming))
                await asyncio.sleep(0)
            await asyncio.to_thread(outbox.flush, _PATIENCE_S)
            await asyncio.sleep(1.0)  # the notifications have seen all
            yield cell
        finally:
            stop.set()
            await asyncio.wait(running[:1])
            running[1].cancel()
            await asyncio.gather(*running, return_exceptions=True)


def largest_commands(cell: Cell) -> dict[str, Callable[[], Command[Any]]]:
    """What makes each command of the cell as large as a caller can."""
    names = list(cell.core.assets)
    first, live, some = names[0], names[:SOME], names[-(IDS // CONDITIONS) :]
    now_us = cell.core.clock.now_us()
    kinds: tuple[DocumentKind, ...] = get_args(DocumentKind)

    def documents(*kinds: DocumentKind) -> Command[Any]:
        wanted = [ask.Wanted(name, kind, b"other") for name in live for kind in kinds]
        return call(ask.Assets.documents, wanted[:PORTION])

    def alarm(**changes: Any) -> Command[Any]:
        raise_alarms(cell, [names[-1]])
        alarm_id = _open_ids(cell, [names[-1]])[0]
        return call(ask.Alarms.act, alarm_id, who="eva", comment="x" * 500, **changes)

    def acknowledge_known() -> Command[Any]:
        raise_alarms(cell, some)
        return call(ask.Alarms.acknowledge, _open_ids(cell, some), "eva", "x" * 500)

    def samples(assets: list[str], begin_us: int) -> PushedSamples:
        each = SAMPLES // len(assets)
        return PushedSamples.of(
            Sample(name, CHANNELS[n % 5], begin_us + n * 1000, 50.0 + n % 7, 192, now_us)
            for name in assets
            for n in range(each)
        )

    rounds = iter(range(1, 1000))

    def push(assets: list[str]) -> Command[Any]:
        begin_us = now_us - DAY_US + next(rounds) * SAMPLES * 1000
        return call(ask.Pushes.take, now_us, 60.0, samples(assets, begin_us), samples(assets, 0))

    def change_assets() -> Command[Any]:
        number = next(rounds)
        table = {"template": "axle", "name": f"Axle {number}"}
        cell.core.store.assets.change({f"axle-{n}": table for n in range(SOME)}, number)
        return call(ask.Assets.apply)

    minutes = [rfc3339(now_us - DAY_US + n * 60_000_000) for n in range(101)]
    windows = [{"start": start, "end": end} for start, end in pairwise(minutes)]
    job = IdentificationRequest.model_validate({"windows": windows})
    return {
        "asset names": partial(call, ask.Assets.names),
        "apply assets": change_assets,
        # A web side that begins asks for all kinds of some assets; later for many of one kind.
        "documents: all kinds": lambda: documents(*kinds),
        **{f"documents: {kind}": partial(documents, kind) for kind in kinds if kind != "forecast"},
        "renew grease": lambda: call(ask.Assets.renew_grease, first, "eva", "x" * 500),
        "stream after": lambda: call(ask.LiveStream.after, cell.core.live.epoch, 0),
        "follow stream": lambda: call(ask.LiveStream.follow, names),
        "take samples": lambda: push([first]),
        "take samples of many": lambda: push(names),
        "list open alarms": partial(call, ask.Alarms.listed),
        "list normal alarms": lambda: call(ask.Alarms.listed, normal=True),
        **{
            f"act on alarm: {action}": partial(alarm, action=action, duration_s=3600.0)
            for action in get_args(ask.AlarmAction)
        },
        "acknowledge unknown alarms": lambda: call(
            ask.Alarms.acknowledge, [f"{n:032x}" for n in range(IDS)], "eva", ""
        ),
        "acknowledge alarms": acknowledge_known,
        "notifications": partial(call, Notifications.states),
        "test notification": lambda: call(Notifications.test, "on-call", "eva"),
        "flush": lambda: call(ask.Alarms.flush, 1.0),
        "create job": lambda: call(ask.Identifications.create, first, job, None, "eva"),
        "jobs": lambda: call(ask.Identifications.jobs, first),
        "job": lambda: call(ask.Identifications.job, first, "none"),
        "cancel job": lambda: call(ask.Identifications.cancel, first, "none"),
        "activate model": lambda: call(
            ask.Identifications.activate, first, 1, "eva", "x" * 500, True
        ),
        "present": lambda: call(
            ask.Presence.present, ask.Present("web", 10**8, b"# HELP\n" * 50_000)
        ),
    }


def conditions(asset: str, *, active: bool) -> list[AlarmCondition]:
    """All conditions of an asset: the first is of a source, and covers the others."""
    channels = [f"channel_{number}" for number in range(1, CONDITIONS)]
    of_source = AlarmCondition(
        asset=asset,
        kind="stale data",
        channel="source:gateway",
        level="",
        active=active,
        value=None,
        message="The source does not answer",
        priority=2,
        covers=tuple(channels),
    )
    return [of_source, *(replace(of_source, channel=one, covers=()) for one in channels)]


def raise_alarms(cell: Cell, assets: Sequence[str]) -> None:
    """Have all alarms of some assets wait for an operator."""
    for asset in assets:
        cell.core.alarms.evaluate_all(conditions(asset, active=False))
        cell.core.alarms.evaluate_all(conditions(asset, active=True))


def _open_ids(cell: Cell, assets: Sequence[str]) -> list[str]:
    return [alarm.id for asset in assets for alarm in cell.core.alarms.active(asset)]


async def _until_forecasts(cell: Cell) -> None:
    """Give some twins good readings until each has a forecast."""
    some = list(cell.core.assets.values())[:SOME]
    async with asyncio.timeout(_PATIENCE_S):
        while any(one.documents.forecast() is None for one in some):
            now_us = cell.core.clock.now_us()
            for runtime in some:
                readings = zip(CHANNELS, _READINGS, strict=True)
                runtime.take(
                    [Sample(runtime.id, name, now_us, one, 192, now_us) for name, one in readings],
                    [],
                )
            await asyncio.sleep(0.1)


def _configuration(folder: Path, assets: int) -> Path:
    channels = "\n".join(f'{name} = {{ source = "push" }}' for name in CHANNELS)
    names = [f"bench-{number:05d}" for number in range(assets)]
    parts = [_HEAD.format(channels=channels)]
    parts += [_ASSET.format(asset=name, channels=channels) for name in names]
    file = folder / "large.toml"
    file.write_text("".join(parts))
    return file


def _silence(store: Store, now_us: int) -> None:
    """Plan as many silences as there may be, none of them now."""
    for number in range(SILENCES):
        store.part(Silences).add(
            Silence(
                id=f"{number:032x}",
                assets=(),
                begins_us=now_us,
                ends_us=now_us + DAY_US,
                who="eva",
                comment="shift",
                days=(),
                begins="00:00",
                ends="00:01",
                time_zone="Europe/Berlin",
            ),
            now_us,
        )
