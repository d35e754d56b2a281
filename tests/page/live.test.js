// Process time, and how the page reads and draws the past.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { extremes } from '../../service/web/pages/static/js/charts/measured.js';
import { lookOf } from '../../service/web/pages/static/js/charts/measured_chart.js';
import { TrendChart } from '../../service/web/pages/static/js/charts/trend.js';
import { ProcessClock } from '../../service/web/pages/static/js/live/clock.js';
import { spoken } from '../../service/web/pages/static/js/live/readings.js';

test('the process clock finds the rate and runs on', async () => {
  const clock = new ProcessClock();
  clock.update(1e12, 5e11);
  clock.update(1e12 + 3 * 120e3, 5e11 + 3000);
  const [first, began] = [clock.now(), performance.now()];
  await new Promise((done) => { setTimeout(done, 200); });
  const ran = (clock.now() - first) / (performance.now() - began);
  assert.equal(clock.rate, 120);
  assert.ok(Math.abs(ran / 120 - 1) < 0.02, String(ran));
});

test('a lost value is not spoken as a present one', () => {
  const lost = { value: 1500, usable: false, ageS: 21 };
  assert.equal(spoken(lost, 'revolutions per minute'), 'lost for 21 s');
  assert.equal(spoken({ ...lost, ageS: null }, 'newtons'), 'no value yet');
  assert.equal(spoken({ ...lost, usable: true }, 'newtons'), '1500 newtons');
});

test('holes between measured values are found', () => {
  // Ten minutes without a value are hatched; a bridged minute and one missing minute are not.
  const chart = Object.create(TrendChart.prototype);
  const times = Array.from({ length: 30 }, (_, i) => i);
  const broken = times.map((i) => ((i > 4 && i < 15) || i === 20 ? null : 41));
  broken[25] = undefined;
  chart.model = {
    times, sensors: ['t_inner_ring_c', 't_outer_ring_c'],
    past: { t_inner_ring_c: { measured: broken }, t_outer_ring_c: { measured: times.map(() => 40) } },
  };
  assert.deepEqual(chart.holes(), [[4, 15]]);
});

test('a dash means the same channel on every asset', () => {
  const orders = [['ambient_c', 't_outer_ring_c', 't_inner_ring_c'], ['t_inner_ring_c', 't_outer_ring_c', 'ambient_c'],
    ['t_outer_ring_c']];
  const [first, second, third] = orders.map((all) =>
    Object.fromEntries(all.map((name) => [name, lookOf(all, name).dash.join()])));
  assert.deepEqual(first, second);
  assert.equal(new Set(Object.values(first)).size, 3);
  assert.notEqual(first.t_outer_ring_c, '');
  assert.equal(third.t_outer_ring_c, first.t_outer_ring_c);
  const network = ['t_bearing_c', 't_wall_c', 'ambient_c'];
  const own = [network, [...network].reverse()].map((all) => network.map((name) => lookOf(all, name).dash.join()));
  assert.deepEqual(own[0], own[1]);
  assert.equal(new Set(own[0]).size, 3);
  assert.deepEqual(lookOf(orders[1], 't_outer_ring_c.twin').dash, [10, 5]);
  for (const name of ['speed_rpm', 'load_n']) assert.deepEqual(lookOf([...orders[1], name], name).dash, []);
});

test('the extremes of a day of raw samples are found', () => {
  // More numbers than a function may have arguments.
  const values = Array.from({ length: 500000 }, (_, i) => i % 100);
  const found = extremes({ values, low: values, high: values });
  assert.deepEqual([found.low, found.high], [0, 99]);
});
