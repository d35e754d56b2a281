// The axis of the low-risk windows, over days on which the clocks are changed.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { localTimes } from '../../service/web/pages/static/js/engineer/windows.js';

const ms = (text) => Date.parse(text);
const clock = (times) => times.map((at) => new Date(at).toLocaleString('en-GB', {
  day: 'numeric', month: 'short', hour: '2-digit', minute: '2-digit', hourCycle: 'h23' }));

test('half days keep noon and midnight when the clock goes forward', () => {
  const times = clock(localTimes(ms('2026-03-27T09:30:00+01:00'), ms('2026-03-31T13:00:00+02:00'), 12));
  assert.deepEqual(times, ['27 Mar, 12:00', '28 Mar, 00:00', '28 Mar, 12:00', '29 Mar, 00:00',
    '29 Mar, 12:00', '30 Mar, 00:00', '30 Mar, 12:00', '31 Mar, 00:00', '31 Mar, 12:00']);
});

test('days are days when the clock goes back', () => {
  const times = clock(localTimes(ms('2026-10-22T09:30:00+02:00'), ms('2026-10-28T09:30:00+01:00'), 24));
  assert.deepEqual(times, ['23 Oct, 00:00', '24 Oct, 00:00', '25 Oct, 00:00', '26 Oct, 00:00',
    '27 Oct, 00:00', '28 Oct, 00:00']);
});

test('no time comes twice where an hour is left out', () => {
  const times = clock(localTimes(ms('2026-03-29T00:00:00+01:00'), ms('2026-03-29T06:00:00+02:00'), 1));
  assert.deepEqual(times, ['29 Mar, 00:00', '29 Mar, 01:00', '29 Mar, 03:00', '29 Mar, 04:00', '29 Mar, 05:00']);
});

test('two hours stay even hours after the one that is left out', () => {
  const times = clock(localTimes(ms('2026-03-29T00:00:00+01:00'), ms('2026-03-29T09:00:00+02:00'), 2));
  assert.deepEqual(times, ['29 Mar, 00:00', '29 Mar, 03:00', '29 Mar, 04:00', '29 Mar, 06:00', '29 Mar, 08:00']);
});

test('weeks begin on Mondays, months of data have marks too', () => {
  const weeks = localTimes(ms('2026-10-07T12:00:00+02:00'), ms('2026-11-12T12:00:00+01:00'), 7 * 24);
  assert.deepEqual(clock(weeks), ['12 Oct, 00:00', '19 Oct, 00:00', '26 Oct, 00:00', '2 Nov, 00:00', '9 Nov, 00:00']);
  assert.equal(localTimes(ms('2026-01-10T12:00:00+01:00'), ms('2026-11-12T12:00:00+01:00'), 30 * 24).length, 10);
});
