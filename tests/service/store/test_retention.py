"""A clock that is wrong once must not cost history: neither what is stored nor what comes."""

from adapters.samples import Sample
from service.store import Retention, Store

DAY_US = 86_400_000_000
HOUR_US = 3_600_000_000
NOW_US = 1_790_000_000_000_000 // HOUR_US * HOUR_US
RETENTION = Retention(raw_days=90.0)


def samples(from_us: int, count: int = 1000) -> list[Sample]:
    return [Sample("a", "x", from_us + k * 1_000_000, float(k), 192, 0) for k in range(count)]


def stored(store: Store) -> int:
    return len(store.samples.read("a", None, 0, 2**62, 10**6))


def test_a_clock_a_year_ahead_for_one_look_removes_nothing(store: Store) -> None:
    store.samples.write(samples(NOW_US - HOUR_US))
    assert store.rollups.expire(RETENTION, NOW_US + 365 * DAY_US) == 0
    assert stored(store) == 1000
    assert store.samples.write(samples(NOW_US)) == (1000, 0)
    assert store.rollups.expire(RETENTION, NOW_US + HOUR_US) == 0
    assert stored(store) == 2000


def test_what_is_recorded_a_year_ahead_does_not_help_it(store: Store) -> None:
    store.samples.write(samples(NOW_US - HOUR_US))
    store.rollups.expire(RETENTION, NOW_US)
    wrong_us = NOW_US + 365 * DAY_US
    store.samples.write(samples(wrong_us))
    for look in range(3):
        assert store.rollups.expire(RETENTION, wrong_us + look * 600_000_000) == 0
    assert store.samples.write(samples(NOW_US)) == (1000, 0)
    assert stored(store) == 3000


def test_a_first_start_with_a_wrong_clock_leaves_room_for_right_samples(store: Store) -> None:
    wrong_us = NOW_US + 365 * DAY_US
    store.samples.write(samples(wrong_us))
    store.rollups.expire(RETENTION, wrong_us + HOUR_US)
    assert store.samples.kept_from_us == 0
    assert store.samples.write(samples(NOW_US)) == (1000, 0)


def test_samples_of_a_clock_that_lost_its_battery_are_no_duplicates(store: Store) -> None:
    year_2000_us = 946_684_800_000_000
    store.samples.write([*samples(NOW_US - 200 * DAY_US), *samples(NOW_US)])
    assert store.rollups.expire(RETENTION, NOW_US + HOUR_US) == 1000
    kept_from_us = NOW_US - 200 * DAY_US + HOUR_US
    assert store.samples.kept_from_us == kept_from_us, "no further than what is gone"
    assert store.samples.write(samples(year_2000_us)) == (0, 0)
    assert store.rollups.expire(RETENTION, year_2000_us) == 0
    assert stored(store) == 1000
    # The way back, should they be wanted.
    assert store.rollups.lower_raw_horizon(2**62) == kept_from_us, "never up"
    assert store.rollups.lower_raw_horizon(year_2000_us) == year_2000_us
    assert store.samples.write(samples(year_2000_us)) == (1000, 0)
    assert store.rollups.expire(RETENTION, NOW_US + HOUR_US) == 1000
    assert store.samples.raw_kept_from_us() == year_2000_us + HOUR_US


def test_retention_moves_on_by_small_steps(store: Store) -> None:
    days = range(120)
    store.samples.write([Sample("a", "x", NOW_US + k * DAY_US, 1.0, 192, 0) for k in days])
    end_us = NOW_US + 119 * DAY_US
    assert store.rollups.expire(RETENTION, end_us) == 29
    # Three days later, as after a weekend without power.
    later_us = end_us + 3 * DAY_US
    store.samples.write([Sample("a", "x", later_us, 1.0, 192, 0)])
    removed = [store.rollups.expire(RETENTION, later_us, 12 * HOUR_US) for _ in range(8)]
    assert removed == [1, 0, 1, 0, 1, 0, 0, 0], "a day at a time, until it has caught up"
