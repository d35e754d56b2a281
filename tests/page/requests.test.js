// Errors are said once and in words; a source and an asset are what the service takes.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { wordsOf } from '../../service/web/pages/static/js/app/api.js';
import { assetRows, holeValue, wrongField } from '../../service/web/pages/static/js/assets/provisioning.js';
import { completedSource } from '../../service/web/pages/static/js/commissioning/configuration.js';

const TOO_LARGE = 'source.port = 99999: Input should be less than or equal to 65535';
for (const [problem, said] of [
  [{ detail: TOO_LARGE, errors: [{ detail: TOO_LARGE }] }, TOO_LARGE],
  [{ detail: '/text: not a valid DBC file', errors: [{ detail: 'not a valid DBC file' }] }, 'not a valid DBC file'],
  [{ detail: 'a is wrong', errors: [{ detail: 'a is wrong' }, { detail: 'b' }] }, 'a is wrong; b'],
  [{ title: 'Conflict' }, 'Conflict'],
  [{ detail: 'row 0', errors: Array.from({ length: 500 }, (_, i) => ({ detail: `row ${i}` })) },
    'row 0; row 1; row 2; row 3; row 4; row 5 (and 494 more)'],
]) {
  test(`each thing that is wrong is said once: ${said}`, () => assert.equal(wordsOf(problem), said));
}

const slcan = (channel) => ({ name: 'drive', driver: 'can', interface: 'slcan', channel });

for (const [given, channel] of [
  ['127.0.0.1:23002', 'socket://127.0.0.1:23002'],
  ['adapter.example:2000', 'socket://adapter.example:2000'],
  ['[fe80::1]:2000', 'socket://[fe80::1]:2000'],
  ['socket://127.0.0.1:23002', 'socket://127.0.0.1:23002'],
  ['/dev/ttyACM0', '/dev/ttyACM0'],
]) {
  test(`an adapter at ${given} is ${channel}`, () => {
    assert.deepEqual(completedSource(slcan(given)), slcan(channel));
  });
}

test('what the service would refuse is said when the source is added', () => {
  assert.throws(() => completedSource(slcan('ttyACM0')),
    { message: 'address "ttyACM0": expected HOST:PORT or a path in /dev' });
  assert.throws(() => completedSource({ ...slcan('/dev/ttyACM0'), name: 'pt 100/ä' }),
    { message: 'name "pt 100/ä": expected letters, digits, ".", "_" and "-", 64 at most' });
  const can = { name: 'drive', driver: 'can', interface: 'socketcan', channel: 'can0' };
  assert.deepEqual(completedSource(can), can);
});

test('assets of file and interface are rows of one table', () => {
  const asset = (id, running) => ({ id, name: null, health: { twin_running: running } });
  const item = (id, why) => ({ id, table: { name: 'N' }, template: null, not_running: why });
  const rows = assetRows([asset('a10', true), asset('a9', false), asset('b', true)],
    [item('b', null), item('c', 'no such template')]);
  assert.deepEqual(rows.map(({ id, name, origin, state, why }) => [id, name, origin, state, why]), [
    ['a9', 'a9', 'file', 'waiting for data', ''],
    ['a10', 'a10', 'file', 'running', ''],
    ['b', 'N', 'provisioned', 'running', ''],
    ['c', 'N', 'provisioned', 'not running', 'no such template'],
  ]);
});

test('a value of a template is a number where its text is one', () => {
  assert.deepEqual(['11', '-0.5', '1e3', '007', '1.', 'nan', '', '12345678901234567890'].map(holeValue),
    [11, -0.5, 1000, '007', '1.', 'nan', '', '12345678901234567890']);
});

test('a fault names the field without its row', () => {
  assert.deepEqual([
    ['/values/unit', 'values.unit: missing'], ['', 'a row too long'],
    ['/assets/3/channels/t_a~1b', 'row 5 (x (y)): channels.t_a/b: unknown'], [undefined, 'row 2: no id'],
  ].map(([pointer, detail]) => Object.values(wrongField({ pointer, detail }))),
  [['values.unit', 'missing'], ['', 'a row too long'], ['channels.t_a/b', 'unknown'], ['', 'no id']]);
});
