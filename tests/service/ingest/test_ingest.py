import asyncio
import contextlib
import math
import sqlite3
import threading
from pathlib import Path

import pytest
from patience import patience, within
from processes import wait_until
from prometheus_client import CollectorRegistry

from adapters.samples import Batch, PlannedProfile, PlanStep, Quality, Sample
from service.clock import ProcessClock
from service.ingest import Ingest, Spool
from service.ingest.metrics import SampleLedger
from service.ingest.sample_queue import QUEUE_SAMPLES
from service.ingest.spool import FILE_NAME as SPOOL_FILE
from service.ingest.writer import SampleWriter
from service.store import Retention, Store, StoreUnavailableError, WriteCounts

from .conftest import Hall, ScriptedSource, sample

PATIENCE_S = 30.0
NAN = float("nan")


async def test_a_batch_reaches_the_twin_at_once_and_the_store_soon(hall: Hall) -> None:
    source = ScriptedSource()
    plan = PlannedProfile("a", 5, (PlanStep(60.0, 4200.0, 2650.0),))
    batch = Batch([sample(5), sample(5, 2.0, channel="y")], [plan], poll_s=0.003)
    async with hall.running(source):
        source.script.put_nowait(batch)
        source.script.put_nowait(Batch([], [plan]))
        await hall.until_true(lambda: len(hall.taken) == 2)
        assert hall.taken == [batch, Batch([], [plan])]
        await hall.until(stored=2)
        assert hall.stored() == [("x", 5, 1.0, 192), ("y", 5, 2.0, 192)]
    assert (source.entered, source.left) == (1, 1)
    assert hall.metric("poll_seconds_count", source="pt100") == 1
    assert hall.metric("poll_seconds_sum", source="pt100") == pytest.approx(0.003)


async def test_metrics_have_the_contracts_names_and_add_up(hall: Hall) -> None:
    source = ScriptedSource()
    async with hall.running(source):
        source.script.put_nowait(Batch([sample(1), sample(2), sample(-1)]))
        await hall.until(stored=2, skipped=1)
        source.script.put_nowait(Batch([sample(2), sample(3)]))
        await hall.until(stored=3)
        assert hall.metric("samples_accepted_total") == 5
        assert hall.metric("samples_stored_total") == 3
        assert hall.metric("samples_duplicate_total") == 1
        assert hall.metric("samples_skipped_total", reason="refused") == 1
        assert hall.metric("samples_skipped_total", reason="queue_full") == 0
        assert hall.metric("spool_samples") == 0
        assert hall.metric("source_up", source="pt100") == 1
        assert hall.metric("source_errors_total", source="pt100", kind="connect") == 0
        source.up = False
        assert hall.metric("source_up", source="pt100") == 0
    with pytest.raises(ValueError, match="Duplicated timeseries"):
        SampleLedger(hall.registry)


async def test_what_was_accepted_is_stored_when_it_stops(hall: Hall) -> None:
    source = ScriptedSource()
    async with hall.running(source):
        for number in range(200):
            source.script.put_nowait(Batch([sample(number * 60 + k) for k in range(60)]))
        await hall.until_true(lambda: len(hall.taken) == 200)
        hall.ingest.submit([sample(7, 3.0, channel="x.twin")])
        assert hall.ingest.counts()["waiting"] > 0  # stopped in the middle
    assert hall.ingest.counts() == {
        "accepted": 12_001,
        "stored": 12_001,
        "duplicate": 0,
        "skipped": 0,
        "waiting": 0,
    }
    assert len(hall.stored()) == 12_001


async def test_a_locked_store_delays_neither_polling_nor_the_twin_nor_loses_a_sample(
    hall: Hall,
) -> None:
    source = ScriptedSource()
    sent = 0
    async with hall.running(source):
        source.script.put_nowait(Batch([sample(0)]))
        await hall.until(stored=1)
        with hall.locked():
            while sent < 100 or hall.ingest.problem is None:
                sent += 1
                source.script.put_nowait(Batch([sample(sent)]))
                # The twin has it while the store still waits for the lock.
                await hall.until_true(lambda so_far=sent: len(hall.taken) == so_far + 1)
                await asyncio.sleep(0.01)
            assert hall.ingest.counts()["stored"] == 1
            assert hall.ingest.counts()["waiting"] == sent
            assert hall.ingest.problem is not None
            assert "locked" in hall.ingest.problem
        await hall.until(stored=sent + 1)
        assert hall.ingest.problem is None
    assert len(hall.taken) == sent + 1
    assert [time_us for _, time_us, _, _ in hall.stored()] == list(range(sent + 1))


async def test_a_driver_that_fails_or_ends_is_entered_again_and_disturbs_no_other(
    hall: Hall,
) -> None:
    bad, good = ScriptedSource("bad"), ScriptedSource("good")
    async with hall.running(bad, good):
        bad.script.put_nowait(Batch([sample(1, channel="bad")]))
        bad.script.put_nowait(RuntimeError("a driver with a fault"))
        good.script.put_nowait(Batch([sample(1)]))
        await hall.until(stored=2)
        assert (bad.entered, bad.left) == (1, 1)
        bad.script.put_nowait(Batch([sample(2, channel="bad")]))
        good.script.put_nowait(Batch([sample(2)]))
        await hall.until(stored=4)
        assert (bad.entered, good.entered) == (2, 1)


async def test_a_twin_with_a_fault_costs_no_sample(tmp_path: Path) -> None:
    def fail(batch: Batch) -> None:
        raise RuntimeError("a twin with a fault")

    with Store.open("", tmp_path) as store:
        ingest = Ingest(
            store, Spool.open(tmp_path, 16), ProcessClock(), fail, registry=CollectorRegistry()
        )
        source = ScriptedSource()
        task = asyncio.create_task(ingest.run([source]))
        for number in range(3):
            source.script.put_nowait(Batch([sample(number)]))
        async with within(30):
            while ingest.counts()["accepted"] < 3:  # noqa: ASYNC110 - no event to wait for
                await asyncio.sleep(0.001)
        assert await ingest.accept([sample(9)]) == (1, 0)
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
        assert len(store.samples.read("a", None, 0, 99, 99)) == 4
        assert source.entered == 1


async def test_pushed_samples_are_on_the_disk_when_the_answer_comes(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "service.ingest.sample_queue.BATCH_S", 3600.0
    )  # a push does not wait for others
    async with hall.running():
        counts = await hall.ingest.accept([sample(1), sample(2), sample(2)])
        assert counts == WriteCounts(stored=2, duplicates=1)
        with contextlib.closing(sqlite3.connect(hall.path)) as outside:
            assert outside.execute("SELECT COUNT(*) FROM samples").fetchone() == (2,)
        assert await hall.ingest.accept([sample(1), sample(3)]) == (1, 1)
        assert await hall.ingest.accept([]) == (0, 0)
        answers = await asyncio.gather(
            *(hall.ingest.accept([sample(t), sample(t + 1)]) for t in range(100, 150))
        )
        assert sum(stored for stored, _ in answers) == 51
    assert len(hall.taken) == 52


async def test_a_push_survives_its_caller_and_is_on_the_spool_while_the_store_is_locked(
    hall: Hall,
) -> None:
    async with hall.running():
        with hall.locked():
            gone = asyncio.create_task(hall.ingest.accept([sample(1)]))
            patient = asyncio.create_task(hall.ingest.accept([sample(2)]))
            await hall.until_true(lambda: hall.ingest.counts()["accepted"] == 2)
            assert not patient.done()  # the store has a second
            gone.cancel()
            assert await patient == (1, 0)
            assert hall.stored_outside() == 0
            assert hall.on_spool() == [1, 2]
            # The spool takes it while the store is still away.
            assert await hall.ingest.accept([sample(3)]) == (1, 0)
            assert hall.stored_outside() == 0
        await hall.until(stored=3)
        # The spool gives up what the store has, right after the store has it.
        await hall.until_true(lambda: hall.on_spool() == [])
        assert await hall.ingest.accept([sample(3), sample(4)]) == (1, 1)
    assert [time_us for _, time_us, _, _ in hall.stored()] == [1, 2, 3, 4]


async def test_a_push_to_a_stopped_service_is_refused(hall: Hall) -> None:
    async with hall.running():
        pass
    with pytest.raises(StoreUnavailableError, match="stopping"):
        await hall.ingest.accept([sample(1)])
    hall.ingest.submit([sample(2)])
    assert hall.ingest.counts()["skipped"] == hall.ingest.counts()["accepted"] == 1


async def test_the_gap_while_the_service_was_away_is_marked_once(tmp_path: Path) -> None:
    def run_of(*batches: Batch) -> list[tuple[str, int, float | None, int]]:
        async def run() -> list[tuple[str, int, float | None, int]]:
            hall = Hall(tmp_path)
            source = ScriptedSource()
            async with hall.running(source):
                for batch in batches:
                    source.script.put_nowait(batch)
                await hall.until_true(lambda: len(hall.taken) == len(batches))
                await hall.ingest.accept([sample(900, channel="pushed")])
            stored = hall.stored()
            hall.close()
            return stored

        return asyncio.run(run())

    before = [sample(100), sample(100, NAN, Quality.COMM_FAILURE, channel="y")]
    await asyncio.to_thread(run_of, Batch(before))
    after = [sample(800), sample(801), sample(800, channel="y"), sample(800, channel="new")]
    stored = await asyncio.to_thread(run_of, Batch(after[:1]), Batch(after[1:]))
    assert stored == [
        ("x", 100, 1.0, 192),
        ("y", 100, None, Quality.COMM_FAILURE),  # ended already
        ("x", 101, None, Quality.OUT_OF_SERVICE),
        ("new", 800, 1.0, 192),
        ("x", 800, 1.0, 192),
        ("y", 800, 1.0, 192),
        ("x", 801, 1.0, 192),
        ("pushed", 900, 1.0, 192),
    ]


def test_a_full_queue_skips_the_newest_and_says_so(hall: Hall) -> None:
    ledger = SampleLedger(CollectorRegistry())
    writer = SampleWriter(hall.store, hall.spool, ledger)
    # As drivers do, in many small parcels: a single one would be a transaction of seconds.
    for begin in range(0, QUEUE_SAMPLES - 1000, 1000):
        writer.put([sample(time_us) for time_us in range(begin, begin + 1000)])
    writer.put([sample(time_us) for time_us in range(QUEUE_SAMPLES - 1000, QUEUE_SAMPLES - 10)])
    writer.put([sample(time_us) for time_us in range(QUEUE_SAMPLES - 10, QUEUE_SAMPLES + 20)])
    with pytest.raises(StoreUnavailableError, match=f"{QUEUE_SAMPLES} samples already wait"):
        writer.put_with_result([sample(1)])
    assert ledger.counts()["skipped"] == 20
    assert ledger.counts()["waiting"] == QUEUE_SAMPLES
    writer.start()
    writer.close(timeout_s=PATIENCE_S)
    assert ledger.counts()["stored"] == QUEUE_SAMPLES
    assert len(hall.stored()) == QUEUE_SAMPLES


def test_a_store_that_stays_away_cannot_hold_up_the_stop_nor_cost_a_sample(hall: Hall) -> None:
    ledger = SampleLedger(CollectorRegistry())
    writer = SampleWriter(hall.store, hall.spool, ledger)
    writer.start()
    with hall.locked():
        promised = writer.put_with_result([sample(1)])
        writer.put([sample(2), sample(3)])
        writer.close(timeout_s=0.5)
        assert promised.result(timeout=0) == (1, 0)
    assert ledger.counts()["skipped"] == 0
    assert ledger.counts()["waiting"] == 3
    next_run = SampleLedger(CollectorRegistry())
    writer = SampleWriter(hall.store, hall.spool, next_run)
    assert next_run.counts()["waiting"] == 3
    writer.start()
    writer.put([sample(4)])
    writer.close(timeout_s=PATIENCE_S)
    assert next_run.counts()["stored"] == 4
    assert [time_us for _, time_us, _, _ in hall.stored()] == [1, 2, 3, 4]


def test_with_store_and_spool_away_samples_wait_in_memory_until_the_stop(hall: Hall) -> None:
    ledger = SampleLedger(CollectorRegistry())
    writer = SampleWriter(hall.store, hall.spool, ledger)
    writer.start()
    with hall.locked(), hall.locked(SPOOL_FILE):
        promised = writer.put_with_result([sample(1)])
        wait_until(lambda: writer.spool_problem, PATIENCE_S, "the spool is asked too")
        assert writer.problem is not None
        assert writer.spool_problem is not None
        assert "locked" in writer.spool_problem
        assert not promised.done()
    assert promised.result(timeout=patience(PATIENCE_S)) == (1, 0)
    # It may have gone on the spool first.
    wait_until(lambda: ledger.counts()["stored"], PATIENCE_S, "stored", every_s=0.01)
    with hall.locked(), hall.locked(SPOOL_FILE):
        promised = writer.put_with_result([sample(2)])
        writer.close(timeout_s=0.5)
        with pytest.raises(StoreUnavailableError):
            promised.result(timeout=0)
    assert (ledger.counts()["stored"], ledger.counts()["skipped"]) == (1, 1)


def test_a_refused_sample_takes_no_other_with_it(hall: Hall) -> None:
    ledger = SampleLedger(CollectorRegistry())
    writer = SampleWriter(hall.store, hall.spool, ledger)
    samples = [sample(time_us) for time_us in range(100)]
    samples[37] = sample(-1)
    samples[80] = sample(80, math.pi, 300)
    writer.put(samples)
    writer.start()
    writer.close(timeout_s=PATIENCE_S)
    assert ledger.counts()["stored"] == 98
    assert ledger.counts()["skipped"] == 2
    assert len(hall.stored()) == 98


def test_every_scrape_adds_up(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    # A busy machine takes seconds to log a refused sample; that is no store that hangs.
    monkeypatch.setattr("service.ingest.writer._HANGS_S", PATIENCE_S)
    registry = CollectorRegistry()
    writer = SampleWriter(hall.store, hall.spool, SampleLedger(registry))
    writer.start()
    stop = threading.Event()
    wrong: list[dict[str, float]] = []
    scrapes = 0

    def scrape() -> None:
        nonlocal scrapes
        while not stop.is_set():
            now = {"skipped": 0.0}
            for metric in registry.collect():
                for one in metric.samples:
                    name = one.name.removeprefix("bearing_twin_").removesuffix("_total")
                    now[name] = now.get(name, 0.0) + one.value
            settled = sum(now[f"samples_{what}"] for what in ("stored", "duplicate", "skipped"))
            if now["samples_accepted"] != settled + now["spool_samples"]:
                wrong.append(now)
            scrapes += 1

    scraper = threading.Thread(target=scrape)
    scraper.start()
    for number in range(300):
        times = range(number * 40, number * 40 + 50)  # ten are sent twice
        writer.put([sample(time_us) for time_us in times])
        if number % 50 == 0:
            writer.put_with_result([sample(-1)])
    wait_until(lambda: scrapes > 10, PATIENCE_S, "scrapes", every_s=0.001)
    writer.close(timeout_s=PATIENCE_S)
    stop.set()
    scraper.join()
    assert wrong == []
    assert len(hall.stored()) == 300 * 40 + 10


async def test_samples_from_before_what_is_kept_are_counted_and_reported(tmp_path: Path) -> None:
    hall = Hall(tmp_path)
    day_us = 86_400_000_000
    now_us = ProcessClock().now_us()
    hall.store.samples.write(
        [Sample("a", "x", at_us, 1.0, 192, 0) for at_us in (now_us - 50 * day_us, now_us - day_us)]
    )
    assert hall.store.rollups.expire(Retention(raw_days=10.0), now_us) == 1
    assert hall.ingest.too_old("a") is None
    source = ScriptedSource()
    async with hall.running(source):
        old = [Sample("a", "x", 946_684_800_000_000 + k, 1.0, 192, now_us) for k in range(3)]
        source.script.put_nowait(Batch([*old, Sample("a", "x", now_us, 2.0, 192, now_us)]))
        await hall.until_true(lambda: hall.metric("samples_stored_total") == 1)
        await hall.until_true(lambda: hall.ingest.counts()["waiting"] == 0)
    assert hall.metric("samples_skipped_total", reason="too_old") == 3
    assert hall.metric("samples_duplicate_total") == 0
    assert hall.ingest.counts() == {
        "accepted": 4, "stored": 1, "duplicate": 0, "skipped": 3, "waiting": 0
    }  # fmt: skip
    assert "Samples of 2000-01-01" in (hall.ingest.too_old("a") or "")
    assert hall.ingest.too_old_problem == hall.ingest.too_old("a")
    hall.close()


async def test_work_that_has_stopped_shows(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the watchdog is fed by: the pumping task and the writing thread."""
    async with hall.running():
        await hall.until_true(hall.ingest.has_gone_on)
        await hall.until_true(hall.ingest.has_gone_on)
        monkeypatch.setattr(hall.ingest._writer, "_next", lambda: None)
        hall.ingest.submit([sample(1)])  # the thread looks for work once more
        await hall.until_true(lambda: not hall.ingest._writer.is_running)
        await asyncio.sleep(0.5)
        hall.ingest.has_gone_on()
        await asyncio.sleep(0.5)
        assert not hall.ingest.has_gone_on()


async def test_a_push_whose_turn_does_not_come_is_taken_back_whole(hall: Hall) -> None:
    """Who is told that nothing was stored must find nothing stored, also later."""
    writer = hall.ingest._writer
    refused = []
    for number in range(3):  # nobody writes yet
        awaited = await hall.ingest.take_in([sample(number)], patience_s=0.01)
        with pytest.raises(StoreUnavailableError, match="their turn did not come within"):
            await awaited
        refused.append(hall.ingest.retry_after_s)
    assert refused == [5, 10, 20]
    assert writer.queued == 0
    async with hall.running():
        assert await hall.ingest.accept([sample(9)]) == (1, 0)
        assert hall.ingest.retry_after_s == 5
    assert [time_us for _, time_us, _, _ in hall.stored()] == [9]
    assert hall.ingest.counts()["skipped"] == 3


async def test_a_push_that_is_being_written_is_answered_as_it_ends(hall: Hall) -> None:
    async with hall.running():
        with hall.locked():
            # The store has a second, then the spool takes it; the patience is over by then.
            awaited = await hall.ingest.take_in([sample(1)], patience_s=0.2)
            assert await awaited == (1, 0)
    assert [time_us for _, time_us, _, _ in hall.stored()] == [1] or hall.on_spool() == [1]


async def test_live_samples_go_before_a_backlog(hall: Hall) -> None:
    backlog = [sample(number, channel="old") for number in range(60_000)]
    order: list[str] = []
    async with hall.running():

        async def push(samples: list[Sample], name: str) -> None:
            counts = await (await hall.ingest.take_in(samples, patience_s=PATIENCE_S))
            assert counts == (len(samples), 0)
            order.append(name)

        long = [
            asyncio.create_task(push(backlog[begin : begin + 20_000], f"backlog {begin}"))
            for begin in range(0, len(backlog), 20_000)
        ]
        await hall.until_true(lambda: hall.ingest._writer.queued > 40_000)
        await push([sample(10**6, channel="live")], "live")
        await asyncio.gather(*long)
    assert order.index("live") < 2, order
    assert len(hall.stored()) == 60_001
    assert hall.ingest.counts()["duplicate"] == 0
