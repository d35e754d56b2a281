// Lines of the alarm journal in words, and their table.
import { bold, h } from './dom.js';
import { channelName, dayTimeSecond, fixed, isNumber, milliseconds, spanText, timeElement }
  from './format.js';

const REACHED = {
  UNACK: 'raised', ACKED: 'acknowledged', RTNUN: 'returned to normal (unack)',
  NORM: 'returned to normal', LATCH: 'returned, latched', SHLVD: 'shelved', DSUPR: 'suppressed by design',
  OOSRV: 'taken out of service',
};
const LEFT = { SHLVD: 'unshelved', DSUPR: 'no longer suppressed', OOSRV: 'returned to service' };

/** What happened, in a few words. */
export function transitionText(line) {
  const { from, to } = line;
  if (line.class === 'event') return 'event';
  if (line.event === 'comment' || (from && from === to)) return line.event ?? 'comment';
  if (from in LEFT && !(to in LEFT)) return LEFT[from];
  if (from === 'LATCH' && to === 'NORM') return 'reset';
  if (from === 'RTNUN' && to === 'NORM') return 'acknowledged after return';
  if (from === 'RTNUN' && to === 'UNACK') return 're-alarmed';
  return REACHED[to] ?? (to ? to.toLowerCase() : 'noted');
}

/** One line of the journal's table; `assetName` is shown where there are several assets. */
export function journalRow(line, assetName) {
  const timeMs = milliseconds(line.time);
  const what = transitionText(line);
  const value = isNumber(line.value) ? `${fixed(line.value)} ${line.unit ?? '°C'}` : '';
  const over = [isNumber(line.peak?.value) && `peak ${fixed(line.peak.value)}`,
    isNumber(line.duration_s) && `lasted ${spanText(line.duration_s)}`].filter(Boolean).join(', ');
  return h('tr', { 'data-class': line.class ?? 'alarm' },
    h('td', { class: 'nw' }, timeElement(timeMs, dayTimeSecond(timeMs))),
    assetName && h('td', { class: 'nw' }, assetName),
    h('td', { class: `nw${what === 'raised' ? ' b' : ''}` }, what),
    h('td', {}, bold(line.message || line.kind)),
    h('td', { class: 'nw mut' }, line.channel ? channelName(line.channel) : line.kind),
    h('td', { class: 'r nw' }, value, isNumber(line.duration_s) && h('small', { class: 'mut' }, over)),
    h('td', { class: 'nw' }, line.who || ''),
    h('td', {}, line.comment || ''));
}

export const journalHead = (withAsset) => h('tr', {},
  ['Time', withAsset && 'Asset', 'Event', 'Alarm or event', 'Source', 'Value', 'Who', 'Comment']
    .filter(Boolean).map((title) =>
      h('th', { scope: 'col', class: title === 'Value' ? 'r' : null }, title)));

const quoted = (value) => `"${String(value ?? '').replaceAll('"', '""')}"`;
const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const FORMULA = /^[=+@\-\t\r\n\uff1d\uff0b\uff0d\uff20]/;
const safeCell = (text) => (FORMULA.test(text) && !NUMBER.test(text) ? `'${text}` : text);
const CSV_COLUMNS = ['time', 'asset', 'class', 'from', 'to', 'kind', 'channel', 'message', 'value',
  'peak_value', 'peak_time', 'duration_s', 'who', 'comment'];

const cell = (line, name) => ({ peak_value: line.peak?.value, peak_time: line.peak?.time })[name]
  ?? line[name];

/** The same lines as CSV; a cell that a spreadsheet would take for a formula is text. */
export const journalCsv = (lines) => [CSV_COLUMNS.join(','), ...lines.map((line) =>
  CSV_COLUMNS.map((name) => quoted(safeCell(String(cell(line, name) ?? ''))))
    .join(','))].join('\r\n');
