// What-if and envelope: profiles in links, questions to the twin, the plane of speed and load.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import {
  chanceAt, contour, joined, nearestAt, planeOf, valueAt,
} from '../../service/web/pages/static/js/envelope/plane.js';
import { verdictAt } from '../../service/web/pages/static/js/envelope/view.js';
import { highestSpeed, LatestQuestion } from '../../service/web/pages/static/js/whatif/questions.js';
import { fieldsFor, fromLink, linkOf } from '../../service/web/pages/static/js/whatif/profile.js';

const steps = [
  { speed_rpm: 4400, load_n: 5500, minutes: 45 },
  { speed_rpm: 6200, load_n: 3900.5, minutes: 75 },
];

test('a link says what is tried', () => {
  const link = linkOf(steps, true);
  assert.equal(link, 'steps=4400_5500_45-6200_3900.5_75&from=end');
  assert.deepEqual(fromLink(link), { steps, fromEnd: true });
});

for (const query of ['', 'steps=', 'steps=4400_5500', 'steps=4400_5500_0', 'steps=4400_5500_45-99999_1_5',
  'steps=a_b_c', 'steps=4400_-1_45', 'from=end']) {
  test(`the link "${query}" cannot be tried and is ignored`, () => assert.equal(fromLink(query), null));
}

test('sliders reach beyond the low-risk region and everything planned', () => {
  const small = fieldsFor({ speed_rpm_max: 4300, load_n_max: 3400 }, steps);
  const large = fieldsFor({ speed_rpm_max: 18, load_n_max: 60000 }, []);
  assert.deepEqual([small.speed_rpm.high, small.load_n.high], [7000, 7500]);
  assert.deepEqual([small.speed_rpm.step, small.load_n.step], [50, 50]);
  assert.deepEqual([large.speed_rpm.high, large.load_n.high, large.load_n.step], [500, 135000, 500]);
});

test('the latest question is asked next and older ones are dropped', async () => {
  const [asked, answered, failed] = [[], [], []];
  let settle;
  const line = new LatestQuestion({
    ask: (question) => {
      asked.push(question);
      return new Promise((good, bad) => { settle = { good, bad }; });
    },
    answered: (answer) => answered.push(answer),
    failed: (error) => failed.push(error.message),
  });
  const settled = () => new Promise((done) => { setTimeout(done); });
  for (const question of [1, 2, 3, 4]) line.put(question);
  settle.good('re 1');
  await settled();
  line.put(5);
  settle.bad(new Error('no'));
  await settled();
  settle.good('re 5');
  await settled();
  line.put(6);
  line.put(7);
  line.stop();
  settle.bad(new Error('aborted'));
  await settled();
  assert.deepEqual({ asked, answered, failed }, { asked: [1, 4, 5, 6], answered: ['re 1', 're 5'], failed: ['no'] });
});

test('the highest speed is the last below five percent', async () => {
  // The chance falls at first (a standing machine is worst) and then grows with the speed.
  let asked = 0;
  const seek = (chance) => highestSpeed({
    low: 0, high: 7000, step: 50, safe: 0.05,
    profileAt: (speed) => speed,
    ask: async (speed) => {
      asked += 1;
      return {
        limits: { a: { warning: 90 }, b: { warning: 80 } },
        time_to_limit: { a: { warning: { probability: chance(speed) } }, b: { warning: { probability: 0.001 } } },
      };
    },
  });
  const real = await seek((speed) => (speed < 300 ? 0.3 : (speed / 7000) ** 3 * 0.4));
  assert.deepEqual([real.speed, real.limit, real.sensor], [3450, 90, 'a'], 'just below 3500 rpm it is 5 %');
  assert.ok(asked <= 12, `${asked} questions`);
  const open = await seek(() => 0.01);
  assert.deepEqual([open.speed, open.open], [7000, true]);
  assert.equal((await seek(() => 0.06)).speed, null);
});

// A plane of 3 speeds and 2 loads; time to a limit that slow points never reach.
const plane = planeOf({ speed_rpm: [1000, 2000, 3000], load_n: [500, 1500] });
const temperatures = [[30, 40, 50], [40, 50, 60]];
const times = [[null, null, 3600], [null, 7200, 1800]];

test('values between grid points are interpolated', () => {
  assert.deepEqual([
    valueAt(plane, temperatures, 1000, 500), valueAt(plane, temperatures, 1500, 1000),
    valueAt(plane, temperatures, 9000, 9000), valueAt(plane, times, 1500, 1000),
    nearestAt(plane, times, 2900, 1400), nearestAt(plane, times, 1100, 600),
  ], [30, 40, 60, null, 1800, null]);
});

test('contours lie where the level is', () => {
  // On this plane T = 30 + (speed - 1000) / 100 + (load - 500) / 100.
  const segments = contour(plane, temperatures, 45, 30);
  assert.ok(segments.length >= 30);
  for (const [speed, load] of segments.flat()) {
    const level = 30 + (speed - 1000) / 100 + (load - 500) / 100;
    assert.ok(Math.abs(level - 45) < 0.01, `${speed} rpm, ${load} N: ${level}`);
  }
  const loads = segments.flat().map(([, load]) => load);
  assert.ok(Math.abs(Math.min(...loads) - 500) <= 40);
  assert.ok(Math.abs(Math.max(...loads) - 1500) <= 40);
  assert.deepEqual(contour(plane, temperatures, 99, 30), []);
  const found = contour(plane, temperatures, 44.7, 30);
  assert.deepEqual(joined(found).map((line) => line.length), [found.length + 1], 'one line from edge to edge');
});

for (const [speed, reading, expected, why] of [
  [1900, 77.1, 1, 'measured over the limit, where the map says 36 %'],
  [1900, 69.9, 0.36, 'measured below the limit'],
  [1900, null, 0.36, 'not measured'],
  [1000, 77.1, 0, 'another point of the map'],
]) {
  test(`the present point is rated no lower than what is measured: ${why}`, () => {
    const map = { limit_c: 70, steady_probability: [[0, 0.4], [0, 0.4]] };
    const grid = planeOf({ speed_rpm: [1000, 2000], load_n: [1000, 3000] });
    const chance = chanceAt(grid, map, { speed, load: 2650 }, { speed: 1900, load: 2650, reading });
    assert.ok(Math.abs(chance - expected) < 1e-6, String(chance));
  });
}

for (const [warning, alarm, safe, word, priority] of [
  [0.049, 0, 0.05, 'Safe', 0], [0.05, 0, 0.05, 'Not safe', 2], [0.3, 0, 0.05, 'Not safe', 2],
  [0.9, 0.2, 0.05, 'Not safe', 1], [0.02, 0, 0.01, 'Not safe', 2], [0.3, 0.25, 0.4, 'Safe', 0],
]) {
  test(`a point with ${warning} / ${alarm}, safe below ${safe}: ${word}`, () => {
    assert.deepEqual(verdictAt(warning, alarm, safe), { word, priority });
  });
}
