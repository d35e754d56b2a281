// In which order alarms are shown, and what stands behind one.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { detailText, ranked, summary, worst } from '../../service/web/pages/static/js/alarms/alarm.js';
import { standingAlarm } from '../../service/web/pages/static/js/fleet/card.js';

const alarm = (id, facts = {}) => ({
  id, asset: 'bench-1', message: id, kind: 'measured limit', channel: 't_inner_ring_c', limit_level: 'warning',
  limit_value: 90, priority: 2, state: 'UNACK', predicted: false, raised_at: '2026-11-22T08:00:00.000Z', ...facts,
});
const byId = (alarms) => new Map(alarms.map((one) => [one.id, one]));
const LOST = { kind: 'stale data', channel: 'source:push', limit_level: null };
const PREDICTED = { kind: 'forecast limit', predicted: true };
const LATER = { raised_at: '2026-11-22T09:00:00.000Z' };

test('unacknowledged alarms are ranked by priority, then by how certain they are', () => {
  const alarms = byId([
    alarm('lost 2', { ...LOST, ...LATER }), alarm('lost 1', { ...LOST, priority: 1 }),
    alarm('predicted 2', { ...PREDICTED, ...LATER }), alarm('predicted 1', { ...PREDICTED, priority: 1 }),
    alarm('over warning'), alarm('over warning later', LATER), alarm('over alarm', { priority: 1 }),
    alarm('over alarm, seen', { priority: 1, state: 'ACKED', ...LATER }),
    alarm('shelved', { priority: 1, state: 'SHLVD', ...LATER }),
  ]);
  assert.deepEqual(ranked(alarms).map((one) => one.id), [
    'over alarm', 'lost 1', 'predicted 1', 'over warning later', 'over warning', 'lost 2', 'predicted 2',
    'over alarm, seen', 'shelved',
  ]);
  assert.equal(worst(alarms).id, 'over alarm');
});

test('the summary says how alarms are suppressed', () => {
  const states = ['UNACK', 'ACKED', 'RTNUN', 'SHLVD', 'DSUPR', 'DSUPR'];
  assert.equal(summary(byId(states.map((state, i) => alarm(String(i), { state })))),
    '2 active, 2 unacknowledged, 3 suppressed (shelved 1, by design 2)');
});

test('an alarm that only rises fast is not over a limit', () => {
  assert.equal(standingAlarm(byId([
    alarm('rises', { kind: 'rate of rise', priority: 1 }), alarm('over warning'),
    alarm('back', { priority: 1, state: 'RTNUN' }), alarm('will pass', { priority: 1, ...PREDICTED }),
  ])).id, 'over warning');
});

const detail = (facts) => detailText(alarm('1', { unit: '°C', returned_at: null, value: 70.3, ...facts }), {
  nowMs: Date.parse('2026-11-22T10:00:00.000Z'), value: () => 36.3,
  crossing: () => ({ probability: 0.6, median: 3600, earliest: 1200 }),
}).replaceAll('\u00a0', ' ');

test('an alarm shows the value of now; one that has returned its peak and how long it lasted', () => {
  assert.equal(detail({}), '36.3 °C');
  assert.equal(detail({
    state: 'RTNUN', returned_at: '2026-11-22T09:12:00.000Z', duration_s: 4320,
    peak: { value: 79.3, time: '2026-11-22T08:30:00.000Z' },
  }), 'peak 79.3 °C, lasted 72 min');
});

test('a predicted alarm shows lead time and probability', () => {
  assert.equal(detail(PREDICTED), 'earliest in 20 min · 60 %');
});
