// The engineer's view and the forecast record: versions, minutes, windows, advice, scores.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import {
  byLead, chosen, loses, pastPoints, recordFor, recordText, riskOf, together,
} from '../../service/web/pages/static/js/accuracy/scores.js';
import { stepText } from '../../service/web/pages/static/js/engineer/advice_panel.js';
import { OperationMinutes } from '../../service/web/pages/static/js/engineer/windows.js';
import { offer, versionBefore } from '../../service/web/pages/static/js/engineer/version_panel.js';

test('steps of the advice are said shortly', () => {
  assert.equal(stepText([
    { speed_rpm: 4200, load_n: 2000, duration_s: 2700 },
    { speed_rpm: 4200, load_n: 3400, duration_s: 7200 },
    { speed_rpm: 3000, load_n: 3400, duration_s: 600 },
  ]), '4200 rpm, 2000 N 45 min, then 3400 N 2 h 00 min, then 3000 rpm, 3400 N 10 min');
});

for (const [versions, before] of [
  [[1], null], [[1, 2], 1], [[1, 2, 1], null], [[1, 2, 4, 2], 1], [[1, 2, 1, 3], 1], [[], null],
]) {
  test(`a roll-back after ${versions.join(', ') || 'none'} leads to ${before}`, () => {
    assert.equal(versionBefore(versions.map((version) => ({ version })).reverse()), before);
  });
}

test('a version that failed a gate is not offered', () => {
  const gates = { checks: [{ passed: true, detail: 'fit: fine' }, { passed: false, detail: 'bad' }] };
  const [candidate, rejected, active, retired] = ['candidate', 'rejected', 'active', 'retired']
    .map((status) => offer({ version: 3, status, gates, reason: 'why' }));
  assert.deepEqual([candidate.offered, retired.offered, active.offered], [true, true, false]);
  assert.deepEqual([rejected.offered, rejected.kept], [false, true]);
  assert.equal(rejected.text, 'v3 is stored, not offered: 1 of 2 gates passed. bad.');
});

test('high-risk spans and holes are found in the minutes', () => {
  const MINUTE_MS = 60000;
  const minutes = new OperationMinutes('a');
  for (let number = 0; number < 40; number += 1) {
    if (number >= 20 && number < 30) continue;
    minutes.minutes.set(number * MINUTE_MS, {
      speed_rpm: [5, 6, 8].includes(number) ? 4600 : 3000, load_n: number === 35 ? 3700 : 2000,
    });
  }
  const risky = minutes.highRisk({ speed_rpm_max: 4300, load_n_max: 3400 });
  assert.deepEqual(risky.map((one) => [one.fromMs / MINUTE_MS, one.toMs / MINUTE_MS]), [[5, 9], [35, 36]]);
  assert.deepEqual(minutes.speedRuns(60000).map((run) => run.length), [20, 10]);
});

function score(n, more = {}) {
  const some = (value) => (n ? value : null);
  return {
    channel: 't_inner_ring_c', lead_time_s: 300, risk: 'low', model_version: 1, n,
    set_aside: 2, set_aside_by: { plan: 1, data: 1, model: 0 }, waiting: 3,
    coverage_50: some(0.5), coverage_95: some(0.9), bias_k: some(1), mae_k: some(1), crps_k: some(1),
    left: 0, left_inside_95: 0, independent_runs: 0, whole_runs: 0, whole_runs_inside: 0,
    interval_score_k: some(4), below: { q025: some(0), q25: some(0), q50: 0.5, q75: 1, q975: 1 },
    naive: { persistence: { mae_k: 0.5 }, linear: { mae_k: null }, arx: { mae_k: null } }, ...more,
  };
}
const scores = [score(30), score(10, { mae_k: 3, lead_time_s: 600, risk: 'high' }), score(0)];

test('scores of several kinds are put together by their readings', () => {
  const all = together(scores);
  assert.deepEqual([all.n, all.setAside, all.waiting], [40, 6, 9]);
  assert.deepEqual(all.by, { plan: 3, data: 3, model: 0 });
  assert.ok(Math.abs(all.mae_k - (30 * 1 + 10 * 3) / 40) < 1e-9);
  assert.deepEqual(all.naive, { persistence: 0.5, linear: null, arx: null });
  assert.equal(chosen(scores, { risk: 'high' }).length, 1);
});

test('of two versions the one with a naive forecast decides which lead time loses', () => {
  const naive = (arx) => ({ persistence: { mae_k: 9 }, linear: { mae_k: null }, arx: { mae_k: arx } });
  const rows = byLead([...scores, score(20, { lead_time_s: 1800, mae_k: 5, naive: naive(null) }),
    score(10, { lead_time_s: 1800, mae_k: 1, naive: naive(2), model_version: 2 })]);
  assert.deepEqual(rows.map((row) => [row.lead, row.n, loses(row)]),
    [[300, 30, true], [600, 10, true], [1800, 30, false]]);
});

test('the record is one line of words', () => {
  assert.deepEqual([scores, [score(0)], [], [{ ...score(0), set_aside: 0 }]].map(recordText), [
    'Forecasts of the last 30 days: 36 of 40 readings inside the band',
    'Forecasts of the last 30 days: none evaluated, 2 excluded',
    '',
    'Forecasts of the last 30 days: none due yet',
  ]);
});

test('what was interrupted counts as it was when the plan was followed last', () => {
  const some = [score(10, { left: 5, left_inside_95: 1, independent_runs: 3, whole_runs: 14, whole_runs_inside: 9 }),
    score(10, { lead_time_s: 3600, risk: 'high', independent_runs: 2 })];
  const all = together(some);
  assert.deepEqual([all.n, all.scored, all.left, all.leftInside, all.independent, all.runs, all.runsInside],
    [20, 25, 5, 1, 3, 14, 9]);
  assert.ok(Math.abs(all.share - 19 / 25) < 1e-9);
  assert.equal(recordText(some),
    'Forecasts of the last 30 days: 19 of 25 readings inside the band, 3 independent runs');
});

test('the record is of the lead time that is nearest, and of the risk', () => {
  const some = [score(10, { left: 5, left_inside_95: 1, independent_runs: 3 }),
    score(20, { lead_time_s: 3600, independent_runs: 1 }), score(10, { lead_time_s: 3600, risk: 'high' })];
  const of = (aheadS, risk, channel = 't_inner_ring_c') => recordFor(some, { channel, aheadS, risk });
  assert.equal(of(400, 'low'), '10 of 15 inside 5 min ahead at low risk (3 independent runs)');
  assert.equal(of(9000, 'low'), '18 of 20 inside 1 h ahead at low risk (1 independent run)');
  assert.equal(of(9000, 'high'), '9 of 10 inside 1 h ahead at high risk (0 independent runs)');
  assert.deepEqual([of(400, 'low', 't_outer_ring_c'), recordFor([], { channel: 'x', aheadS: 1, risk: 'low' }),
    recordFor(null, { channel: 'x', aheadS: 1, risk: 'low' })], ['', '', '']);
});

test('a plan is of high risk as soon as one step leaves the region', () => {
  const region = { speed_rpm_max: 4300, load_n_max: 3400 };
  const step = (speed_rpm, load_n) => ({ speed_rpm, load_n });
  assert.deepEqual([[step(4300, 3400)], [step(1000, 2650), step(-6200, 2650)], [step(1000, 5500)], []]
    .map((steps) => riskOf(steps, region)), ['low', 'high', 'high', 'low']);
});

test('what is drawn of old forecasts is what was kept and has come', () => {
  const MADE_MS = 1763700000000;
  const point = (ms) => ({
    lead_time_s: 600, time: new Date(MADE_MS + ms).toISOString(), risk: 'low',
    readings: [{ channel: 't_inner_ring_c', state: 'scored', q50: 42 }],
  });
  const forecasts = [600000, 500000].map((ms) => ({
    made_at: new Date(MADE_MS).toISOString(), reason: 'step', model_version: 2, points: [point(ms)],
  }));
  const times = (lead, nowMs) => pastPoints(forecasts, 't_inner_ring_c', lead, nowMs).map(({ time }) => time - MADE_MS);
  assert.deepEqual(times(600, MADE_MS + 600000), [500000, 600000]);
  assert.deepEqual(times(600, MADE_MS + 500000), [500000]);
  assert.deepEqual(times(300, MADE_MS + 600000), []);
});
