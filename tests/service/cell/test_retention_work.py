import asyncio
import time
from pathlib import Path

from jumping import LoopClock
from patience import within
from prometheus_client import CollectorRegistry

from adapters.samples import Sample
from service.cell.retention import StoreMaintenance
from service.clock import ProcessClock
from service.features.ledger.part import ForecastLedger
from service.features.ledger.tables import KeptForecasts
from service.store import AlarmTransition, AuditEntry, Retention, Store
from service.store.forecast_records import IssuedContent, IssuedForecast

HOUR_US = 3_600_000_000


async def test_finished_hours_are_condensed_and_old_samples_go(tmp_path: Path) -> None:
    clock = ProcessClock()
    now_us = clock.now_us()
    ages_h = [0, 1, 5, 30, 60]
    with Store.open("", tmp_path) as store:
        store.samples.write(
            [Sample("a", "x", now_us - age * HOUR_US, float(age), 192, 0) for age in ages_h]
        )
        for days in (800, 30):
            wall_us = time.time_ns() // 1000 - days * 24 * HOUR_US
            store.audit.add(AuditEntry(wall_us, "eva", "", "alarm.shelve"))
            at_us = now_us - days * 24 * HOUR_US
            event = AlarmTransition(None, "a", "", "", "", at_us, "", "", "", "", None, "")
            store.alarms.save(None, [event])
            store.part(KeptForecasts).add([forecast(at_us)])
        retention = Retention(raw_days=1.0, journal_days=100.0, audit_days=400.0)
        ledger = ForecastLedger(store, tmp_path, clock, CollectorRegistry(), kept_days=100.0)
        task = asyncio.create_task(
            StoreMaintenance(store, clock, retention, trust_after_s=0.0, parts=[ledger]).run()
        )
        async with within(60):
            # The last that goes, and what is packed meanwhile.
            while len(store.audit.page().items) > 1 or not packed_hours(store):  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.wait({task})
        assert len(store.samples.read("a", None, 0, 2**62, 9)) == 3
        assert [one.time_us for one in store.alarms.journal().items] == [now_us - 720 * HOUR_US]
        kept = store.part(KeptForecasts).since("a", 0)
        assert [one.issued.time_us for one in kept] == [now_us - 720 * HOUR_US]
        with store._database.reading() as connection:
            stale = connection.exec_driver_sql("SELECT count(*) FROM stale_rollups").scalar()
        assert stale in (1, 2), "only what is not over, or just"
        hours = store.history.read("a", None, 0, now_us + HOUR_US, HOUR_US, 9)
        assert [hour.mean for hour in hours] == [60.0, 30.0, 5.0, 1.0, 0.0]


def forecast(time_us: int) -> IssuedForecast:
    content = IssuedContent([(300.0, 1.0, 1.0, 1.0)], False, [], ["t"], [300], [False], [[[0]]], {})
    return IssuedForecast("a", time_us, 1, "period", content)


def packed_hours(store: Store) -> int:
    with store._database.reading() as connection:
        count = connection.exec_driver_sql("SELECT count(*) FROM packed_hours").scalar()
    assert isinstance(count, int)
    return count


class SetClock(LoopClock):
    """A clock that somebody sets."""

    def __init__(self) -> None:
        super().__init__(1.0, time.time_ns() // 1000)
        self.ahead_us = 0

    def now_us(self) -> int:
        return super().now_us() + self.ahead_us


def _filled(store: Store, now_us: int) -> None:
    """A sample, a line of the journal and one of the trail for each tenth day of the last 400."""
    day_us = 24 * HOUR_US
    days = range(400, -1, -10)
    store.samples.write([Sample("a", "x", now_us - day * day_us, 1.0, 192, 0) for day in days])
    for day in days:
        at_us = now_us - day * day_us
        store.audit.add(AuditEntry(at_us, "eva", "", "alarm.shelve"))
        event = AlarmTransition(None, "a", "", "", "", at_us, "", "", "", "", None, "")
        store.alarms.save(None, [event])


def _count(store: Store) -> tuple[int, int, int]:
    samples = store.samples.read("a", None, 0, 2**62, 1000)
    return (
        len(samples),
        len(store.alarms.journal(limit=1000).items),
        len(store.audit.page(1000).items),
    )


def test_a_clock_ten_years_ahead_empties_nothing(tmp_path: Path) -> None:
    retention = Retention(
        raw_days=3652.0, minute_days=3652.0, journal_days=3652.0, audit_days=3652.0
    )
    clock = ProcessClock()
    now_us = clock.now_us()
    ten_years_us = 3660 * 24 * HOUR_US
    with Store.open("", tmp_path) as store:
        _filled(store, now_us)
        maintenance = StoreMaintenance(store, clock, retention)
        assert maintenance._expire(now_us, now_us) == 0
        # What is recorded while the clock is wrong must not vouch for it.
        later_us = now_us + ten_years_us
        store.samples.write([Sample("a", "x", later_us, 1.0, 192, 0)])
        event = AlarmTransition(None, "a", "", "", "", later_us, "", "", "", "", None, "")
        store.alarms.save(None, [event])
        store.audit.add(AuditEntry(later_us, "eva", "", "alarm.shelve"))
        for look in range(5):
            at_us = later_us + look * 600_000_000
            assert maintenance._expire(at_us, at_us) == 0
        assert _count(store) == (42, 42, 42)
        assert maintenance._expire(now_us, now_us) == 0
        # The clock is right again: everything is stored.
        assert store.samples.write([Sample("a", "x", now_us + 1, 1.0, 192, 0)]) == (1, 0)


async def test_nothing_is_removed_before_the_clock_has_agreed_for_a_while(tmp_path: Path) -> None:
    clock = SetClock()
    now_us = clock.now_us()
    with Store.open("", tmp_path) as store:
        _filled(store, now_us)
        maintenance = StoreMaintenance(
            store, clock, Retention(raw_days=100.0), trust_after_s=3600.0
        )
        task = asyncio.create_task(maintenance.run())
        await asyncio.sleep(3000.0)
        clock.ahead_us = -5_000_000  # set: the time of agreement begins again
        await asyncio.sleep(3500.0)
        assert _count(store)[0] == 41
        await asyncio.sleep(200.0)
        assert _count(store)[0] < 41
        async with within(7 * 86_400.0):
            while _count(store)[0] > 11:  # noqa: ASYNC110 - hour after hour
                await asyncio.sleep(600.0)
        task.cancel()
        await asyncio.wait({task})


async def test_each_cell_condenses_and_packs_its_own_and_one_removes_what_is_old(
    tmp_path: Path,
) -> None:
    clock = SetClock()
    at_us = clock.now_us() - 400 * 24 * HOUR_US
    with Store.open("", tmp_path) as store:
        store.samples.write([Sample(asset, "x", at_us, 1.0, 192, 0) for asset in ("mine", "other")])
        maintenance = StoreMaintenance(
            store,
            clock,
            Retention(raw_days=1000.0),
            trust_after_s=0.0,
            is_ours=lambda: False,
            owns=lambda asset: asset == "mine",
        )
        task = asyncio.create_task(maintenance.run())
        await asyncio.sleep(3600.0)
        with store._database.reading() as connection:
            packed = "SELECT asset FROM packed_hours JOIN channels ON channels.id = channel_id"
            assert connection.exec_driver_sql(packed).scalars().all() == ["mine"]
            assert connection.exec_driver_sql("SELECT count(*) FROM stale_rollups").scalar() == 1
            assert connection.exec_driver_sql("SELECT count(*) FROM retention_marks").scalar() == 0
        task.cancel()
        await asyncio.wait({task})


def test_a_clock_far_ahead_waits_for_a_proof_or_a_person(tmp_path: Path) -> None:
    day_us = 24 * HOUR_US
    clock = ProcessClock()
    now_us = clock.now_us()
    with Store.open("", tmp_path) as store:
        _filled(store, now_us)
        maintenance = StoreMaintenance(store, clock, Retention(raw_days=100.0))
        maintenance._judge(store.rollups.retention_time("process", now_us))
        assert maintenance.problem is None
        later_us = now_us + 30 * day_us  # as after a month without power
        store.samples.write([Sample("a", "x", later_us, 1.0, 192, 0)])
        maintenance._judge(store.rollups.retention_time("process", later_us))
        assert maintenance.problem is not None
        assert "30 days ahead" in maintenance.problem
        assert store.rollups.retention_time("process", later_us).at_us == now_us
        proven = store.rollups.retention_time("process", later_us, HOUR_US, clock_proven=True)
        assert (proven.at_us, proven.ahead_us) == (now_us + HOUR_US, 0)
        store.rollups.confirm_clock(later_us, later_us)
        maintenance._judge(store.rollups.retention_time("process", later_us))
        assert maintenance.problem is None
        assert store.rollups.retention_time("process", later_us).at_us == later_us
