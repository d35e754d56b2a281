"""What devices and wires can do to a running service: each number that was sent is stored once."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from faults.conftest import FULL, SHORT, Extent
from faults.hall import BASE, CAN, MODBUS, Count, Hall, Outcome
from faults.peers import EXCEPTION, FLOOD, GARBAGE, LATE, NORMAL, POISON, WRONG
from processes import wait_until

from service.demo.configuration import ASSET
from service.live.asset import STEP_S

pytestmark = [pytest.mark.wires, pytest.mark.timeout(0)]

CODES = {SHORT: (2, 6, 11), FULL: (1, 2, 3, 4, 5, 6, 7, 8, 10, 11)}
FLOOD_PER_S = 2000


Tell = Callable[[Outcome], None]


def survive(
    hall: Hall,
    fault: str,
    source: str,
    cause: Callable[[], None],
    end: Callable[[], None],
    extent: Extent,
    *,
    down: bool = True,
    lost: int = 0,
) -> Outcome:
    """Let something happen to one source; the rest goes on, and then all of it again."""
    skipped = hall.metrics()["samples_skipped_total"]
    hall.begin()
    twin_time = hall.tags()["t_node_7_c.twin"]["time"]
    cause()
    began = time.monotonic()
    if down:
        wait_until(
            lambda: hall.checks()[f"source:{source}"] == "degraded",
            60,
            "readiness names the source",
        )
        others = {"pt100", "drive"} - {source}
        assert {hall.checks()[f"source:{name}"] for name in others} == {"ok"}
        assert hall.checks()["store"] == "ok"
    time.sleep(max(0.0, began + extent.outage_s - time.monotonic()))
    if extent.outage_s > 2 * STEP_S:
        assert hall.tags()["t_node_7_c.twin"]["time"] > twin_time, "the twin goes on"
    end()
    back_s = hall.recover()
    counts = hall.counts()
    total = sum(counts.values(), Count())
    assert total.duplicates == 0
    assert total.in_order
    assert counts["push"].missing == 0
    of_source = counts["Modbus" if source == "pt100" else "CAN"]
    other = counts["CAN" if source == "pt100" else "Modbus"]
    assert other.missing == 0, "the other wire loses nothing"
    assert of_source.missing <= lost, "at most what was on its way when the wire broke"
    assert hall.metrics()["samples_skipped_total"] == skipped
    return Outcome(fault, total, 0, [back_s])


def no_poison(hall: Hall) -> None:
    with hall.open_store() as store:
        rows = store.samples.read(ASSET, [MODBUS, CAN], 0, 2**62, 10**7)
    values = [one.value for one in rows if one.value is not None]
    assert max(values) < BASE + POISON / 2000
    assert min(values) >= BASE


@pytest.mark.parametrize("source", ["pt100", "drive"])
def test_a_device_is_killed(hall: Hall, source: str, extent: Extent, tell: Tell) -> None:
    peer, name, lost = (
        (hall.modbus, "Modbus server", 1) if source == "pt100" else (hall.can, "CAN peer", 20)
    )
    tell(survive(hall, f"{name} killed", source, peer.kill, peer.start, extent, lost=lost))


@pytest.mark.endurance
@pytest.mark.parametrize("source", ["pt100", "drive"])
def test_a_device_is_frozen(hall: Hall, source: str, extent: Extent, tell: Tell) -> None:
    peer, name, lost = (
        (hall.modbus, "Modbus server", 1) if source == "pt100" else (hall.can, "CAN peer", 20)
    )
    tell(
        survive(
            hall,
            f"{name} frozen",
            source,
            lambda: peer.send_signal(signal.SIGSTOP),
            lambda: peer.send_signal(signal.SIGCONT),
            extent,
            lost=lost,
        )
    )


@contextmanager
def ordered(hall: Hall, device: str) -> Iterator[Callable[..., Callable[[], None]]]:
    state = hall.states[device]
    yield lambda *order: lambda: state.order(*order)
    state.order(NORMAL)


@pytest.mark.endurance
@pytest.mark.parametrize(
    ("device", "fault", "orders", "counted"),
    [
        pytest.param("modbus", "Modbus answers too late", (LATE, 700), (), id="late"),
        pytest.param("modbus", "Modbus answers garbage", (GARBAGE,), (), id="garbage"),
        pytest.param(
            "can",
            f"CAN bus flooded, {2 * FLOOD_PER_S} frames/s, half of them unknown",
            (FLOOD, FLOOD_PER_S),
            (),
            id="flooded",
        ),
        pytest.param(
            "can",
            "CAN frames of wrong length and unknown id between the good ones",
            (WRONG,),
            ("wrong_length", "unknown_id"),
            id="wrong frames",
        ),
    ],
)
def test_a_device_sends_what_it_should_not(
    hall: Hall,
    device: str,
    fault: str,
    orders: tuple[int, ...],
    counted: tuple[str, ...],
    extent: Extent,
    tell: Tell,
) -> None:
    source = {"modbus": "pt100", "can": "drive"}[device]
    is_down = device == "modbus"
    with ordered(hall, device) as order:
        begin, end = order(*orders), order(NORMAL)
        tell(survive(hall, fault, source, begin, end, extent, down=is_down))
    if device == "modbus":
        no_poison(hall)
    errors = hall.metrics_by_label("source_errors_total") if counted else {}
    for kind in counted:
        assert errors[f'kind="{kind}",source="{source}"'] > 0


@pytest.mark.endurance
def test_the_modbus_server_refuses(hall: Hall, extent: Extent, tell: Tell) -> None:
    rows = []
    for code in CODES[extent]:
        each = Extent(min(extent.outage_s, 5.0) / 2, 0)
        with ordered(hall, "modbus") as order:
            rows.append(
                survive(hall, "", "pt100", order(EXCEPTION, code), order(NORMAL), each, down=False)
            )
    codes = ", ".join(map(str, CODES[extent]))
    tell(
        Outcome(
            f"Modbus exceptions {codes}",
            sum((row.count for row in rows), Count()),
            recoveries_s=[row.recoveries_s[0] for row in rows],
        )
    )
    no_poison(hall)


STAGES = (
    "source_polls_total",
    "source_samples_total",
    "source_skipped_total",
    "source_reconnects_total",
    "source_errors_total",
    "source_up",
    "poll_seconds_count",
    "samples_accepted_total",
    "samples_stored_total",
    "samples_skipped_total",
    "samples_duplicate_total",
    "samples_late_total",
    "queue_samples",
    "spool_samples",
    "spool_bytes",
    "spool_age_seconds",
    "store_write_seconds_count",
    "store_write_seconds_sum",
    "clock_steps_total",
)


@pytest.mark.endurance
def test_metrics_show_every_stage(hall: Hall) -> None:
    before = hall.metrics()
    assert set(STAGES) <= set(before)
    assert set(hall.metrics_by_label("source_up")) == {'source="pt100"', 'source="drive"'}
    moving = ("source_polls_total", "source_samples_total", "poll_seconds_count",
              "samples_stored_total", "store_write_seconds_count")  # fmt: skip
    wait_until(
        lambda: all(now[name] > before[name] for now in [hall.metrics()] for name in moving),
        20,
        "figures that move",
    )
    assert 0 < before["store_write_seconds_sum"] < 600


@pytest.mark.endurance
def test_readiness_names_the_source_that_is_down_and_says_why(hall: Hall) -> None:
    hall.modbus.kill()
    try:
        detail = wait_until(
            lambda: found if (found := hall.details()["source:pt100"]) != "ok" else None,
            60,
            "readiness names the source",
        )
        assert "cannot connect to 127.0.0.1" in detail or "connection" in detail, detail
        assert hall.details()["source:drive"] == "ok"
    finally:
        hall.modbus.start()
        hall.recover()
