"""Starts the plant side: the tags for OPC UA and Modbus clients and an MQTT broker."""

import asyncio
import contextlib
import gc
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Final

from prometheus_client import CollectorRegistry

from service.bus.alarm_lists import alarms_of
from service.bus.calls import call
from service.bus.commands import Alarms
from service.bus.directory import Directory
from service.bus.fleet_cells import Fleet
from service.bus.fleet_connection import fleet_of
from service.bus.fleet_following import FleetFollowing
from service.bus.following import Following
from service.bus.interface import AWAY_AFTER_S, ReaderBus
from service.bus.local import LocalReaderBus
from service.bus.presence import report_presence
from service.bus.replicas import Replicas
from service.bus.stream import LiveMessages
from service.clock import ProcessClock
from service.documents.alarms import alarm_document
from service.domain.errors import CellUnavailableError
from service.plant.protocol import Host, TagValue
from service.plant.publishers import check_extras, check_ports
from service.plant.rounds import PublisherRounds, make_publishers
from service.security.audit_trail import AuditTrail
from service.security.authenticator import Authenticator
from service.site.settings import Settings
from service.store import Outbox, Store
from service.tasks import background
from service.waiting import LEAVE_S, StoppedError, Waiting

OUTBOX_FILE: Final = "outbox-plant.db"
#: Copies of the tags are at most so old: below the shortest period of a publisher.
REFRESH_S: Final = 0.25
#: Wall seconds for the list of the open alarms.
ALARMS_S: Final = 5.0
_LOOK_EVERY_S: Final = 0.1
_CLOSE_S: Final = 1.0


async def run_plant(settings: Settings, *, stop: asyncio.Event, ready: Callable[[], None]) -> None:
    """Run the plant side of a configuration until ``stop`` is set.

    It waits for the cell, and goes on when the cell ends and comes back: the tags then say by their
    quality that they are old. Raises `SettingsError` if what is enabled cannot be used; names the
    key. Raises `TemporaryError` if a port did not become free in time.
    """
    check_extras(settings)
    with contextlib.suppress(StoppedError):
        await _run(settings, stop, ready)


async def _run(settings: Settings, stop: asyncio.Event, ready: Callable[[], None]) -> None:
    waiting = Waiting(stop, lambda what, why: None)
    await waiting.until("the ports of the publishers", partial(check_ports, settings), LEAVE_S)
    async with contextlib.AsyncExitStack() as stack:
        url, data_dir = settings.service.database_url, settings.data_dir
        open_store = partial(Store.open, url, data_dir)
        reader: LocalReaderBus | Fleet
        if settings.is_fleet:
            store = await waiting.until("the store", open_store)
            stack.callback(store.close)
            directory = Directory(settings, store)
            await waiting.until("the store", directory.look)
            await stack.enter_async_context(background(directory.follow(), "directory", stop))
            reader = fleet_of(settings, store, directory, "plant")
        else:
            reader = LocalReaderBus(settings.data_dir)
            stack.callback(reader.close)
        await stack.enter_async_context(background(reader.run(), "bus", stop))
        replicas = Replicas(reader)
        while not await _is_known(reader, replicas):
            await _pause(stop)
        if not settings.is_fleet:
            store = await waiting.until("the store", open_store)
            stack.callback(store.close)
        outbox = await waiting.until(
            "room on the disk", partial(Outbox.open, data_dir, store, OUTBOX_FILE)
        )
        stack.callback(outbox.close, _CLOSE_S)
        clock = ProcessClock.resume(settings.clock.rate, data_dir)
        bus = LiveMessages(clock)
        security = settings.security
        authenticator = Authenticator(
            store, security.failed_logins_per_minute, security.requests_per_minute
        )
        trail = AuditTrail(outbox)
        stack.callback(trail.settle)
        registry = CollectorRegistry()
        following = (
            FleetFollowing(reader, bus, clock)
            if isinstance(reader, Fleet)
            else Following(reader, bus)
        )
        publishers: list[PublisherRounds] = []

        def state_of_publishers() -> dict[str, str]:
            return {one.name: one.problem or "" for one in publishers}

        for name, work in (
            ("live messages", following.run()),
            ("tags", _refresh(replicas)),
            ("assets", replicas.follow()),
            ("presence", report_presence(reader, "plant", registry, state_of_publishers)),
        ):
            await stack.enter_async_context(background(work, name, stop))
        while not following.caught_up.is_set():
            await _pause(stop)
        host = Host(
            authenticator,
            trail,
            data_dir,
            tags_of=partial(_tags_of, replicas),
            channels_of=partial(_channels_of, replicas),
            history=store.channel_history,
            now_us=clock.now_us,
            open_alarms=partial(_open_alarms, reader),
            is_known=partial(_is_of_site, reader, replicas),
        )
        publishers += make_publishers(settings, replicas.assets, bus, host, registry)
        for one in publishers:
            await stack.enter_async_context(background(one.run(), one.name, stop))
        await stack.enter_async_context(background(_be_prompt(publishers), "prompt", stop))
        ready()
        await stop.wait()
        bus.close("the service stops")


async def _open_alarms(reader: ReaderBus) -> Sequence[Mapping[str, object]] | None:
    try:
        alarms = await alarms_of(lambda part: reader.ask(part, ALARMS_S), call(Alarms.listed))
    except CellUnavailableError:
        return None
    return [alarm_document(alarm).model_dump(mode="json") for alarm in alarms]


async def _is_known(reader: ReaderBus, replicas: Replicas) -> bool:
    if not reader.state.ready or reader.away_s > AWAY_AFTER_S:
        return False
    try:
        await replicas.load()
    except CellUnavailableError:
        return False
    return True


def _is_of_site(reader: ReaderBus, replicas: Replicas, asset: str) -> bool:
    """Whether there is such an asset, also one that no cell has answered about yet."""
    return asset in replicas.names or (isinstance(reader, Fleet) and reader.is_known(asset))


def _tags_of(replicas: Replicas, asset: str) -> Mapping[str, TagValue] | None:
    replica = replicas.assets.get(asset)
    return (
        replica.snapshot()["tags"] if replica is not None and replica.is_known("snapshot") else None
    )


def _channels_of(replicas: Replicas, asset: str) -> Collection[str]:
    replica = replicas.assets.get(asset)
    return replica.channels if replica is not None and replica.is_known("facts") else ()


async def _refresh(replicas: Replicas) -> None:
    while True:
        await replicas.refresh_known("snapshot")
        await asyncio.sleep(REFRESH_S)


async def _be_prompt(publishers: Sequence[PublisherRounds]) -> None:
    """Keep what the publishers have built out of every later collection of garbage.

    The address space of OPC UA is some 100,000 objects before the first asset: to look through
    them takes a quarter of a second, in which no client is answered.
    """
    for one in publishers:
        await one.begun.wait()
    gc.collect()
    gc.freeze()
    await asyncio.Event().wait()


async def _pause(stop: asyncio.Event) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_LOOK_EVERY_S):
            await stop.wait()
    if stop.is_set():
        raise StoppedError
