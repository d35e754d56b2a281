"""Process time."""

import time
from pathlib import Path

import pytest
import structlog
from processes import wait_until

from service.clock import ClockError, ProcessClock, from_rfc3339, rfc3339


def test_rate_one_is_the_system_clock() -> None:
    before_us = time.time_ns() // 1000
    assert before_us <= ProcessClock().now_us() <= time.time_ns() // 1000


def test_a_fast_clock_runs_at_its_rate() -> None:
    clock = ProcessClock(100.0)
    wall_s, began_us = time.monotonic(), clock.now_us()
    time.sleep(0.2)
    passed_s = (clock.now_us() - began_us) / 1e6
    assert 100 * 0.2 <= passed_s <= 100 * (time.monotonic() - wall_s)


async def test_sleep_takes_process_seconds() -> None:
    clock = ProcessClock(6000.0)
    wall_s = time.monotonic()
    await clock.sleep(600.0)
    assert 0.1 <= time.monotonic() - wall_s < 60.0  # of six hundred


def test_a_restart_goes_on_in_the_same_process_time(tmp_path: Path) -> None:
    first = ProcessClock.resume(1000.0, tmp_path)
    time.sleep(0.05)
    second = ProcessClock.resume(1000.0, tmp_path)
    before_us, resumed_us, after_us = first.now_us(), second.now_us(), first.now_us()
    assert before_us <= resumed_us <= after_us


def test_another_rate_never_goes_back(tmp_path: Path) -> None:
    fast = ProcessClock.resume(1000.0, tmp_path)
    time.sleep(0.05)
    reached_us = fast.now_us()
    assert ProcessClock.resume(10.0, tmp_path).now_us() >= reached_us


def test_times_that_have_run_do_not_run_a_second_time(tmp_path: Path) -> None:
    fast = ProcessClock.resume(100_000.0, tmp_path)
    wait_until(lambda: fast.now_us() > time.time_ns() // 1000 + 5_000_000, 30, "ahead")
    with pytest.raises(ClockError, match=r"clock\.rate = 1: .* ran at rate 100000 .*clock\.json"):
        ProcessClock.resume(1.0, tmp_path)
    assert ProcessClock.resume(100_000.0, tmp_path).now_us() >= fast.now_us() - 1_000_000
    (tmp_path / "clock.json").unlink()
    assert ProcessClock.resume(1.0, tmp_path).now_us() <= time.time_ns() // 1000


def test_a_change_of_the_rate_is_logged_and_counts_no_time_twice(tmp_path: Path) -> None:
    ProcessClock.resume(0.5, tmp_path)
    with structlog.testing.capture_logs() as logs:
        ProcessClock.resume(1.0, tmp_path)
    assert [(one["event"], one["before"], one["now"]) for one in logs] == [
        ("clock_rate_changed", 0.5, 1.0)
    ]
    time.sleep(0.2)
    # Had the slow clock gone on meanwhile, the fast one would begin behind the system clock; had
    # a fast one, far ahead of it.
    began_us = ProcessClock.resume(1000.0, tmp_path).now_us()
    assert abs(began_us - time.time_ns() // 1000) < 30 * 1000 * 1_000_000
    with structlog.testing.capture_logs() as logs:
        assert ProcessClock.resume(10.0, tmp_path).now_us() >= began_us
    assert [one["event"] for one in logs] == ["clock_rate_changed"]


def test_a_rate_that_is_no_rate_is_refused() -> None:
    with pytest.raises(ValueError, match="clock rate 0"):
        ProcessClock(0)


def test_rfc3339_there_and_back() -> None:
    assert rfc3339(1_700_000_000_123_456) == "2023-11-14T22:13:20.123Z"
    assert from_rfc3339("2023-11-14T23:13:20.123+01:00") == 1_700_000_000_123_000
    with pytest.raises(ValueError, match="offset"):
        from_rfc3339("2023-11-14T22:13:20")
    with pytest.raises(ValueError, match="RFC 3339"):
        from_rfc3339("yesterday")


@pytest.mark.parametrize(
    "content",
    ["", "{", "null", '{"rate": 60.0}', '{"rate": "x", "wall_s": 1, "process_us": 1}',
     '{"rate": 60.0, "wall_s": NaN, "process_us": 1}', "\x00" * 90],
)  # fmt: skip
def test_a_torn_file_does_not_stop_the_clock(tmp_path: Path, content: str) -> None:
    (tmp_path / "clock.json").write_text(content)
    clock = ProcessClock.resume(60.0, tmp_path)
    assert clock.rate == 60.0
    before_us = clock.now_us()
    assert 0 <= ProcessClock.resume(60.0, tmp_path).now_us() - before_us < 3_600_000_000
