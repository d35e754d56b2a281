// Model versions side by side: parameters with intervals, scores beside the naive forecasts.
import { h } from './dom.js';
import { fixed, isNumber, significant } from './format.js';

const VERDICTS = { informed: 'chip on', weak: 'chip', 'prior only': 'chip dot' };
const STATUS_CHIPS = { active: 'chip on', rejected: 'chip dot', retired: 'chip dot' };

export const statusChip = (status) =>
  h('span', { class: STATUS_CHIPS[status] ?? 'chip' }, status);

const plainName = (name) => name.replaceAll('_', ' ');

/** Place of a value on a bar that spans both versions; logarithmic over more than a factor 3. */
function scaleOf(parameters) {
  const ends = parameters.flatMap(({ low, high, value }) => [low, high, value]).filter(isNumber);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const logarithmic = low > 0 && high / low > 3;
  const place = logarithmic ? Math.log : (value) => value;
  const room = (place(high) - place(low)) * 0.06 || 1;
  const [from, to] = [place(low) - room, place(high) + room];
  return (value) => (place(value) - from) / (to - from) * 100;
}

function intervalBar(parameter, at) {
  const { low, high, value, verdict, unit } = parameter;
  if (!isNumber(low) || !isNumber(high)) return '';
  return h('div', {
    class: `ivb${verdict === 'prior only' ? ' po' : ''}`,
    title: `${significant(low)} … ${significant(high)} ${unit ?? ''}`,
  },
  h('i', { style: { left: `${at(low)}%`, right: `${100 - at(high)}%` } }),
  h('b', { style: { left: `${at(value)}%` } }));
}

/** Parameters of the active version, and of another one beside it. */
export function parameterTable(active, other) {
  const names = [...new Set([...Object.keys(active?.parameters ?? {}),
    ...Object.keys(other?.parameters ?? {})])];
  const rows = names.map((name) => {
    const both = [active, other].map((model) => model?.parameters?.[name]);
    const at = scaleOf(both.filter(Boolean));
    const verdict = (both[1] ?? both[0]).verdict;
    const cells = both.flatMap((parameter, i) => (i && !other ? [] : [
      h('td', { class: i ? 'r b' : 'r' }, significant(parameter?.value)),
      h('td', { class: 'iv' }, parameter && intervalBar(parameter, at)),
    ]));
    const unitText = (both[0] ?? both[1]).unit;
    return h('tr', {}, h('td', {}, plainName(name),
      unitText && unitText !== '1' && h('span', { class: 'u' }, unitText)), cells,
    h('td', {}, h('span', { class: VERDICTS[verdict] ?? 'chip' }, verdict ?? '–')));
  });
  const heads = [active, other].filter(Boolean).flatMap((model) => [
    h('th', { class: 'r' }, h('b', {}, `v${model.version} ${model.status}`)),
    h('th', { class: 'iv' }, '95 % interval'),
  ]);
  return h('table', { class: 'vt' }, h('thead', {}, h('tr', {}, h('th', {}, 'Parameter'), heads,
    h('th', {}, `Verdict${other ? ` v${other.version}` : ''}`))), h('tbody', {}, rows));
}

/** Nested figures as { 'a, b': value }. */
function flatten(value, path = []) {
  if (isNumber(value)) return { [path.join(', ')]: value };
  if (value === null || typeof value !== 'object' || Array.isArray(value)) return {};
  return Object.assign({}, ...Object.entries(value).map(([name, inner]) =>
    flatten(inner, [...path, plainName(name)])));
}

/** Scores of the versions, and what the naive forecasts reached on the same data. */
export function scoreTable(active, other) {
  const models = [active, other].filter(Boolean);
  const columns = models.map((model) => flatten(model.scores));
  const shown = other ?? active;
  const naive = Object.entries(shown?.naive ?? {}).map(([name, scores]) =>
    [plainName(name), flatten(scores)]);
  const rows = [...new Set(columns.flatMap(Object.keys))];
  if (!rows.length) return null;
  return h('table', { class: 'vt' },
    h('thead', {}, h('tr', {}, h('th', {}, 'Score on low-risk data'),
      models.map((model) => h('th', { class: 'r' }, `v${model.version}`)),
      naive.map(([name]) => h('th', { class: 'r' }, name)))),
    h('tbody', {}, rows.map((row) => h('tr', {}, h('td', {}, row),
      columns.map((column, i) => h('td', { class: i === columns.length - 1 ? 'r b' : 'r' },
        fixed(column[row], 2))),
      naive.map(([, scores]) => h('td', { class: 'r' }, fixed(scores[row], 2)))))));
}

/** The gates that a version had to pass: [{ name, passed, detail }] of whatever shape is told. */
export function gateList(gates) {
  if (!gates) return [];
  return Object.entries(gates).filter(([, gate]) =>
    typeof gate === 'boolean' || typeof gate?.passed === 'boolean').map(([name, gate]) => ({
    name: plainName(name),
    passed: typeof gate === 'boolean' ? gate : gate.passed,
    detail: typeof gate === 'boolean' ? '' : gate.detail ?? '',
  }));
}
