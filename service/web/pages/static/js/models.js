// Tables about model versions: parameters with intervals, scores, what the data inform.
import { h } from './dom.js';
import {
  channelName, counted, dayTime, fixed, isNumber, milliseconds, significant, spanText,
} from './format.js';
import { icon } from './icons.js';

const VERDICTS = { informed: 'chip on', weak: 'chip', 'prior only': 'chip dot' };
const STATUS_CHIPS = { active: 'chip on', rejected: 'chip dash', retired: 'chip dot' };
const COMBINATIONS_LISTED = 8;

export const statusChip = (status) =>
  h('span', { class: STATUS_CHIPS[status] ?? 'chip' }, status);
const verdictChip = (verdict) => h('span', { class: VERDICTS[verdict] ?? 'chip' }, verdict ?? '–');

const NAIVE = { static_linear: 'linear', arx: 'ARX' };
const plainName = (name) => NAIVE[name] ?? name.replaceAll('_', ' ');
const versionName = (model) => `v${model.version} ${model.status}`;

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

function intervalBar(parameter, at, alone) {
  const { low, high, value, verdict, unit } = parameter;
  if (!isNumber(low) || !isNumber(high)) return '';
  const text = `${significant(low)} … ${significant(high)}${unit && unit !== '-' ? ` ${unit}` : ''}`;
  return [h('div', {
    class: `ivb${verdict === 'prior only' ? ' po' : ''}`, title: `95 %: ${text}`, 'aria-hidden': 'true',
  },
  h('i', { style: { left: `${at(low)}%`, right: `${100 - at(high)}%` } }),
  h('b', { style: { left: `${at(value)}%` } })),
  h('small', { class: 'mut nw' }, `${significant(low)} … ${significant(high)}`),
  alone && h('small', { class: 'mut nw' },
    `without sisters ${significant(alone.low)} … ${significant(alone.high)}`)];
}

/** Parameters of one version, and of another next to it. */
export function parameterTable(left, right) {
  const models = [left, right].filter(Boolean);
  const names = [...new Set(models.flatMap((model) => Object.keys(model.parameters ?? {})))];
  const rows = names.map((name) => {
    const both = models.map((model) => model.parameters?.[name]);
    const known = both.filter(Boolean);
    const at = scaleOf(known);
    const cells = both.map((parameter, i) => [
      h('td', { class: i ? 'r b' : 'r' }, significant(parameter?.value)),
      h('td', { class: 'iv' }, parameter
        && intervalBar(parameter, at, models[i].sisters?.without_them[name])),
      h('td', { class: 'vd' }, parameter && verdictChip(parameter.verdict)),
    ]);
    const { unit: unitText, description } = known[0];
    const hasUnit = unitText && !['1', '-'].includes(unitText);
    return h('tr', {}, h('td', { class: 'pn' }, description?.replace('W/m2K', 'W/(m²·K)') ?? plainName(name),
      h('span', { class: 'u' }, description ? plainName(name) : '',
        hasUnit ? `, ${unitText}` : '')), cells);
  });
  const heads = models.map((model) => [
    h('th', { class: 'r' }, h('b', {}, versionName(model))),
    h('th', { class: 'iv' }, '95 % interval'), h('th', {}, 'Verdict'),
  ]);
  return h('table', { class: 'vt' },
    h('thead', {}, h('tr', {}, h('th', {}, 'Parameter'), heads)), h('tbody', {}, rows));
}

/** One figure for all sensors: the root of their mean square. */
function together(byChannel) {
  const values = Object.values(byChannel ?? {}).filter(isNumber);
  if (!values.length) return null;
  return Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
}

/** Rows of one version: what its nested fits predicted, and what others did on the same data. */
function scoreRows(model) {
  const tests = Object.entries(model.scores ?? {})
    .filter(([, score]) => isNumber(score?.nested_rms_k));
  return tests.map(([test, score]) => ({
    model,
    name: `${test} to ${fixed(score.speed_rpm, 0)} rpm, ${fixed(score.load_n, 0)} N`,
    own: score.nested_rms_k,
    active: score.active_rms_k,
    seen: score.active_has_seen_it,
    naive: Object.fromEntries(Object.entries(model.naive?.[test] ?? {})
      .map(([name, byChannel]) => [name, together(byChannel)])),
  }));
}

/** Scores on data that a version had not seen, next to the naive forecasts on the same data. */
export function scoreTable(models) {
  const rows = models.flatMap(scoreRows);
  if (!rows.length) {
    return h('p', { class: 's mut' }, 'No scores yet: no test on unseen data.');
  }
  const naive = [...new Set(rows.flatMap((row) => Object.keys(row.naive)))];
  const other = (value, own, note) => h('td', { class: value < own ? 'r lose' : 'r' },
    fixed(value, 2), note);
  return h('table', { class: 'vt' },
    h('thead', {}, h('tr', {}, h('th', {}, 'Unseen low-risk data, rms in K'),
      ['', 'this version', 'active model at the time', ...naive.map(plainName)].map((text, i) =>
        h('th', { class: i ? 'r' : null }, text)))),
    h('tbody', {}, rows.map((row) => {
      const loses = Object.values({ ...row.naive, active: row.seen ? null : row.active })
        .some((value) => isNumber(value) && value < row.own);
      return h('tr', {}, h('td', {}, row.name), h('td', { class: 'b' }, `v${row.model.version}`),
        h('td', { class: loses ? 'r lose' : 'r b' }, loses && [icon(2, 'hollow'), ' '],
          fixed(row.own, 2)),
        other(row.active, row.seen ? -1 : row.own,
          row.seen && h('span', { class: 'u' }, 'trained on it')),
        naive.map((name) => other(row.naive[name], row.own)));
    })));
}

/** How well each version meets the data it was trained with. */
export function trainingText(model) {
  const figures = Object.entries(model.scores?.train_rms_k ?? {}).map(([channel, value]) =>
    `${channelName(channel).toLowerCase()} ${fixed(value, 2)} K`);
  return figures.length ? `rms on the training windows: ${figures.join(', ')}` : 'not identified';
}

/** Which combinations of parameters the data of a version inform, and which not. */
export function combinationList(model) {
  const identifiability = model.identifiability;
  if (!identifiability) return h('p', { class: 's mut' }, `v${model.version}: no identifiability data.`);
  const { informed, weak, prior_only: priorOnly, rank, condition, combinations } = identifiability;
  const head = `v${model.version}: ${informed} informed, ${weak ?? 0} weak, ${priorOnly ?? 0} prior `
    + `only; rank ${rank}${isNumber(condition) ? `, condition ${significant(condition)}` : ''}`;
  const shown = combinations ?? [];
  const rows = shown.length > 2 * COMBINATIONS_LISTED
    ? [...shown.slice(0, COMBINATIONS_LISTED), null, ...shown.slice(-COMBINATIONS_LISTED)] : shown;
  return h('div', {}, h('p', { class: 's b' }, head), h('table', {},
    h('thead', {}, h('tr', {}, ['Combination', 'remaining spread', 'Verdict'].map((text, i) =>
      h('th', { class: i === 1 ? 'r' : null }, text)))),
    h('tbody', {}, rows.map((one) => (one === null
      ? h('tr', {}, h('td', { colspan: 3, class: 'mut' }, `… ${shown.length - 2
        * COMBINATIONS_LISTED} more`))
      : h('tr', {}, h('td', {}, one.combination.replaceAll('-', '−')),
        h('td', { class: 'r' }, `${fixed(one.std_over_prior * 100, 1)} %`),
        h('td', {}, verdictChip(one.verdict))))))));
}

const REASON_LENGTH = 400;

/** The machines of the family that a version has learned from, or why it has not. */
export function sisterList(model) {
  const { sisters } = model;
  if (!sisters) return h('p', { class: 's mut' }, `v${model.version}: no sisters.`);
  const { used, accepted, reason, set_aside: aside, calibrated_runs: runs } = sisters;
  const head = accepted
    ? `v${model.version}: learned from ${counted(used, 'sister')}`
      + (runs ? `; ${counted(runs, 'run')} of theirs ${runs === 1 ? 'tests' : 'test'} the band` : '')
    : `v${model.version}: rests on its own data, ${counted(used, 'sister')} asked`;
  const others = Object.entries(aside);
  return h('div', {}, h('p', { class: 's b' }, head),
    h('p', { class: 's' }, plainText(reason.slice(0, REASON_LENGTH))),
    h('table', {}, h('thead', {}, h('tr', {}, ['Sister', 'load seen, N', 'speed seen, rpm'].map((text, i) =>
      h('th', { class: i ? 'r' : null }, text)))),
    h('tbody', {}, sisters.names.map((name, i) => h('tr', {}, h('td', {}, name),
      h('td', { class: 'r' }, fixed(sisters.loads_n[i], 0)),
      h('td', { class: 'r' }, fixed(sisters.speeds_rpm[i], 0)))))),
    others.length ? h('p', { class: 's' }, 'Not used: ',
      others.map(([name, why]) => `${name} (${why})`).join('; ')) : '');
}

/** The windows a version was learned from. */
export function windowList(model) {
  const windows = model.windows ?? [];
  if (!windows.length) return h('p', { class: 's mut' }, `v${model.version}: no training windows.`);
  return h('div', {}, h('p', { class: 's b' }, `v${model.version}: ${counted(windows.length, 'window')}`),
    h('table', {}, h('tbody', {}, windows.map((window) => {
      const [start, end] = [milliseconds(window.start), milliseconds(window.end)];
      return h('tr', {}, h('td', { class: 'nw' }, dayTime(start)),
        h('td', { class: 'nw' }, spanText((end - start) / 1000)),
        h('td', {}, `up to ${fixed(window.speed_rpm_max, 0)} rpm, `
          + `${fixed(window.load_n_max, 0)} N`));
    }))));
}

/** A text of the service with the channel names of the page. */
export const plainText = (text) =>
  text.replace(/\bt_\w+_c\b/g, (name) => channelName(name).toLowerCase())
    .replaceAll(' degC', ' °C').replace(/(^|[\s(])-(?=\d)/g, '$1−');

/** The gates that a version had to pass. */
export function gateList(model) {
  return h('ul', { class: 'gates' }, (model.gates?.checks ?? []).map((gate) => h('li', {},
    gate.passed ? icon('ok') : icon(2, 'hollow'),
    h('span', {}, gate.passed ? plainText(gate.detail)
      : ['failed: ', plainText(gate.detail)]))));
}
