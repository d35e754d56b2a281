"""What physics cannot do is not taken for good; what it can do is."""

import math
import random
from collections.abc import Iterable

import pytest
from prometheus_client import CollectorRegistry
from site_files import asset_table

from adapters.samples import Quality, Sample, is_good
from service.ingest.quality import REASONS, QualityChecks
from service.site.check_limits import CheckLimits
from service.site.configuration import SettingsError
from service.site.settings import Settings
from service.site.wiring import wire

RING = CheckLimits(-40.0, 200.0, max_jump=5.0, max_rate_per_s=2.0, flat_line_s=60.0)
S = 1_000_000


class Line:
    """A channel of a machine that runs, fed sample by sample."""

    def __init__(self, limits: CheckLimits = RING, speed_rpm: float | None = 3000.0) -> None:
        self.registry = CollectorRegistry()
        self.checks = QualityChecks({("a", "t_x_c"): limits}, self.registry)
        if speed_rpm is not None:
            self.checks.judge([Sample("a", "speed_rpm", 0, speed_rpm, Quality.GOOD, 0)])

    def feed(self, *rows: tuple[float, float], received_s: float | None = None) -> list[int]:
        """Qualities of (seconds, value), received when they were measured."""
        samples = [
            Sample("a", "t_x_c", round(t * S), v, 192, round((received_s or t) * S))
            for t, v in rows
        ]
        judged = self.checks.judge(samples)
        assert [(one.time_us, one.value) for one in judged] == [
            (one.time_us, one.value) for one in samples
        ], "time and value are never touched"
        return [one.quality for one in judged]

    @property
    def reason(self) -> str:
        return self.checks.reason("a", "t_x_c")

    def count(self, reason: str) -> float:
        labels = {"asset": "a", "channel": "t_x_c", "reason": reason}
        return self.registry.get_sample_value("bearing_twin_samples_doubted_total", labels) or 0.0


def ramp(start: float, per_s: float, seconds: Iterable[int]) -> list[tuple[float, float]]:
    return [(t, start + per_s * t) for t in seconds]


def test_every_reason_is_counted_from_the_start() -> None:
    registry = Line().registry
    for reason in REASONS:
        labels = {"asset": "", "channel": "", "reason": reason}
        assert registry.get_sample_value("bearing_twin_samples_doubted_total", labels) == 0.0


def test_a_plausible_machine_passes_untouched() -> None:
    line, noise = Line(), random.Random(1)
    rows = [(t, round(20 + 0.5 * t + noise.gauss(0, 0.1), 1)) for t in range(1, 200)]
    samples = [Sample("a", "t_x_c", round(t * S), v, 192, round(t * S)) for t, v in rows]
    assert line.checks.judge(samples) is samples, "nothing is copied where nothing is found"
    assert line.reason == ""


def test_a_spike_is_uncertain_and_what_follows_is_good() -> None:
    line = Line()
    assert line.feed((1, 50), (2, 50.1), (3, 85), (4, 50.2)) == [192, 192, 80, 192]
    assert line.count("jump") == 1
    assert line.feed((5, 15)) == [80]
    assert "jumped" in line.reason
    assert line.feed((6, 50.3)) == [192]
    assert line.reason == ""


def test_a_new_level_is_believed_once_three_samples_agree() -> None:
    line = Line()
    assert line.feed((1, 50), (2, 80), (3, 80.1), (4, 80.2), (5, 80.1)) == [192, 80, 80, 192, 192]
    # A broken contact that shows another value every time is never believed.
    wild = [(6 + n, (10, 150, 40, 190)[n % 4]) for n in range(12)]
    assert set(line.feed(*wild)) == {80}


def test_a_gap_gives_a_temperature_time_to_move() -> None:
    line = Line()
    assert line.feed((1, 90), (601, 30)) == [192, 192]


def test_a_value_that_runs_away_is_uncertain_until_it_stops() -> None:
    line = Line()
    qualities = line.feed(*ramp(20, 3.0, range(1, 41)))
    assert set(qualities[12:]) == {64}
    assert "faster than 2 per second" in line.reason
    held = line.feed(*((t, 143.0) for t in range(41, 80)))
    assert is_good(held[-1]), "a rate that has ended is past"
    assert line.count("rate") >= 25


def test_a_frozen_value_is_uncertain_while_the_machine_runs() -> None:
    line = Line()
    qualities = line.feed(*((t, 63.4) for t in range(1, 100)))
    assert set(qualities[:59]) == {192}
    assert set(qualities[62:]) == {int(Quality.FROZEN)}
    assert "frozen" in line.reason
    assert line.feed((100, 63.5)) == [192]


def test_a_machine_that_turns_backwards_turns() -> None:
    line = Line(speed_rpm=-3000.0)
    assert line.feed(*((t, 50.0) for t in range(1, 120)))[-1] == Quality.FROZEN


@pytest.mark.parametrize("speed_rpm", [0.0, None])
def test_at_rest_or_with_unknown_speed_a_value_may_stand_still(speed_rpm: float | None) -> None:
    line = Line(speed_rpm=speed_rpm)
    assert set(line.feed(*((t, 20.0) for t in range(1, 300)))) == {192}


def test_a_clock_that_is_set_forward_freezes_nothing() -> None:
    line = Line()
    assert line.feed((1, 50), (2, 50), (7200, 50), (7201, 50)) == [192] * 4


def test_a_clock_that_is_set_back_begins_a_new_line() -> None:
    line = Line()
    line.feed((7200, 90), (7201, 90))
    assert line.feed((1, 30), (2, 30.1), (3, 70)) == [192, 192, 80]


def test_a_sample_sent_again_is_judged_as_the_first_time() -> None:
    line = Line()
    line.feed((1, 50), (2, 50), (3, 85), (4, 50))
    assert line.feed((3, 85), (2, 50), received_s=5) == [80, 192]
    assert line.feed((1.5, 500), received_s=5) == [84], "late: only its range can be judged"
    assert line.feed((5, 50.1)) == [192]


def test_what_a_source_calls_bad_stays_as_it_is_and_spoils_nothing() -> None:
    line = Line()
    line.feed((1, 50))
    bad = Sample("a", "t_x_c", 2 * S, math.nan, int(Quality.SENSOR_FAILURE), 2 * S)
    assert line.checks.judge([bad]) == [bad]
    assert line.feed((3, 50.2)) == [192]


# ------------------------------------------------------------------ which channel is checked how
def wired(**channels: dict[str, object]) -> dict[tuple[str, str], CheckLimits]:
    source = {"name": "p", "driver": "modbus-tcp", "host": "127.0.0.1", "port": 5020}
    asset = asset_table("a") | {"channels": channels}
    settings = Settings.model_validate({"sources": [source], "assets": [asset]})
    return wire(settings).check_limits


def test_every_channel_is_checked_by_what_its_machine_can_do() -> None:
    def modbus(**keys: object) -> dict[str, object]:
        return {"source": "p", "register": 0, "scale": 0.1} | keys

    limits = wired(
        t_inner_ring_c=modbus(),
        t_outer_ring_c=modbus(register=1, max_jump=0, flat_line_s=0, max_rate_per_s=0.5),
        t_node_1_c=modbus(register=2, scale=1.0),
        ambient_c={"source": "push", "valid_range": [-40, 60]},
        speed_rpm=modbus(register=4),
        load_n=modbus(register=5, max_jump=500, flat_line_s=30),
    )
    infinite = math.inf
    assert limits["a", "t_inner_ring_c"] == CheckLimits(-80.0, 600.0, 5.0, 2.0, 1800.0)
    outer = CheckLimits(-80.0, 600.0, max_rate_per_s=0.5)
    assert limits["a", "t_outer_ring_c"] == outer
    assert limits["a", "t_node_1_c"].flat_line_s == infinite, "whole degrees may stand still"
    assert limits["a", "ambient_c"] == CheckLimits(-40.0, 60.0, 5.0, 2.0)
    fastest_rpm = 2e6 / 87.5
    assert limits["a", "speed_rpm"] == CheckLimits(-fastest_rpm, fastest_rpm)
    assert limits["a", "load_n"] == CheckLimits(-2250.0, 90_000.0, max_jump=500.0, flat_line_s=30.0)


@pytest.mark.parametrize("wrong", [{"max_jump": -1}, {"flat_line_s": "long"}, {"register": 3}])
def test_a_wrong_check_is_refused_by_name(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=rf"assets\[0\].channels.ambient_c.*{min(wrong)}"):
        wired(ambient_c={"source": "push"} | wrong)
