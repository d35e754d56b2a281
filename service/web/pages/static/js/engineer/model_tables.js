// Tables about model versions: parameters with intervals, scores, what the data inform.
import { plainTable, v } from '../parts/panel.js';
import { counted, dayTime, fixed, isNumber, lowerName, milliseconds, significant, spanText } from '../parts/format.js';
import { icon } from '../parts/icons.js';

const VERDICTS = { informed: 'chip on', weak: 'chip', 'prior only': 'chip dot' };
const STATUS_CHIPS = { active: 'chip on', rejected: 'chip dash', retired: 'chip dot' };
const COMBINATIONS_LISTED = 8;

export const statusChip = (status) => v('span', { class: STATUS_CHIPS[status] ?? 'chip' }, status);
const verdictChip = (verdict) => v('span', { class: VERDICTS[verdict] ?? 'chip' }, verdict ?? '–');
const NAIVE = { static_linear: 'linear', arx: 'ARX' };
const plainName = (name) => NAIVE[name] ?? name.replaceAll('_', ' ');

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
  return [v('div', {
    class: `ivb${verdict === 'prior only' ? ' po' : ''}`, title: `95 %: ${text}`, 'aria-hidden': 'true',
  },
  v('i', { style: { left: `${at(low)}%`, right: `${100 - at(high)}%` } }),
  v('b', { style: { left: `${at(value)}%` } })),
  v('small', { class: 'mut nw' }, `${significant(low)} … ${significant(high)}`),
  alone && v('small', { class: 'mut nw' },
    `without sisters ${significant(alone.low)} … ${significant(alone.high)}`)];
}

export function parameterTable(left, right) {
  const models = [left, right].filter(Boolean);
  const names = [...new Set(models.flatMap((model) => Object.keys(model.parameters ?? {})))];
  const rows = names.map((name) => {
    const both = models.map((model) => model.parameters?.[name]);
    const [{ unit, description }] = both.filter(Boolean);
    const unitText = unit && !['1', '-'].includes(unit) ? `, ${unit}` : '';
    return { name, both, at: scaleOf(both.filter(Boolean)),
      text: description?.replace('W/m2K', 'W/(m²·K)') ?? plainName(name),
      more: (description ? plainName(name) : '') + unitText };
  });
  return plainTable([['Parameter', ({ text, more }) => [text, v('span', { class: 'u' }, more)], 'pn'],
    ...models.flatMap((model, i) => [
      [v('th', { class: 'r' }, v('b', {}, `v${model.version} ${model.status}`)),
        ({ both }) => significant(both[i]?.value), i ? 'r b' : 'r'],
      ['95 % interval', ({ both, at, name }) => both[i]
        && intervalBar(both[i], at, model.sisters?.without_them[name]), 'iv', 'iv'],
      ['Verdict', ({ both }) => both[i] && verdictChip(both[i].verdict), 'vd'],
    ])], rows, { look: 'vt' });
}

/** One figure for all sensors: the root of their mean square. */
function together(byChannel) {
  const values = Object.values(byChannel ?? {}).filter(isNumber);
  if (!values.length) return null;
  return Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);
}

/** Rows of one version: what its nested fits predicted, and what others did on the same data. */
function scoreRows(model) {
  const tests = Object.entries(model.scores ?? {}).filter(([, score]) => isNumber(score?.nested_rms_k));
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
    return v('p', { class: 's mut' }, 'No scores yet: no test on unseen data.');
  }
  const naive = [...new Set(rows.flatMap((row) => Object.keys(row.naive)))];
  const other = (value, own, note) => v('td', { class: value < own ? 'r lose' : 'r' }, fixed(value, 2), note);
  return plainTable([['Unseen low-risk data, rms in K', ({ name }) => name],
    [v('th'), ({ model }) => `v${model.version}`, 'b'],
    ['this version', (row) => {
      const loses = Object.values({ ...row.naive, active: row.seen ? null : row.active })
        .some((value) => isNumber(value) && value < row.own);
      return v('td', { class: loses ? 'r lose' : 'r b' }, loses && [icon(2, 'hollow'), ' '], fixed(row.own, 2));
    }, '', 'r'],
    ['active model at the time', (row) => other(row.active, row.seen ? -1 : row.own,
      row.seen && v('span', { class: 'u' }, 'trained on it')), '', 'r'],
    ...naive.map((name) => [plainName(name), (row) => other(row.naive[name], row.own), '', 'r'])], rows,
  { look: 'vt' });
}

export function trainingText(model) {
  const figures = Object.entries(model.scores?.train_rms_k ?? {}).map(([channel, value]) =>
    `${lowerName(channel)} ${fixed(value, 2)} K`);
  return figures.length ? `rms on the training windows: ${figures.join(', ')}` : 'not identified';
}

/** Which combinations of parameters the data of a version inform, and which not. */
export function combinationList(model) {
  const identifiability = model.identifiability;
  if (!identifiability) return v('p', { class: 's mut' }, `v${model.version}: no identifiability data.`);
  const { informed, weak, prior_only: priorOnly, rank, condition, combinations } = identifiability;
  const head = `v${model.version}: ${informed} informed, ${weak ?? 0} weak, ${priorOnly ?? 0} prior `
    + `only; rank ${rank}${isNumber(condition) ? `, condition ${significant(condition)}` : ''}`;
  const shown = combinations ?? [];
  const rows = shown.length > 2 * COMBINATIONS_LISTED
    ? [...shown.slice(0, COMBINATIONS_LISTED), null, ...shown.slice(-COMBINATIONS_LISTED)] : shown;
  const of = (cell) => (one) => one && cell(one);
  return v('div', {}, v('p', { class: 's b' }, head), plainTable([
    ['Combination', (one) => one?.combination.replaceAll('-', '−')
      ?? v('td', { class: 'mut' }, `… ${shown.length - 2 * COMBINATIONS_LISTED} more`)],
    ['remaining spread', of((one) => `${fixed(one.std_over_prior * 100, 1)} %`), 'r', 'r'],
    ['Verdict', of((one) => verdictChip(one.verdict))]], rows));
}

const REASON_LENGTH = 400;

/** The machines of the family that a version has learned from, or why it has not. */
export function sisterList(model) {
  const { sisters } = model;
  if (!sisters) return v('p', { class: 's mut' }, `v${model.version}: no sisters.`);
  const { used, accepted, reason, set_aside: aside, calibrated_runs: runs } = sisters;
  const head = accepted
    ? `v${model.version}: learned from ${counted(used, 'sister')}`
      + (runs ? `; ${counted(runs, 'run')} of theirs ${runs === 1 ? 'tests' : 'test'} the band` : '')
    : `v${model.version}: rests on its own data, ${counted(used, 'sister')} asked`;
  const others = Object.entries(aside);
  return v('div', {}, v('p', { class: 's b' }, head),
    v('p', { class: 's' }, plainText(reason.slice(0, REASON_LENGTH))),
    plainTable([['Sister', ({ name }) => name], ['load seen, N', ({ load }) => fixed(load, 0), 'r', 'r'],
      ['speed seen, rpm', ({ speed }) => fixed(speed, 0), 'r', 'r']],
    sisters.names.map((name, i) => ({ name, load: sisters.loads_n[i], speed: sisters.speeds_rpm[i] }))),
    others.length ? v('p', { class: 's' }, 'Not used: ',
      others.map(([name, why]) => `${name} (${why})`).join('; ')) : '');
}

const LAWS = { housing: 'housing and films' };

/** Where each law of a version comes from, and what would test those that are not tested. */
export function lawList({ version, laws }) {
  return v('div', {}, v('p', { class: 's b' }, `v${version}`), plainTable([
    ['Law', ([name]) => LAWS[name] ?? name], ['from', ([, { source }]) => source],
    ["family's", ([, { weight_family: weight }]) => `${fixed(weight * 100, 0)} %`, 'r', 'r'],
    ['on this machine', ([, { tested, settled_by: step }]) => tested ? 'tested'
      : `not tested${step ? `; ${step} would settle it` : ''}`]], Object.entries(laws)));
}

export function windowList(model) {
  const windows = model.windows ?? [];
  if (!windows.length) return v('p', { class: 's mut' }, `v${model.version}: no training windows.`);
  return v('div', {}, v('p', { class: 's b' }, `v${model.version}: ${counted(windows.length, 'window')}`),
    plainTable([['', ({ start }) => dayTime(milliseconds(start)), 'nw'],
      ['', ({ start, end }) => spanText((milliseconds(end) - milliseconds(start)) / 1000), 'nw'],
      ['', ({ speed_rpm_max: speed, load_n_max: load }) => `up to ${fixed(speed, 0)} rpm, ${fixed(load, 0)} N`]],
    windows));
}

/** A text of the service with the channel names of the page. */
export const plainText = (text) =>
  text.replace(/\bt_\w+_c\b/g, (name) => lowerName(name))
    .replaceAll(' degC', ' °C').replace(/(^|[\s(])-(?=\d)/g, '$1−');

export function gateList(model) {
  return v('ul', { class: 'gates' }, (model.gates?.checks ?? []).map((gate) => v('li', {},
    gate.passed ? icon('ok') : icon(2, 'hollow'),
    v('span', {}, gate.passed ? plainText(gate.detail) : ['failed: ', plainText(gate.detail)]))));
}
