// Model versions side by side: parameters with intervals, scores beside the naive forecasts.
import { h } from './dom.js';
import { channelName, fixed, isNumber, significant } from './format.js';
import { icon } from './icons.js';

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
    const { unit: unitText, description } = both[0] ?? both[1];
    const hasUnit = unitText && !['1', '-'].includes(unitText);
    return h('tr', {}, h('td', {}, description ?? plainName(name),
      h('span', { class: 'u' }, description ? plainName(name) : '',
        hasUnit ? ` ${unitText}` : '')), cells,
    h('td', {}, h('span', { class: VERDICTS[verdict] ?? 'chip' }, verdict ?? '–')));
  });
  const heads = [active, other].filter(Boolean).flatMap((model) => [
    h('th', { class: 'r' }, h('b', {}, `v${model.version} ${model.status}`)),
    h('th', { class: 'iv' }, '95 % interval'),
  ]);
  return h('table', { class: 'vt' }, h('thead', {}, h('tr', {}, h('th', {}, 'Parameter'), heads,
    h('th', {}, `Verdict${other ? ` v${other.version}` : ''}`))), h('tbody', {}, rows));
}

const TRAINING = 'train_rms_k';

/** One figure for both rings: the root of their mean square. */
function together(byChannel) {
  const values = Object.values(byChannel ?? {}).filter(isNumber);
  if (!values.length) return null;
  return Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
}

/** Rows of scores: { name, of(model), naive: { name: figure } }, all in K. */
function scoreRows(shown) {
  const training = Object.keys(shown.scores?.[TRAINING] ?? {}).map((channel) => ({
    name: `${channelName(channel)}, rms on the data it was trained with`,
    of: (model) => model.scores?.[TRAINING]?.[channel],
    naive: {},
  }));
  const tests = Object.entries(shown.scores ?? {})
    .filter(([, score]) => isNumber(score?.nested_rms_k))
    .map(([test, score]) => ({
      name: `${test.charAt(0).toUpperCase()}${test.slice(1)} to ${fixed(score.speed_rpm, 0)} rpm, `
        + `${fixed(score.load_n, 0)} N, rms without having seen it`,
      of: (model) => model.scores?.[test]?.nested_rms_k,
      naive: Object.fromEntries(Object.entries(shown.naive?.[test] ?? {})
        .map(([name, byChannel]) => [name, together(byChannel)])),
    }));
  return [...training, ...tests];
}

/** Scores of the versions, and what the naive forecasts reached on the same data. */
export function scoreTable(active, other) {
  const models = [active, other].filter(Boolean);
  const shown = other ?? active;
  const rows = scoreRows(shown);
  if (!rows.length) return null;
  const naive = [...new Set(rows.flatMap((row) => Object.keys(row.naive)))];
  const cells = (row) => {
    const own = row.of(shown);
    return [
      models.map((model) => h('td', { class: model === shown ? 'r b' : 'r' },
        fixed(row.of(model), 2))),
      naive.map((name) => h('td', { class: row.naive[name] < own ? 'r lose' : 'r' },
        fixed(row.naive[name], 2))),
    ];
  };
  return h('table', { class: 'vt' },
    h('thead', {}, h('tr', {}, h('th', {}, 'Low-risk data, K'),
      models.map((model) => h('th', { class: 'r' }, `v${model.version}`)),
      naive.map((name) => h('th', { class: 'r' }, plainName(name))))),
    h('tbody', {}, rows.map((row) => h('tr', {}, h('td', {}, row.name), cells(row)))));
}

/** The gates that a version had to pass. */
export function gateList(model) {
  return h('ul', { class: 'gates' }, (model.gates?.checks ?? []).map((gate) => h('li', {},
    gate.passed ? icon('ok') : icon(2, 'hollow'),
    h('span', {}, gate.passed ? gate.detail : ['not passed: ', gate.detail]))));
}
