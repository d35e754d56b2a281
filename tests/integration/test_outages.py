"""The bench, then the service, are killed and started again in the middle of a run."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import Site, wait_until

from service.demo.configuration import ASSET
from service.store.records import StoredSample

pytestmark = [pytest.mark.wires, pytest.mark.timeout(600), pytest.mark.endurance]

RATE = 60.0
MODBUS_CHANNEL, CAN_CHANNEL = "t_inner_ring_c", "speed_rpm"


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with Site(tmp_path, "staircase", RATE) as site:
        yield site


def sources(site: Site) -> dict[str, bool]:
    checks = site.client.get("/readyz").json()["checks"]
    return {check["name"]: check["ok"] for check in checks}


def good_now(site: Site) -> bool:
    tags = site.tags()
    return all(tags[name]["quality"] >= 192 for name in (MODBUS_CHANNEL, CAN_CHANNEL))


def samples(site: Site, channel: str) -> list[StoredSample]:
    with site.open_store() as store:
        return store.samples.read(ASSET, [channel], 0, 2**62, 1_000_000)


def test_everything_comes_back_by_itself(site: Site) -> None:
    site.start_bench()
    site.start_service()
    wait_until(lambda: good_now(site), 30, "good values from both wires")
    wait_until(lambda: site.tag("t_node_7_c.twin"), 30, "a running twin")

    # --- the bench loses power
    assert site.bench is not None
    site.bench.kill()
    outages_us = [site.now_us()]
    wait_until(
        lambda: all(
            site.tags()[name]["quality"] < 64 and site.tags()[name]["value"] is None
            for name in (MODBUS_CHANNEL, CAN_CHANNEL)
        ),
        30,
        "no value of a dead bench is shown as live",
    )
    twin_alone = site.tag("t_node_7_c.twin")
    assert twin_alone is not None
    time.sleep(2.0)  # long enough to be told from a hiccup
    site.start_bench()
    wait_until(lambda: good_now(site), 30, "both wires good again")
    down_us = samples(site, CAN_CHANNEL)[-1].time_us
    for channel in (MODBUS_CHANNEL, CAN_CHANNEL):
        wait_until(
            lambda channel=channel: samples(site, channel)[-1].time_us > down_us + 60_000_000,
            30,
            "samples stored after the bench came back",
        )

    # --- the service loses power
    before_us = samples(site, CAN_CHANNEL)[-1].time_us
    assert site.service is not None
    site.service.kill()
    outages_us.append(site.now_us())
    site.start_service()
    wait_until(lambda: good_now(site), 30, "good values after the restart")
    wait_until(lambda: site.tag("t_node_7_c.twin"), 30, "a running twin after the restart")
    wait_until(
        lambda: samples(site, CAN_CHANNEL)[-1].time_us > before_us + 60_000_000,
        30,
        "new samples in the store",
    )
    assert site.tag("model.version") == 1
    assert site.service.terminate() == 0
    assert site.bench.terminate() == 0

    for channel in (MODBUS_CHANNEL, CAN_CHANNEL):
        stored = samples(site, channel)
        times = [sample.time_us for sample in stored]
        assert len(times) == len(set(times)), "no sample twice"
        bad = [sample for sample in stored if sample.quality < 64]
        assert all(sample.value is None for sample in bad)
        # Both outages are marked: a bad sample lies between the good ones before and after.
        good = [sample.time_us for sample in stored if sample.quality >= 192]
        for outage_us in outages_us:
            start_us = max(time_us for time_us in good if time_us <= outage_us)
            end_us = min(time_us for time_us in good if time_us > outage_us)
            assert any(start_us < sample.time_us < end_us for sample in bad)


def test_sigterm_in_the_middle_loses_nothing(site: Site) -> None:
    site.start_bench()
    site.start_service()
    wait_until(lambda: good_now(site), 30, "good values from both wires")
    shown = wait_until(
        lambda: site.tags() if site.tag("t_node_7_c.twin") else None, 30, "a running twin"
    )
    assert site.service is not None
    assert site.service.terminate() == 0, site.service.log.read_text()[-2000:]
    # What a client had been shown before the stop is in the store after it.
    for channel in (MODBUS_CHANNEL, CAN_CHANNEL):
        values = {
            round(sample.value, 6) for sample in samples(site, channel) if sample.value is not None
        }
        assert round(shown[channel]["value"], 6) in values
