"""A device that says good and is wrong: what it says is kept, shown with a reason, never used."""

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import pytest
from faults.hall import CAN, Hall
from faults.peers import NORMAL, SPIKE_K, SPIKES, STUCK
from processes import wait_until

from service.demo.configuration import ASSET
from service.store.records import StoredSample

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

RING = "t_inner_ring_c"


def stored(hall: Hall, from_s: float) -> list[StoredSample]:
    """What came since then: the tests before may have left other qualities."""
    with hall.open_store() as store:
        return store.samples.read(ASSET, [RING], round(from_s * 1e6), 2**62, 10**7)


def reason(hall: Hall) -> str | None:
    channels = hall.get(f"/api/v1/assets/{ASSET}")["channels"]
    found: str | None = next(one["reason"] for one in channels if one["name"] == RING)
    return found


@pytest.fixture
def ordered(hall: Hall) -> Iterator[Callable[[int], None]]:
    yield hall.states["modbus"].order
    hall.states["modbus"].order(NORMAL)


def test_spikes_of_a_loose_contact_never_reach_the_twin(
    hall: Hall, ordered: Callable[[int], None]
) -> None:
    assert reason(hall) is None
    began_s = time.time()
    ordered(SPIKES)
    label = f'asset="{ASSET}",channel="{RING}",reason="jump"'
    wait_until(
        lambda: hall.metrics_by_label("samples_doubted_total").get(label, 0) >= 30, 60, "spikes"
    )
    assert hall.tag(f"{RING}.twin") == pytest.approx(60.0, abs=2.0), "a fifth of the spikes is 8 K"
    ordered(NORMAL)
    hall.recover()
    rows = stored(hall, began_s)
    spikes = [one for one in rows if one.value is not None and one.value > 60 + SPIKE_K / 2]
    assert len(spikes) >= 20
    assert {one.quality for one in spikes} == {80}
    assert {one.quality for one in rows if one.value is not None and one.value < 61} == {192}
    averages = hall.get(
        f"/api/v1/assets/{ASSET}/measurements",
        channel=RING, start=datetime.fromtimestamp(began_s, UTC).isoformat(),
        end="2040-01-01T00:00:00Z", resolution="1min",
    )["items"]  # fmt: skip
    assert all(one["mean"] < 61 for one in averages if one["mean"] is not None), averages


def test_a_frozen_register_is_noticed_and_the_alarm_says_why(
    hall: Hall, ordered: Callable[[int], None]
) -> None:
    assert hall.tag(CAN) > 1000, "the machine turns"
    began_s = time.time()
    ordered(STUCK)
    why = wait_until(lambda: reason(hall), 30, "a reason in the asset's health")
    assert "frozen" in why
    tag = hall.tags()[RING]
    assert (tag["quality"], tag["value"]) == (83, 60.0), "uncertain, and the value is still shown"
    wait_until(lambda: hall.checks()[f"twin:{ASSET}"] == "degraded", 30, "readiness names the twin")

    def message() -> str | None:
        alarms = hall.get("/api/v1/alarms")["items"]
        return next((one["message"] for one in alarms if one["kind"] == "sensor fault"), None)

    assert "frozen" in wait_until(message, 60, "an alarm of the sensor")
    ordered(NORMAL)
    hall.recover()
    assert reason(hall) is None
    assert 83 in {one.quality for one in stored(hall, began_s)}
