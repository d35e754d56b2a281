import asyncio
import time
from pathlib import Path

from adapters.samples import Sample
from service.clock import ProcessClock
from service.store import AlarmTransition, AuditEntry, Retention, Store
from service.upkeep import keep_up

HOUR_US = 3_600_000_000


async def test_finished_hours_are_condensed_and_old_samples_go(tmp_path: Path) -> None:
    clock = ProcessClock()
    now_us = clock.now_us()
    ages_h = [0, 1, 5, 30, 60]
    with Store.open("", tmp_path) as store:
        store.write_samples(
            [Sample("a", "x", now_us - age * HOUR_US, float(age), 192, 0) for age in ages_h]
        )
        for days in (30, 800):
            wall_us = time.time_ns() // 1000 - days * 24 * HOUR_US
            store.add_audit_entry(AuditEntry(wall_us, "eva", "", "alarm.shelve"))
            at_us = now_us - days * 24 * HOUR_US
            event = AlarmTransition(None, "a", "", "", "", at_us, "", "", "", "", None, "")
            store.save_alarm(None, [event])
        retention = Retention(raw_days=1.0, journal_days=100.0, audit_days=400.0)
        task = asyncio.create_task(keep_up(store, clock, retention))
        async with asyncio.timeout(60):
            while len(store.audit().items) > 1:  # noqa: ASYNC110 - the last that goes
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.wait({task})
        assert len(store.read_samples("a", None, 0, 2**62, 9)) == 3
        assert [one.time_us for one in store.alarm_journal().items] == [now_us - 720 * HOUR_US]
        with store._database.reading() as connection:
            stale = connection.exec_driver_sql("SELECT count(*) FROM stale_rollups").scalar()
        assert stale in (1, 2), "only what is not over, or just"
        hours = store.read_rollup("a", None, 0, now_us + HOUR_US, HOUR_US, 9)
        assert [hour.mean for hour in hours] == [60.0, 30.0, 5.0, 1.0, 0.0]
