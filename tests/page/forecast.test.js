// What lies ahead: the fan, the judgement of a profile that a user asks for.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { distinctSteps, fanFrom, overSpan, stepsFrom } from '../../service/web/pages/static/js/forecast/forecast.js';
import { judgeProfile, marginText, timeAlongProfile } from '../../service/web/pages/static/js/forecast/verdict.js';

const RING = 't_inner_ring_c';
const limits = { [RING]: { warning: 90, alarm: 105 } };

/** A forecast made at the epoch: rows every 10 min over 60 min, one sensor, warming up. */
function forecastOf(row = [60, 70, 80, 90, 100, 110, 120]) {
  const around = (by) => row.map((value) => value + by);
  return {
    made_at: '1970-01-01T00:00:00.000Z',
    time_s: [0, 600, 1200, 1800, 2400, 3000, 3600],
    nodes: { [RING]: { q025: around(-4), q25: around(-1), q50: row, q75: around(1), q975: around(4) } },
    profile: [
      { duration_s: 1200, speed_rpm: 4200, load_n: 2650 },
      { duration_s: 600, speed_rpm: 6200, load_n: 2650 },
      { duration_s: 1800, speed_rpm: 6200, load_n: 2650 },
    ],
    time_to_limit: { [RING]: {
      warning: { probability: 1, median_s: 1800, earliest_s: 1500 },
      alarm: { probability: 0.9, median_s: 2700, earliest_s: 2400 },
    } },
  };
}

test('the fan begins at now', () => {
  const fan = fanFrom(forecastOf(), 900e3, [RING]);
  assert.deepEqual(fan.times, [900e3, 1200e3, 1800e3, 2400e3, 3000e3, 3600e3]);
  assert.deepEqual(fan.bands[RING].q50, [75, 80, 90, 100, 110, 120]);
});

test('a forecast that has run out or ran away is cut', () => {
  const forecast = forecastOf();
  assert.equal(fanFrom(forecast, 3600e3, [RING]), null);
  forecast.nodes[RING].q975[3] = null;
  assert.deepEqual(fanFrom(forecast, 0, [RING]).times, [0, 600e3, 1200e3]);
});

test('steps begin at now, and neighbours of one operating point are one', () => {
  const steps = stepsFrom(forecastOf(), 900e3);
  assert.deepEqual(steps.map((step) => [step.from, step.to, step.duration_s]),
    [[900e3, 1200e3, 300], [1200e3, 1800e3, 600], [1800e3, 3600e3, 1800]]);
  assert.deepEqual(distinctSteps(steps).map((step) => [step.speed_rpm, step.duration_s]), [[4200, 300], [6200, 2400]]);
});

test('of a span the highest median counts, and the edges of its band', () => {
  const fan = fanFrom(forecastOf(), 0, [RING]);
  assert.deepEqual(overSpan(fan, RING, 0, 1200e3), { median: 80, low: 76, high: 84 });
  assert.deepEqual(overSpan(fan, RING), { median: 120, low: 116, high: 124 });
});

const judged = (forecast, nowMs) =>
  judgeProfile({ forecast, fan: fanFrom(forecast, nowMs, [RING]), limits, nowMs, safe: 0.05 });

test('a profile is judged over its whole length', () => {
  const answer = judged(forecastOf(), 900e3);
  assert.deepEqual([answer.word, answer.priority, answer.peak.median], ['not safe', 1, 120]);
});

test('a profile that only cools is the way out, not the danger', () => {
  const answer = judged(forecastOf([97, 98, 100, 95, 85, 75, 70]), 1200e3);
  assert.equal(answer.word, 'recovering');
  assert.deepEqual([answer.cools.belowMs, answer.cools.surelyMs], [2100e3, 2340e3]);
});

for (const [why, medians] of [
  ['heats on before it cools', [97, 98, 100, 104, 95, 80, 70]],
  ['does not get below within the step', [97, 98, 100, 97, 95, 93, 91]],
  ['brings the machine over the limit', [70, 75, 80, 95, 100, 85, 80]],
]) {
  test(`a profile that ${why} is not safe`, () => {
    assert.equal(judged(forecastOf(medians), 1200e3).word, 'not safe');
  });
}

test('time along a profile counts from now and turns to the alarm', () => {
  const [forecast, nowMs] = [forecastOf(), 900e3];
  const fan = fanFrom(forecast, nowMs, [RING]);
  const along = (value) => timeAlongProfile(
    { forecast, fan, readings: [{ sensor: RING, value, usable: true }], limits, nowMs, safe: 0.05 });
  const before = along(75);
  assert.deepEqual([before.level, before.median, before.expected], ['warning', 900, true]);
  const over = along(92);
  assert.deepEqual([over.level, over.limitC, over.earliest], ['alarm', 105, 1500]);
});

test('a margin to a runaway is said in words', () => {
  const base = { speed_rpm: 6200, load_n: 5500, probability: 0.021, margin_k: 24.1 };
  assert.deepEqual([
    { ...base, margin_n: 1896.0 },
    { ...base, margin_n: null, probability: 0.001 },
    { ...base, margin_n: -300, margin_k: null, probability: 0.12 },
    null,
  ].map(marginText), [
    'Margin to thermal runaway: 1900 N / 24 K, probability 2 %',
    'Margin to thermal runaway: more than 5500 N / 24 K, probability < 1 %',
    'Margin to thermal runaway: −300 N, probability 12 %',
    '',
  ]);
});
