"""Clocks of sources that are ahead: which samples are moved, by how much, for how long."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.samples import Batch, Quality, Sample
from service.ingest.source_clocks import DOUBTED_S, NAMED_S, SourceClocks

from .conftest import Hall, ScriptedSource

NOW_US = 1_763_700_000_000_000


class Source:
    """Sends samples through the clocks; times are seconds."""

    def __init__(self, rate: float = 1.0) -> None:
        self.counted = 0
        self.clocks = SourceClocks(rate, self._count)
        self.at_s = 0.0

    def _count(self) -> None:
        self.counted += 1

    def send(
        self, *of: tuple[str, float], quality: int = Quality.GOOD, value: float = 1.0
    ) -> list[tuple[float, int]]:
        """Send a call of channels with their times; gives time and quality of each as taken."""
        now_us = NOW_US + round(self.at_s * 1e6)
        samples = [
            Sample("a", channel, NOW_US + round(at_s * 1e6), value, quality, now_us)
            for channel, at_s in of
        ]
        taken = self.clocks.put_right(samples, "push")
        assert [one[:2] for one in taken] == [one[:2] for one in samples]
        return [((one.time_us - NOW_US) / 1e6, one.quality) for one in taken]

    def ahead_s(self, channel: str = "x") -> float | None:
        return self.clocks.ahead_s("a", channel)

    def by_source(self) -> dict[str, dict[str, float]]:
        return dict(self.clocks.by_source(NOW_US + round(self.at_s * 1e6)))


def test_the_newest_of_a_channel_is_of_its_receipt_and_the_others_keep_their_distance() -> None:
    source = Source()
    sent = source.send(("x", 270.0), ("x", 280.0), ("y", -3.0), ("x", 275.0), ("y", 4.9))
    assert sent == [(-10.0, 64), (0.0, 64), (-3.0, 192), (-5.0, 64), (4.9, 192)]
    assert (source.ahead_s("x"), source.ahead_s("y")) == (280.0, None)
    assert source.by_source() == {"push": {"a/x": 280.0}}
    assert source.counted == 3


@pytest.mark.parametrize(("quality", "taken"), [(192, 64), (216, 64), (80, 80), (16, 16)])
def test_no_sample_gets_better_by_it(quality: int, taken: int) -> None:
    assert Source().send(("x", 280.0), quality=quality) == [(0.0, taken)]


@pytest.mark.parametrize("again_s", [4.0, 12.0, 60.0, 110.0])
@pytest.mark.parametrize("ahead_s", [120.0, 280.0, 7200.0])
def test_what_is_sent_again_gets_the_same_times(again_s: float, ahead_s: float) -> None:
    source = Source()
    first = source.send(("x", ahead_s - 1.0), ("x", ahead_s))
    source.at_s = again_s
    source.send(("x", ahead_s + again_s))  # what is new comes first
    assert source.send(("x", ahead_s - 1.0), ("x", ahead_s)) == first


@pytest.mark.parametrize("again_s", [3.5, 5.0, 30.0])
def test_what_is_sent_again_when_its_time_has_come_is_known_too(again_s: float) -> None:
    source = Source()
    first = [source.send(("x", 8.0 + tenth / 10)) for tenth in range(30)]
    source.at_s = again_s
    for tenth in range(30):  # all at once, as a queue does
        source.at_s += 0.001
        assert source.send(("x", 8.0 + tenth / 10)) == first[tenth]
    assert source.ahead_s() is not None


def test_slow_samples_of_a_known_clock_stay_in_order() -> None:
    source = Source()
    first = source.send(*(("x", at_s) for at_s in (-140.0, -80.0, -20.0, 40.0, 100.0)))
    assert first == [(-240.0, 64), (-180.0, 64), (-120.0, 64), (-60.0, 64), (0.0, 64)]
    for again_s in (45.0, 58.0):
        source.at_s = again_s
        assert source.send(*(("x", at_s) for at_s in (-140.0, -80.0, -20.0, 40.0, 100.0))) == first
    source.at_s = 60.0
    assert source.send(("x", 100.0), ("x", 160.0)) == [(0.0, 64), (60.0, 64)], "one of them again"


def test_what_such_a_clock_has_kept_is_not_good_either() -> None:
    source = Source()
    for second in range(3):
        source.at_s = float(second)
        source.send(("x", second + 280.0))
        assert source.send(("x", second - 1000.0)) == [(second - 1000.0, 64)]
        assert source.ahead_s() == 280.0
    source.at_s += DOUBTED_S + 1.0
    assert source.send(("x", -900.0)) == [(-900.0, 192)], "long after the last of the future"


def test_one_wrong_time_takes_no_right_ones_along() -> None:
    source = Source()
    sent = source.send(*(("x", at_s) for at_s in (-3.0, -2.0, -1.0, 82_800.0)))
    assert sent == [(-3.0, 64), (-2.0, 64), (-1.0, 64), (0.0, 64)]
    source.at_s = 1.0
    assert source.send(("x", 1.0)) == [(1.0, 192)]


def test_a_clock_that_goes_on_is_followed_without_a_jump() -> None:
    source = Source()
    times = []
    for number in range(100):
        source.at_s = number + 0.3 * math.sin(number)  # as the network has it
        ((at_s, quality),) = source.send(("x", number + 280.0))
        assert quality == Quality.UNCERTAIN
        times.append(at_s)
    assert times == [float(number) for number in range(100)]
    assert source.ahead_s() == 280.0


def test_a_clock_near_the_bound_does_not_change_with_each_sample() -> None:
    source = Source()
    qualities = []
    for number in range(50):
        source.at_s = float(number)
        ((_, quality),) = source.send(("x", number + 5.0 + 0.2 * math.sin(number)))
        qualities.append(quality)
    first = qualities.index(Quality.UNCERTAIN)
    assert qualities == [192] * first + [64] * (50 - first)


@pytest.mark.parametrize("ahead_s", [10, 60, 280])
@pytest.mark.parametrize("is_constant", [False, True])
def test_a_clock_that_is_put_right_is_right_at_once(ahead_s: int, is_constant: bool) -> None:
    """Also where all times are whole seconds, which have all been those of future samples."""
    source = Source()
    right = []
    for number in range(400):
        source.at_s = number + 0.3
        at_s = float(number + ahead_s if number < 300 else number)
        value = 1500.0 if is_constant else number
        (taken,) = source.send(("x", at_s), value=value)
        right.append(taken == (at_s, 192))
    assert not any(right[:300])
    first = right.index(True)
    assert first - 300 <= (2 if is_constant else 0)
    assert all(right[first:])


def test_each_channel_has_its_own_clock() -> None:
    source = Source()
    source.send(("x", 280.0), ("y", 280.0))
    source.at_s = 1.0
    assert source.send(("x", 1.0)) == [(1.0, 192)]
    assert (source.ahead_s("x"), source.ahead_s("y")) == (None, 280.0)
    source.clocks.forget("a")
    assert source.ahead_s("y") is None


@pytest.mark.parametrize("ahead_s", [200.0, 260.0, 300.0])
def test_another_distance_counts_from_now_on(ahead_s: float) -> None:
    source = Source()
    source.send(("x", 280.0))
    source.at_s = 1.0
    assert source.send(("x", 1.0 + ahead_s)) == [(1.0, 64)]
    assert source.ahead_s() == ahead_s


def test_a_source_that_has_fallen_silent_is_not_named_for_ever() -> None:
    source = Source()
    source.send(("x", 280.0))
    source.at_s = NAMED_S - 1.0
    assert source.by_source() == {"push": {"a/x": 280.0}}
    source.at_s = NAMED_S + 1.0
    assert source.by_source() == {}
    assert source.ahead_s() is None


def test_bounds_follow_the_rate_of_the_process_clock() -> None:
    source = Source(rate=120.0)
    assert source.send(("x", 600.0)) == [(600.0, 192)]
    assert source.send(("x", 601.0)) == [(0.0, 64)]


seconds = st.floats(-1000.0, 90_000.0).map(lambda at_s: round(at_s, 6))


@given(st.lists(st.tuples(st.floats(0.0, 40.0), st.lists(seconds, min_size=1)), max_size=12))
def test_no_good_sample_is_ever_of_the_future(calls: list[tuple[float, list[float]]]) -> None:
    source = Source()
    for later_s, times_s in calls:
        source.at_s += later_s
        taken = source.send(*(("x", at_s) for at_s in times_s))
        for at_s, (taken_s, quality) in zip(times_s, taken, strict=True):
            assert taken_s <= source.at_s + 5.000_01
            if quality == Quality.GOOD:
                assert taken_s == pytest.approx(at_s, abs=2e-6)
        if max(times_s) > source.at_s + 5.000_01:
            assert source.ahead_s() is not None
            assert {quality for _, quality in taken} == {Quality.UNCERTAIN}


async def test_a_driver_whose_clock_is_ahead_is_put_right_too(hall: Hall) -> None:
    source = ScriptedSource()
    async with hall.running(source):
        now_us = hall.ingest._clock.now_us()
        source.script.put_nowait(Batch([Sample("a", "x", now_us + 280_000_000, 5.0, 192, now_us)]))
        await hall.until(stored=1)
    assert hall.stored() == [("x", now_us, 5.0, 64)]
    assert hall.taken[0].samples[0].quality == Quality.UNCERTAIN
    assert hall.ingest.clocks.by_source(now_us) == {"pt100": {"a/x": 280.0}}
    assert hall.metric("samples_ahead_total") == 1
