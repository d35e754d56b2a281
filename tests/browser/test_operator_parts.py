"""Parts of the operator's view: what is not known, what is measured, the first hour, the past."""

from typing import Any

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser


def test_an_estimate_that_says_nothing_has_no_figure_and_no_heat(parts: Page) -> None:
    shown = run(
        parts,
        """
        const { Section } = await import('/js/operator/section.js');
        const { place } = await import('/js/parts/panel.js');
        const box = document.createElement('div');
        place(box, Section, { nodes: { 1: 32, 3: 105, 4: 61, 7: 22 }, unknown: [3, 4],
          spreads: { 1: 0.5, 3: 15, 4: 15, 7: 1 }, measured: { 4: { value: 61, usable: true } },
          alerts: {}, stale: false });
        const part = (n) => box.querySelector(`[data-node='${n}']`).style.fill;
        return [1, 3, 4].map((n) =>
          [box.querySelector(`[data-figure='${n}']`).textContent, part(n)]);
        """,
    )
    (housing, _), (balls, hatched), (ring, heat) = shown
    assert (housing, balls, ring) == ("32.0", "not known", "61.0")
    assert "unknown" in hatched
    assert "color-mix" in heat, "a measured node keeps its heat, whatever the twin knows"


def test_every_measured_node_has_the_ring_of_the_legend(parts: Page) -> None:
    rings = run(
        parts,
        """
        const { Section } = await import('/js/operator/section.js');
        const { place } = await import('/js/parts/panel.js');
        const box = document.createElement('div');
        const reading = { value: 40, usable: true };
        place(box, Section, { nodes: {}, spreads: {}, unknown: [], alerts: {}, stale: false,
          measured: { 2: reading, 4: reading, 5: reading, 13: reading, 14: reading,
            8: { value: 40, usable: false } } });
        const pins = [...box.querySelectorAll('[data-pin]')];
        return pins.filter((pin) => pin.classList.contains('ring') && pin.style.display !== 'none')
          .map((pin) => [Number(pin.dataset.pin), pin.classList.contains('st')]);
        """,
    )
    assert sorted(rings) == [
        [2, False], [4, False], [5, False], [8, True], [13, False], [14, False],
    ]  # fmt: skip


def test_tiles_of_an_own_network_hatch_what_is_not_known(parts: Page) -> None:
    shown = run(
        parts,
        """
        const { NodeTiles } = await import('/js/operator/nodes.js');
        const { place } = await import('/js/parts/panel.js');
        const box = document.createElement('div');
        place(box, NodeTiles, { nodes: { t_oil_c: 105 }, spreads: { t_oil_c: 15 },
          unknown: ['t_oil_c'], measured: {}, alerts: {}, stale: false });
        return ['[data-figure]', 'li i'].map((one) => box.querySelector(one))
          .map((one, i) => (i ? one.className : one.textContent));
        """,
    )
    assert shown == ["not known", "hatch"]


FIRST = """
const { FirstData, isWaiting } = await import('/js/operator/first_data.js');
const { place } = await import('/js/parts/panel.js');
const asset = { channels: [
  { name: 't_inner_ring_c', source: 'pt100' }, { name: 't_inner_ring_c.twin', source: 'twin' },
  { name: 'speed_rpm', source: 'push' }, { name: 'load_n', source: 'push' } ] };
const tags = Object.fromEntries(asset.channels.map(({ name }) =>
  [name, { quality: 32, goodValue: name === spoken ? 21 : null }]));
const state = { asset, tags, link: { status: 'live' },
  verdict: { missing: ['ambient_c', 'load_n'] },
  sources: [{ name: 'pt100', up: false, detail: 'connection refused' }] };
if (!isWaiting(state)) return null;
const clock = { now: () => Date.parse('2026-11-22T08:00:00.000Z') };
const box = document.createElement('div');
place(box, FirstData, { state, clock, assetId: 'bench 1' });
return box.textContent;
"""


def test_the_first_hour_says_what_is_missing_and_how_to_send_it(parts: Page) -> None:
    text: str = run(parts, FIRST, spoken=None)
    for said in (
        "Waiting for first data",
        "pt100: connection refused",
        "push: no values posted yet",
        "Ambient (ambient_c): no channel is configured",
        'curl -H "X-API-Key: $KEY"',
        '{"samples":[{"channel":"speed_rpm","time":"2026-11-22T08:00:00.000Z"',
        "/api/v1/assets/bench%201/measurements",
        "bearing-twin keys create --role gateway",
    ):
        assert said in text, said
    assert run(parts, FIRST, spoken="speed_rpm") is None


def detail(parts: Page, **facts: Any) -> str:
    text: str = run(
        parts,
        """
        const { detailText } = await import('/js/alarms/alarm.js');
        return detailText(alarm, { nowMs: Date.parse('2026-11-22T10:00:00.000Z'),
          value: () => 36.3, crossing: () => crossing });
        """,
        alarm={
            "id": "1", "kind": "measured limit", "state": "UNACK", "priority": 2, "unit": "°C",
            "channel": "t_inner_ring_c", "limit_level": "warning", "predicted": False,
            "raised_at": "2026-11-22T08:00:00.000Z", "returned_at": None, "value": 70.3,
        } | facts,
        crossing={"probability": 0.6, "median": 3600, "earliest": 1200},
    )  # fmt: skip
    return text.replace("\u00a0", " ")


def test_banner_and_tile_have_one_word_and_one_figure_for_one_event(parts: Page) -> None:
    banner = detail(parts, kind="forecast limit", predicted=True)
    tile: str = run(
        parts,
        """
        const { timeToLimitTile } = await import('/js/forecast/tiles.js');
        const { nodesOf } = await import('/js/parts/panel.js');
        return nodesOf(timeToLimitTile({ sensor: 't_inner_ring_c', level: 'warning', limitC: 70,
          probability: 0.6, median: 3600, earliest: 1200, expected: true, endMs: 9e6 },
        { nowMs: 0, alone: false })).querySelector('.word').textContent;
        """,
    )
    assert banner == "earliest in 20 min · 60 %"
    assert tile.replace("min", " min") == "earliest in 20 min"


def test_the_gauge_has_no_colour_until_the_forecast_touches_a_limit(parts: Page) -> None:
    looks = run(
        parts,
        """
        const { nowTile } = await import('/js/forecast/tiles.js');
        const { nodesOf } = await import('/js/parts/panel.js');
        const safe = { word: 'safe', reasons: [], limit: null };
        const verdict = { now: safe, present_step: safe };
        const reading = { sensor: 't_inner_ring_c', value: 40, usable: true,
          limits: { warning: 70, alarm: 95 } };
        return [60, 80].map((high) => [...nodesOf(nowTile({ verdict, reading, lostText: '' }, high))
          .querySelectorAll('.rng')].map((range) => range.className));
        """,
    )
    assert looks == [["rng out"], ["rng ", "rng w"]]
