from service.security.limits import RateLimit


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def calls(limit: RateLimit, caller: str, tries: int) -> int:
    """How many of so many tries pass."""
    passed = 0
    for _ in range(tries):
        if limit.wait_s(caller) == 0.0:
            limit.count(caller)
            passed += 1
    return passed


def test_a_minutes_worth_passes_at_once_and_then_as_many_a_minute() -> None:
    clock = Clock()
    limit = RateLimit(10, clock)
    assert calls(limit, "a", 20) == 10
    assert limit.wait_s("a") == 6.0
    clock.now_s += 30.0
    assert calls(limit, "a", 20) == 5
    clock.now_s += 3600.0
    assert calls(limit, "a", 20) == 10


def test_callers_do_not_share() -> None:
    limit = RateLimit(3, Clock())
    assert calls(limit, "a", 5) == 3
    assert calls(limit, "b", 5) == 3


def test_memory_is_bounded_and_the_busy_stay_known() -> None:
    limit = RateLimit(1, Clock())
    for number in range(10_000):
        limit.count(str(number))
        limit.count("busy")
    assert len(limit._left) <= 4096
    assert limit.wait_s("busy") > 0.0
