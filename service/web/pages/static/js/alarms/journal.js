// Lines of the alarm journal in words, and their table.
import { v } from '../parts/panel.js';
import { channelName, dayTimeSecond, fixed, isNumber, moment, spanText, valueText } from '../parts/format.js';

const REACHED = {
  UNACK: 'raised', ACKED: 'acknowledged', RTNUN: 'returned to normal (unack)',
  NORM: 'returned to normal', LATCH: 'returned, latched', SHLVD: 'shelved', DSUPR: 'suppressed by design',
  OOSRV: 'taken out of service',
};
const LEFT = { SHLVD: 'unshelved', DSUPR: 'no longer suppressed', OOSRV: 'returned to service' };

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

const peakOf = ({ peak, duration_s: lastedS }) => [isNumber(peak?.value) && `peak ${fixed(peak.value)}`,
  isNumber(lastedS) && `lasted ${spanText(lastedS)}`].filter(Boolean).join(', ');

/** Columns of the journal's table; nameOf: of the asset of a line, null where there is one asset. */
export const journalColumns = (nameOf) => [
  ['Time', (line) => moment(line.time, dayTimeSecond), 'nw'],
  nameOf && ['Asset', nameOf, 'nw'],
  ['Event', (line) => {
    const what = transitionText(line);
    return v('td', { class: `nw${what === 'raised' ? ' b' : ''}` }, what);
  }],
  ['Alarm or event', (line) => v('b', {}, line.message || line.kind)],
  ['Source', (line) => (line.channel ? channelName(line.channel) : line.kind), 'nw mut'],
  ['Value', (line) => [isNumber(line.value) && valueText(line.value, line.unit ?? ''),
    isNumber(line.duration_s) && v('small', { class: 'mut' }, ' ', peakOf(line))], 'r nw', 'r'],
  ['Who', (line) => line.who || '', 'nw'], ['Comment', (line) => line.comment || ''],
];

const quoted = (value) => `"${String(value ?? '').replaceAll('"', '""')}"`;
const NUMBER = /^ *[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)? *$/i;
const FORMULA = /^[ "\u00a0\u200b\ufeff]*[=+@\-\uff1d\uff0b\uff0d\uff20]/;
const safePart = (text) => {
  const begin = text.replace(/^'+/, '');
  return FORMULA.test(begin) && !NUMBER.test(begin) ? `'${text}` : text;
};
/** As `service.spreadsheets` writes it: also where a spreadsheet of another language cuts a line. */
const safeCell = (text) => text.split(/([;\t\r\n])/).map(safePart).join('');
const CSV_COLUMNS = ['time', 'asset', 'class', 'from', 'to', 'kind', 'channel', 'message', 'value',
  'peak_value', 'peak_time', 'duration_s', 'who', 'comment'];

const cell = (line, name) => ({ peak_value: line.peak?.value, peak_time: line.peak?.time })[name] ?? line[name];

/** The same lines as CSV; a cell that a spreadsheet would take for a formula is text. */
export const journalCsv = (lines) => [CSV_COLUMNS.join(','), ...lines.map((line) =>
  CSV_COLUMNS.map((name) => quoted(safeCell(String(cell(line, name) ?? '')))).join(','))].join('\r\n');
