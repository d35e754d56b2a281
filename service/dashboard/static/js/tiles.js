// The answer tiles: one word, one figure, the reason below. Words come from verdict.js.
import { bold, h, unit } from './dom.js';
import {
  ageText, channelName, celsius, fixed, hourMinute, joined, percent, spanNodes, spanText, timeElement,
  wholeMinute,
} from './format.js';
import { icon } from './icons.js';
import { LOADING } from './situation.js';
import { THRESHOLDS } from './verdict.js';

const SYMBOL = '.86em';
const calm = () => icon('ok', 'filled', '.8em');
const nothing = () => icon('none', 'filled', '.8em');
const lower = (sensor) => channelName(sensor).toLowerCase();

/** No sensor is behind what is said. */
const twinAlone = () => h('b', { class: 'bt' }, 'twin alone');

/** Figures and their units stay on one line, however deep the parts are nested. */
function keep(part) {
  if (typeof part === 'string') return joined(part);
  return Array.isArray(part) ? part.map(keep) : part;
}

/** parts: { look, label, title, symbol, word, figure, note, why: [lines], small, extra }. */
function tile({ look = '', label, title, symbol = null, word, figure, note, why = [], small, extra }) {
  return h('section', { class: `ans ${look}`, 'aria-label': label },
    h('h2', {}, title),
    h('p', { class: 'big' }, symbol, h('span', { class: 'word' }, word),
      figure && h('span', { class: 'fig' }, figure, note && h('small', {}, note))),
    why.map((line) => h('p', { class: 'why' }, keep(line))),
    small && h('p', { class: 'why2' }, keep(small)), extra);
}

const unknown = (label, title, why) => tile({
  look: 'bad', label, title, symbol: icon('bad', 'hollow', SYMBOL), word: 'Unknown', why: [why],
});

/** A linear gauge: pointer = measured, bar = what the forecast may reach, ticks = limits. */
function gauge(reading, high, crossing) {
  const { warning, alarm } = reading.limits;
  const [low, top] = [20, alarm + 10];
  const at = (value) => Math.max(0, Math.min(100, (value - low) / (top - low) * 100));
  const range = (from, to, look) => to > from && h('span', {
    class: `rng ${look}`, style: { left: `${at(from)}%`, width: `${at(to) - at(from)}%` },
  });
  const limit = (value, look) => h('span', {
    class: `lim ${look}`, style: { left: `${at(value)}%` },
  }, h('i', {}, String(value)));
  const { value } = reading;
  const far = Math.max(high ?? value, value);
  return h('div', { class: 'gauge', 'aria-hidden': 'true' },
    range(value, Math.min(far, warning), ''),
    range(Math.max(value, warning), Math.min(far, alarm), 'w'),
    range(Math.max(value, alarm), far, 'a'),
    limit(warning, crossing.warning ? 'w' : ''), limit(alarm, crossing.alarm ? 'a' : ''),
    h('span', { class: 'ptr', style: { left: `${at(value)}%` } }));
}

/** Is it safe now? `high` is the forecast's 97.5 % peak of the same sensor, or null. */
export function nowTile(answer, high) {
  const { word, reading } = answer;
  const label = 'Is it safe now';
  const title = 'Now';
  if (!reading) return unknown(label, title, 'no temperature has been measured yet');
  if (word === 'unknown') {
    const age = reading.ageS === null ? 'never had a value'
      : ['last value is ', bold(ageText(reading.ageS)), ' old'];
    const shown = reading.value !== null;
    return tile({
      look: 'bad', label, title, symbol: icon('bad', 'hollow', SYMBOL), word: 'Unknown',
      figure: shown && h('span', { class: 'st' }, celsius(reading.value)),
      note: shown && 'last value', why: [[`${lower(reading.sensor)}, `, age]],
      extra: shown && gauge(reading, high, {}),
    });
  }
  const { warning } = reading.limits;
  const of = `${lower(reading.sensor)}, `;
  const figure = h('span', {}, celsius(reading.value));
  const threat = { warning: (high ?? 0) > warning, alarm: (high ?? 0) > reading.limits.alarm };
  const common = {
    label, title, figure, note: 'measured',
    extra: gauge(reading, high, threat),
  };
  if (word === 'over') {
    const limit = reading.limits[answer.level];
    return tile({
      ...common, look: `solid p${answer.priority}`, symbol: icon(answer.priority, 'inverse', SYMBOL),
      word: ['Over ', String(limit), unit('°C')],
      why: [[of, bold(`${fixed(reading.value - limit)} K`), ` over ${answer.level} ${limit} °C`]],
    });
  }
  const margin = [of, bold(`${fixed(warning - reading.value)} K`), ` below warning ${warning} °C`];
  const words = { safe: 'Safe', 'safe now': 'Safe now', rest: 'At rest' };
  return tile({
    ...common, symbol: word === 'rest' ? nothing() : calm(), word: words[word], why: [margin],
  });
}

const LOOKS = { 0: '', 1: 'p1', 2: 'p2' };
const aheadSymbol = (priority) => (priority ? icon(priority, 'dashed', SYMBOL) : calm());
const WORDS = { safe: 'Safe', risk: 'At risk', unsafe: 'Not safe' };

export const noForecastTile = (label, title, why) => tile({
  look: 'none', label, title, symbol: nothing(), why: [why],
  word: why === LOADING ? '…' : 'No forecast',
});

export const awayTile = (label, title) => unknown(label, title, 'the service does not answer');

/** Is the next step safe? */
export function nextStepTile(answer, { nowMs, alone, planned }) {
  const { peak, step, held, fromMs } = answer;
  const rest = planned ? 'This step, the last one planned' : 'Present point, held';
  const title = held ? rest : ['Next step in ', spanText((fromMs - nowMs) / 1000), ', ',
      timeElement(wholeMinute(fromMs))];
  const point = [bold(`${fixed(step.speed_rpm, 0)} rpm`), `, ${fixed(step.load_n, 0)} N, `,
    spanText(step.duration_s)];
  if (answer.cools) {
    const words = coolingWords(answer);
    return tile({
      look: LOOKS[answer.priority], label: 'Is the next step safe', title,
      symbol: aheadSymbol(answer.priority), ...words, why: [...words.why, point],
      small: [words.small, alone && [', ', twinAlone()]],
    });
  }
  return tile({
    look: LOOKS[answer.priority], label: 'Is the next step safe', title,
    symbol: aheadSymbol(answer.priority), word: WORDS[answer.word], figure: percent(peak.warning),
    note: `over ${peak.limits.warning} °C`, why: [point],
    small: [`${lower(peak.sensor)} peak ${fixed(peak.median)} °C, 95 % `,
      `${fixed(peak.low)} … ${fixed(peak.high)}`, alone && [', ', twinAlone()]],
  });
}

/**
 * Over the limit already, and on the way down: the step is not what brings the danger, and the
 * figure is how long it lasts.
 */
function coolingWords({ cools, fromMs }) {
  const { sensor, limits, fromC, belowMs, surelyMs } = cools;
  return {
    word: 'Not safe yet', figure: h('span', {}, spanNodes((belowMs - fromMs) / 1000)),
    note: `then below ${limits.warning} °C`,
    why: [[bold(`cools from ${fixed(fromC)} °C`), ', below by ', timeElement(belowMs),
      surelyMs !== null && [', 97.5 % by ', timeElement(surelyMs)]]],
    small: lower(sensor),
  };
}

/** Is a whole profile safe? `answer` is that of `answerNextStep` over its whole length. */
export function profileTile(answer) {
  const { peak } = answer;
  const common = {
    look: LOOKS[answer.priority], label: 'Is this profile safe', title: 'This profile',
    symbol: aheadSymbol(answer.priority),
  };
  if (answer.cools) return tile({ ...common, ...coolingWords(answer) });
  return tile({
    ...common, word: WORDS[answer.word],
    why: [joined(`${percent(peak.warning)} over ${peak.limits.warning} °C, `
      + `${percent(peak.alarm)} over ${peak.limits.alarm} °C`)],
  });
}

/** The hottest moment of a profile; `planned` is that of the plan, or null. */
export function peakTile({ peak }, planned) {
  return tile({
    label: 'Peak', title: `Peak ${lower(peak.sensor)}`, word: celsius(peak.median),
    why: [['97.5 % below ', bold(`${fixed(peak.high)} °C`),
      planned && `, as planned ${fixed(planned.median)} °C`]],
  });
}

/** How long until a limit? */
export function timeToLimitTile(answer, { nowMs, alone }) {
  const label = 'Time to limit';
  const { sensor, limits, level, asked, alarm, peak, endS } = answer;
  if (answer.word === 'none') {
    return tile({
      label, title: 'Time to limit', symbol: calm(), word: 'None',
      figure: percent(asked.probability), note: `over ${limits[level]} °C`,
      why: [`to ${level} ${limits[level]} °C until ${hourMinute(nowMs + endS * 1000)}`,
        [`${lower(sensor)} peak ${fixed(peak.median)} °C, 97.5 % below ${fixed(peak.high)} °C`]],
      small: alone && twinAlone(),
    });
  }
  const crosses = asked.median !== null;
  const first = asked.earliest ?? asked.median ?? endS;
  const what = [`${lower(sensor)} to `, bold(`${level} ${limits[level]} °C`),
    crosses && asked.earliest !== null && `, earliest ${spanText(asked.earliest)}`];
  const more = [];
  if (level === 'warning' && alarm.probability >= 0.005) {
    more.push([`to alarm ${limits.alarm} °C `, bold(percent(alarm.probability)),
      alarm.earliest !== null && alarm.probability >= THRESHOLDS.atRisk
        && `, earliest ${spanText(alarm.earliest)}`]);
  }
  if (!crosses) more.push('the median stays below it');
  return tile({
    look: LOOKS[answer.priority], label, title: 'Time to limit',
    symbol: aheadSymbol(answer.priority),
    word: crosses ? spanNodes(asked.median) : ['from ', spanNodes(first)],
    figure: percent(asked.probability), note: 'probability', why: [what, more[0]].filter(Boolean),
    small: alone && twinAlone(),
  });
}
