// Figures, spans and names as a user reads them; numbers as a user types them.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import {
  ageText, channelName, estimated, fixed, percent, significant, spanText, wholeSpan,
} from '../../service/web/pages/static/js/parts/format.js';
import { readNumber } from '../../service/web/pages/static/js/parts/number_field.js';

test('no probability is 0 or 100 %', () => {
  assert.deepEqual([0, 0.004, 0.005, 0.25, 0.994, 0.995, 1, null, NaN].map(percent),
    ['< 1 %', '< 1 %', '1 %', '25 %', '99 %', '> 99 %', '> 99 %', '–', '–']);
});

test('a figure has a minus of its own, and no minus before zero', () => {
  assert.deepEqual([-3.14, -0.04, 2, null].map((value) => fixed(value)), ['−3.1', '0.0', '2.0', '–']);
  assert.deepEqual([0.00012, 1234.5, -0.05678, 0].map(significant), ['1.20e−4', '1230', '−0.0568', '0']);
});

test('an estimate is said no finer than it is known', () => {
  assert.deepEqual([estimated(32.42, 9.4), estimated(37.31, 0.5), estimated(60, 1, false)],
    ['32 ±18', '37.3', 'not known']);
});

test('spans and ages have the units of their size', () => {
  assert.deepEqual([12, 60, 5999, 6000, 28800, 200000].map(spanText),
    ['< 1 min', '1 min', '1 h 40 min', '1 h 40 min', '8 h 00 min', '2 d']);
  assert.equal(wholeSpan(28800), '8 h');
  assert.deepEqual([0.6, 42.9, 245, 7800].map(ageText), ['0.6 s', '42 s', '4 min 05 s', '2 h 10 min']);
});

test('a channel has its name: of the table, of a node, or of a network of one\'s own', () => {
  assert.deepEqual(['speed_rpm', 't_node_3_c', 't_gearbox_oil_c', 'source:push', 'flow_l_min'].map(channelName),
    ['Speed', 'Balls', 'Gearbox oil', 'Source push', 'flow_l_min']);
});

for (const [text, value] of [
  ['70,5', 70.5], ['70.5', 70.5], ['0,1', 0.1], ['0,125', 0.125], [',5', 0.5], [' 70 ', 70], ['-12,25', -12.25],
  ['−3.5', -3.5], ['1.234', 1.234], ['1234,5', 1234.5], ['1e-3', 0.001], ['', null],
]) {
  test(`"${text}" is read with either mark`, () => {
    const { value: read, wrong } = readNumber(text);
    assert.equal(wrong ?? read, value);
  });
}

for (const [text, sentence] of [
  ['1,234', '“1,234” can mean 1.234 or 1234: write one of these'],
  ['-70,500', '“-70,500” can mean -70.500 or -70500: write one of these'],
  ['1.234,5', '“1.234,5” has marks of thousands: write 1234.5'],
  ['1,234.5', '“1,234.5” has marks of thousands: write 1234.5'],
  ['1.234.567', '“1.234.567” has marks of thousands: write 1234567'],
  ['1 234', '“1 234” has marks of thousands: write 1234'],
  ["1'234,5", "“1'234,5” has marks of thousands: write 1234.5"],
  ['70,5,1', '“70,5,1” is not a number: write one such as 70.5'],
  ['7O', '“7O” is not a number: write one such as 70.5'],
  ['70 °C', '“70 °C” is not a number: write one such as 70.5'],
]) {
  test(`"${text}" may mean two numbers or none: refused with what to write`, () => {
    assert.equal(readNumber(text).wrong, sentence);
  });
}
