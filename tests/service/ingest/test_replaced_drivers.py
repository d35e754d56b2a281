"""A driver is replaced while the service runs."""

import asyncio

import pytest
from patience import wait_for

from adapters.samples import Batch

from .conftest import Hall, ScriptedSource, sample

PATIENCE_S = 30.0


async def test_a_driver_reads_until_the_one_that_replaces_it_has_read(hall: Hall) -> None:
    old, new, other = ScriptedSource("plc"), ScriptedSource("plc"), ScriptedSource("other")
    async with hall.running(old, other):
        replacing = asyncio.create_task(hall.ingest.replace("plc", new))
        await hall.until_true(lambda: new.entered == 1)
        old.script.put_nowait(Batch([sample(1)]))
        await hall.until_true(lambda: len(hall.taken) == 1)
        assert old.left == 0
        new.script.put_nowait(Batch([sample(2)]))
        await wait_for(replacing, PATIENCE_S)
        assert (old.left, new.left, other.left) == (1, 0, 0)
        assert hall.metric("source_up", source="plc") == 1.0
        await hall.until_true(lambda: len(hall.stored()) == 2)
        await hall.ingest.replace("plc", None)
        assert new.left == 1
        assert hall.metric("source_up", source="plc") is None
        other.script.put_nowait(Batch([sample(3)]))
        await hall.until_true(lambda: len(hall.stored()) == 3)


async def test_a_device_that_takes_one_connection_gets_the_new_driver_a_moment_later(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.ingest.ingest.REPLACED_AFTER_S", 0.2)
    old, new = ScriptedSource("plc"), ScriptedSource("plc")
    async with hall.running(old):
        await wait_for(hall.ingest.replace("plc", new), PATIENCE_S)
        assert (old.left, new.left) == (1, 0)
