"""What an OPC UA server may say, and what becomes of it."""

import datetime as dt
import math
from typing import Any

import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from adapters.configuration import ConfigurationError
from adapters.drivers.opcua.codes import has_overflown, quality_of, status_code
from adapters.drivers.opcua.config import OpcUaChannel, OpcUaSource, check
from adapters.drivers.opcua.values import (
    STANDS,
    FollowedNode,
    NodeReading,
    compared,
    microseconds,
    moment_of,
    reading_of,
)
from adapters.protocol import ChannelBinding, PlanBinding
from adapters.samples import Quality, is_bad, is_good

NOW_US = 1_800_000_000_000_000
LOCAL = {"name": "plc", "endpoint": "opc.tcp://127.0.0.1:4840/plc"}


@given(st.sampled_from(Quality), st.integers(0, 3))
def test_every_quality_comes_back_from_its_status_code(quality: Quality, limits: int) -> None:
    byte = (int(quality) & ~3) | limits
    assert quality_of(status_code(byte)) == byte


@given(st.integers(0, 2**32 - 1))
def test_no_status_code_becomes_better_than_its_severity(code: int) -> None:
    quality = quality_of(code)
    assert 0 <= quality <= 255
    severity = code >> 30
    assert is_good(quality) == (severity == 0)
    assert is_bad(quality) == (severity >= 2)
    assert not has_overflown(code) or code & 0xC00 == 0x400


moments = st.none() | st.datetimes(
    dt.datetime(1601, 1, 1), dt.datetime(2200, 1, 1), timezones=st.none() | st.just(dt.UTC)
)
raw = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64)
    | st.floats()
    | st.text(max_size=5)
    | st.binary(max_size=5)
    | st.lists(st.floats(), max_size=3)
    | st.datetimes()
)


@given(raw, st.integers(0, 2**32 - 1), moments, moments, st.sampled_from([1.0, -0.1, 1e300]))
def test_a_value_is_good_only_if_all_of_it_is(
    value: Any, code: int, source: Any, server: Any, scale: float
) -> None:
    config = OpcUaChannel(source="plc", node="i=1", scale=scale, valid_range=(-1e6, 1e6))
    found = ua.DataValue(
        Value=None if value is None else _Value(value),
        StatusCode=ua.StatusCode(code),
        SourceTimestamp=source,
        ServerTimestamp=server,
    )
    reading = reading_of(found, config, NOW_US)
    assert is_bad(reading.quality) == math.isnan(reading.value)
    assert (reading.kind == "") == (reading.reason == "") == is_good(reading.quality)
    assert reading.time_us <= NOW_US + 5_000_000
    assert reading.source_us == microseconds(source)
    assert (reading.ahead_s > 5.0) == ((microseconds(source) or 0) > NOW_US + 5_000_000)
    if is_good(reading.quality):
        assert code >> 30 == 0
        assert reading.value == float(value) * scale
        assert abs(reading.value) <= 1e6
        assert reading.time_us == microseconds(source)


def judged(readings: list[tuple[int, float, int]]) -> list[tuple[int, bool]]:
    """Qualities of readings of one node (time, value, quality), and whether each is sent again."""
    point = FollowedNode("a", "load_n", OpcUaChannel(source="plc", node="i=1"))
    found = []
    for time_us, value, quality in readings:
        reading = NodeReading(time_us, value, quality, "", "", False, (value, quality))
        one, is_same = compared(reading, point, time_us)
        assert (one.reason == STANDS) == (one.quality == Quality.UNCERTAIN)
        found.append((one.quality, is_same))
    return found


def test_a_time_that_stands_still_dates_no_change() -> None:
    good, lost = int(Quality.GOOD), int(Quality.COMM_FAILURE)
    doubted = int(Quality.UNCERTAIN)
    readings = [
        (1, 20.0, good), (1, 20.0, good), (2, 20.0, good), (2, 21.0, good), (2, 21.0, good),
        (2, math.nan, lost), (2, math.nan, lost), (2, 21.0, good), (3, 21.0, good), (3, 21.0, good),
    ]  # fmt: skip
    assert judged(readings) == [
        (good, False), (good, True), (good, False), (doubted, False), (doubted, True),
        (lost, False), (lost, True), (doubted, False), (good, False), (good, True),
    ]  # fmt: skip


def test_a_value_whose_clock_is_ahead_stays_uncertain_until_it_changes() -> None:
    point = FollowedNode("a", "load_n", OpcUaChannel(source="plc", node="i=1"))

    def read(value: float, source_s: float, now_s: float) -> tuple[float, int, float]:
        moment = moment_of(NOW_US + round(source_s * 1e6))
        found = ua.DataValue(Value=ua.Variant(value), SourceTimestamp=moment)
        now_us = NOW_US + round(now_s * 1e6)
        reading, _ = compared(reading_of(found, point.config, now_us), point, now_us)
        return (reading.time_us - NOW_US) / 1e6, reading.quality, reading.ahead_s

    assert read(1.0, 280.0, 0.0) == (0.0, 64, 280.0)
    for now_s in (5.0, 100.0, 276.0, 290.0):  # read again, and unchanged
        assert read(1.0, 280.0, now_s) == (now_s, 64, 280.0)
    assert point.problem == ""
    assert read(2.0, 581.0, 300.0) == (300.0, 64, 280.0), "the same text while it is about the same"
    assert read(4.0, 400.0, 450.0) == (400.0, 64, 280.0), "changed while the connection was lost"
    assert read(3.0, 460.0, 461.0) == (460.0, 192, 0.0)


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from([1.0, 2.0]), st.just(192))))
def test_no_change_is_dropped_and_none_is_good_at_a_time_of_another_value(
    readings: list[tuple[int, float, int]],
) -> None:
    found = judged([(1 + time_us, value, quality) for time_us, value, quality in readings])
    for k in range(1, len(readings)):
        quality, is_same = found[k]
        assert is_same == (readings[k] == readings[k - 1])
        if readings[k] != readings[k - 1] and readings[k][0] == readings[k - 1][0]:
            assert quality == Quality.UNCERTAIN


class _Value:
    """A variant that takes whatever a server may send."""

    def __init__(self, value: Any) -> None:
        self.Value = value


@given(st.integers(946_684_800_000_000, 4_000_000_000_000_000))
def test_times_come_back(time_us: int) -> None:
    assert microseconds(moment_of(time_us)) == time_us


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"endpoint": "http://127.0.0.1/"}, "opc.tcp://HOST:PORT"),
        ({"endpoint": "opc.tcp://a:b@127.0.0.1:4840"}, "no user in the address"),
        ({"endpoint": "opc.tcp://plc.example.com:4840"}, "outside this machine"),
        ({"endpoint": "opc.tcp://192.0.2.1:4840"}, "outside this machine"),
        ({"security_policy": "Basic256Sha256"}, "needs server_certificate, certificate"),
        ({"certificate": "client.der"}, "certificates need security_policy"),
        ({"user": "twin"}, "user and password_variable"),
    ],
)
def test_wrong_settings_say_what_is_expected(changed: dict[str, str], expected: str) -> None:
    with pytest.raises(ValidationError, match=expected):
        OpcUaSource.model_validate({**LOCAL, **changed})


@pytest.mark.parametrize("node", ["TIC101", "ns=x;s=a", "ns=2;i=abc", "ns=2;s=", "nsu=;s=a"])
def test_a_wrong_node_id_is_refused(node: str) -> None:
    with pytest.raises(ValidationError, match="expected a node id"):
        OpcUaChannel(source="plc", node=node)


def test_what_is_missing_is_said_before_anything_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PLC_PASSWORD", raising=False)
    channel = ChannelBinding("bench", "load_n", OpcUaChannel(source="plc", node="i=1"))
    settings = {**LOCAL, "user": "twin", "password_variable": "PLC_PASSWORD"}
    with pytest.raises(ConfigurationError, match=r"'PLC_PASSWORD'.* is not set"):
        check(OpcUaSource.model_validate(settings), [channel], [])
    with pytest.raises(ConfigurationError, match="a plan needs a Modbus source"):
        check(OpcUaSource.model_validate(LOCAL), [], [PlanBinding("bench", channel.config)])
    files = dict.fromkeys(("server_certificate", "certificate", "private_key"), "gone.der")
    settings = {**LOCAL, "security_policy": "Basic256Sha256", **files}
    with pytest.raises(ConfigurationError, match=r"gone\.der' cannot be read: No such file"):
        check(OpcUaSource.model_validate(settings), [channel], [])
