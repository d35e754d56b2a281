"""What the service says of its forecasts, against what this test computes from its exports alone.

A virtual bench runs its plan, waits against it for a while, and the service is killed in the
middle. Nothing of the ledger's own code is used here.
"""

import bisect
import time
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest
from processes import Site, wait_until
from pymodbus.client import ModbusTcpClient

from service.clock import from_rfc3339
from service.demo.configuration import ASSET
from service.demo.run import HOLD_COIL

pytestmark = [pytest.mark.wires, pytest.mark.endurance]

RATE = 600.0
A = f"/api/v1/assets/{ASSET}"
RINGS = ("t_inner_ring_c", "t_outer_ring_c")
OPERATION = ("speed_rpm", "load_n")
QUANTILES = ("q025", "q25", "q50", "q75", "q975")
MINUTE_S = 60.0
#: What a reading says of what came.
CAME = ("state", "measured_c", "left", "run_inside")
KILLED_AFTER_WALL_S, HELD_WALL_S, RUN_WALL_S = 9.0, 3.0, 13.0


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with Site(tmp_path_factory.mktemp("site"), "demo", RATE) as site:
        text = site.configuration.read_text()
        site.configuration.write_text(text.replace('ladder = "apply"', 'ladder = "observe"'))
        site.start_bench()
        site.start_service()
        yield site


def kept(site: Site) -> dict[int, dict[str, Any]]:
    """All forecasts of the ledger, by number."""
    items: list[dict[str, Any]] = []
    cursor: dict[str, str] = {}
    while True:
        page = site.get(f"{A}/forecasts", limit=20, **cursor)
        items += page["items"]
        if page["next"] is None:
            break
        cursor = {"cursor": page["next"]}
    found = {item["id"]: item for item in items}
    assert len(found) == len(items)
    return found


def said(forecast: dict[str, Any]) -> dict[str, Any]:
    """What a forecast said, without what came of it."""
    points = [
        {
            **point,
            "readings": [
                {name: value for name, value in one.items() if name not in CAME}
                for one in point["readings"]
            ],
        }
        for point in forecast["points"]
    ]
    return {**forecast, "points": points}


def label_of(labels: list[str]) -> str | None:
    """Labels as one text, without the figures in them."""
    known = ["initial state not well known" if "initial state" in one else one for one in labels]
    return "; ".join(known) or None


def hold(site: Site, on: bool) -> None:
    with ModbusTcpClient("127.0.0.1", port=site.modbus_port) as client:
        assert not client.write_coil(HOLD_COIL, on, device_id=2).isError()


def watch(site: Site, seen: dict[int, Any], live: dict[str, Any], wall_s: float) -> None:
    """Note the forecasts of the ledger as they are first seen, and live ones, for a while."""
    until_s = time.monotonic() + wall_s
    while time.monotonic() < until_s:
        answer = site.client.get(f"{A}/forecast")
        if answer.is_success:
            live[answer.json()["made_at"]] = answer.json()
        for number, item in kept(site).items():
            assert seen.setdefault(number, said(item)) == said(item)
        time.sleep(0.3)


class Series:
    """Good samples of a channel, as the service exports them."""

    def __init__(self, site: Site, channel: str) -> None:
        self.times_s: list[float] = []
        self.values: list[float] = []
        cursor: dict[str, str] = {}
        query = {"channel": channel, "start": "2020-01-01T00:00:00Z", "end": "2900-01-01T00:00:00Z"}
        while True:
            page = site.get(f"{A}/measurements", **query, limit=10_000, **cursor)
            for item in page["items"]:
                if item["quality"] >= 192 and item["value"] is not None:
                    self.times_s.append(from_rfc3339(item["time"]) / 1e6)
                    self.values.append(item["value"])
            if page["next"] is None:
                break
            cursor = {"cursor": page["next"]}

    def mean(self, begin_s: float, end_s: float) -> float | None:
        first, last = (bisect.bisect_left(self.times_s, at) for at in (begin_s, end_s))
        values = self.values[first:last]
        return sum(values) / len(values) if values else None

    def at(self, time_s: float) -> float | None:
        """Linear between the means of the two minutes whose middles lie around a time."""
        own_s = time_s // MINUTE_S * MINUTE_S
        off = (time_s - own_s) / MINUTE_S - 0.5
        other_s = own_s + (MINUTE_S if off > 0 else -MINUTE_S)
        own, other = (self.mean(begin_s, begin_s + MINUTE_S) for begin_s in (own_s, other_s))
        value = own if own is None or other is None else own + abs(off) * (other - own)
        return None if value is None else round(value, 3)  # readings lie on bounds now and then


def course(forecast: dict[str, Any], lead_s: float, measured: dict[str, Series]) -> str:
    """Whether the machine did what a forecast assumed, minute by minute as the manual says."""
    made_s = from_rfc3339(forecast["made_at"]) / 1e6
    edges = [0.0]
    for step in forecast["profile"]:
        edges.append(edges[-1] + step["duration_s"])

    def judged(begin_s: float) -> str:
        meant = [
            step
            for number, step in enumerate(forecast["profile"])
            if (number == 0 or made_s + edges[number] < begin_s + 180.0)
            and (
                number == len(forecast["profile"]) - 1 or made_s + edges[number + 1] > begin_s - 120
            )
        ]
        verdict = "ok"
        for name, least in (("speed_rpm", 30.0), ("load_n", 50.0)):
            value = None
            for back in range(6):  # what was last known holds for five minutes
                at_s = begin_s - back * MINUTE_S
                if value is None and at_s >= made_s:
                    value = measured[name].mean(at_s, at_s + MINUTE_S)
            if value is None:
                verdict = "unknown"
                continue
            low, high = (edge(step[name] for step in meant) for edge in (min, max))
            if not low - max(0.05 * low, least) <= value <= high + max(0.05 * high, least):
                return "left"
        return verdict

    begin_s = -(-made_s // MINUTE_S) * MINUTE_S
    minutes = []
    while begin_s + MINUTE_S <= made_s + lead_s:
        minutes.append((begin_s, judged(begin_s)))
        begin_s += MINUTE_S
    found = "followed"
    for span in (minutes, [one for one in minutes if one[0] >= made_s + lead_s - 1800.0]):
        words = [word for _, word in span]
        if words.count("left") > 0.05 * len(words):
            return "left"
        if words.count("unknown") > 0.10 * len(words):
            found = "unknown"
    return found


def test_the_service_answers_for_its_forecasts_as_they_were(site: Site) -> None:
    seen: dict[int, Any] = {}
    live: dict[str, Any] = {}
    wait_until(lambda: site.client.get(f"{A}/forecast").is_success, 60, "a forecast")
    watch(site, seen, live, KILLED_AFTER_WALL_S)
    asked = {"profile": [{"duration_s": 700, "speed_rpm": 900, "load_n": 2650}], "keep": True}
    answer = site.client.post(f"{A}/forecasts", json=asked)
    assert answer.is_success, answer.text
    asked_at = answer.json()["kept_at"]
    assert site.service is not None
    site.service.kill()
    site.start_service()
    after = wait_until(lambda: kept(site), 60, "the ledger after a kill")
    assert {number: said(after[number]) for number in seen} == seen, "nothing is lost"
    assert [one["made_at"] for one in after.values() if one["reason"] == "asked"] == [asked_at]
    hold(site, True)
    watch(site, seen, live, HELD_WALL_S)
    hold(site, False)
    watch(site, seen, live, RUN_WALL_S)

    # Of one moment: nothing was settled between the two answers.
    def at_once() -> tuple[dict[int, Any], dict[str, Any]] | None:
        before = kept(site)
        scores = site.get(f"{A}/forecast-performance")
        return (before, scores) if kept(site) == before else None

    forecasts, performance = wait_until(at_once, 60, "a moment without a change")
    assert performance["forecasts"] == len(forecasts)
    measured = {name: Series(site, name) for name in (*RINGS, *OPERATION)}

    # What is kept is what was shown.
    shown = [one for one in seen.values() if one["made_at"] in live and one["reason"] != "asked"]
    assert shown
    for one in shown:
        document = live[one["made_at"]]
        for point in one["points"]:
            row = document["time_s"].index(point["lead_time_s"])
            for reading in point["readings"]:
                of_node = document["nodes"][reading["channel"]]
                assert all(abs(reading[q] - of_node[q][row]) < 0.011 for q in QUANTILES)

    # Each reading is settled as this test finds it, from the exports alone.
    groups: dict[tuple[Any, ...], list[tuple[dict[str, Any], float]]] = defaultdict(list)
    counts: dict[tuple[Any, ...], dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for forecast in forecasts.values():
        for point in forecast["points"]:
            followed = course(forecast, point["lead_time_s"], measured)
            for reading in point["readings"]:
                key = (
                    reading["channel"],
                    point["lead_time_s"],
                    point["risk"],
                    label_of(forecast["labels"]),
                    forecast["model_version"],
                )
                counts[key][reading["state"]] += 1
                if reading["state"] == "plan":
                    assert followed == "left", (forecast["made_at"], point["lead_time_s"])
                if reading["state"] != "scored":
                    assert reading["measured_c"] is None
                    continue
                assert followed == "followed", (forecast["made_at"], point["lead_time_s"])
                due_s = from_rfc3339(point["time"]) / 1e6
                value = measured[reading["channel"]].at(due_s)
                assert value is not None
                assert abs(value - reading["measured_c"]) < 0.002
                groups[key].append((reading, value))
    states: dict[str, int] = defaultdict(int)
    for of_key in counts.values():
        for state, count in of_key.items():
            states[state] += count
    assert states["scored"] >= 40, dict(states)
    assert states["plan"] >= 4, dict(states)

    # And what the service reports of them is so.
    told = {
        tuple(
            item[name] for name in ("channel", "lead_time_s", "risk", "label", "model_version")
        ): item
        for item in performance["items"]
    }
    assert told.keys() == counts.keys()
    for key, item in told.items():
        readings = groups[key]
        assert item["n"] == len(readings) == counts[key]["scored"]
        assert item["set_aside_by"]["plan"] == counts[key]["plan"]
        assert item["waiting"] == counts[key]["waiting"]
        if not readings:
            assert item["coverage_95"] is None
            continue
        for name, low, high in (("coverage_95", "q025", "q975"), ("coverage_50", "q25", "q75")):
            covered = [one[low] <= value <= one[high] for one, value in readings]
            assert abs(item[name] - sum(covered) / len(covered)) <= 0.01, (key, name)
        errors = [one["q50"] - value for one, value in readings]
        assert abs(item["bias_k"] - sum(errors) / len(errors)) < 0.02
        assert abs(item["mae_k"] - sum(map(abs, errors)) / len(errors)) < 0.02
        held = [abs(one["naive"]["persistence"] - value) for one, value in readings]
        assert abs(item["naive"]["persistence"]["mae_k"] - sum(held) / len(held)) < 0.02
