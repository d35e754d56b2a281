// The answer tiles: one word, one figure, the reason below. The words are the service's.
import { v } from '../parts/panel.js';
import { coolsBelow, overSpan, timeToLimit } from './forecast.js';
import {
  ageText, celsius, fixed, hourMinute, isNumber, joined, lowerName, percent, pointFigure, spanNodes,
  spanText, timeElement, wholeMinute,
} from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { lacksModelOnly } from '../live/verdict.js';
import { LOADING } from '../live/situation.js';
import { ALARM_LIKELY } from './verdict.js';

const SYMBOL = '.86em';
const calm = () => icon('ok', 'filled', '.8em');
const nothing = () => icon('none', 'filled', '.8em');
const WORDS = { safe: 'Safe', 'not safe': 'Not safe', recovering: 'Recovering', unknown: 'Unknown' };

const twinAlone = () => v('b', { class: 'bt' }, 'no sensor');

/** Figures and their units stay on one line, however deep the parts are nested. */
function keep(part) {
  if (typeof part === 'string') return joined(part);
  return Array.isArray(part) ? part.map(keep) : part;
}

/** @param {Page.Tile} parts */
function tile({ look = '', label, title, symbol = null, word, figure, note, why = [], small, record, extra }) {
  return v('section', { class: `ans ${look}`, 'aria-label': label },
    v('h2', {}, title),
    v('p', { class: 'big' }, symbol, v('span', { class: 'word' }, word),
      figure && v('span', { class: 'fig' }, figure, note && v('small', {}, note))),
    why.map((line) => v('p', { class: 'why' }, keep(line))),
    small && v('p', { class: 'why2' }, keep(small)),
    record && v('p', { class: 'why2 record' }, `record: ${record}`), extra);
}

/**
 * Nothing is known; `doubtful`: because measured values are missing, not only a model.
 * @param {Page.Tile} parts
 */
const unknownTile = ({ label, title, why, small, doubtful = true, ...more }) => tile({
  look: doubtful ? 'bad' : 'none', label, title, why: [why], small, word: WORDS.unknown,
  symbol: doubtful ? icon('bad', 'hollow', SYMBOL) : nothing(), ...more,
});

/**
 * A linear gauge: pointer = measured, bar = what the forecast may reach (outline only until it
 * touches a limit), ticks = limits.
 */
function gauge(reading, high) {
  const { warning, alarm } = reading.limits;
  const [low, top] = [20, alarm + 10];
  const at = (value) => Math.max(0, Math.min(100, (value - low) / (top - low) * 100));
  const range = (from, to, look) => to > from && v('span', {
    class: `rng ${look}`, style: { left: `${at(from)}%`, width: `${at(to) - at(from)}%` },
  });
  const limit = (value, look) => v('span', {
    class: `lim ${look}`, style: { left: `${at(value)}%` },
  }, v('i', {}, String(value)));
  const { value } = reading;
  const far = Math.max(high ?? value, value);
  const touches = far >= warning;
  return v('div', { class: 'gauge', 'aria-hidden': 'true' },
    range(value, Math.min(far, warning), touches ? '' : 'out'),
    range(Math.max(value, warning), Math.min(far, alarm), 'w'),
    range(Math.max(value, alarm), far, 'a'),
    limit(warning, far > warning ? 'w' : ''), limit(alarm, far > alarm ? 'a' : ''),
    v('span', { class: 'ptr', style: { left: `${at(value)}%` } }));
}

/** Figure and gauge of the temperature next to the word; struck through when it is not current. */
function measured(reading, high) {
  if (!reading || reading.value === null) return {};
  return {
    figure: reading.usable ? v('span', {}, celsius(reading.value))
      : v('span', { class: 'st' }, celsius(reading.value)),
    note: reading.usable ? 'measured' : ['last value, ', ageText(reading.ageS), ' old'],
    extra: reading.limits && gauge(reading, high),
  };
}

/** Is it safe now? `now` is the situation; `high` the forecast's 97.5 % peak of the sensor shown. */
export function nowTile(now, high) {
  const { now: answer } = now.verdict;
  const { reading, standing } = now;
  const common = { label: 'Is it safe now', title: 'Now', ...measured(reading, high) };
  if (answer.word === 'unknown') {
    // A temperature over its limit comes first, whatever else is missing.
    const over = answer.limit && [v('b', {}, answer.reasons[0]), '; '];
    return unknownTile({ ...common, why: [over, now.missingText].filter(Boolean) });
  }
  const of = reading ? `${lowerName(reading.sensor)}, ` : '';
  const missing = now.lostText && v('b', { class: 'bt' }, now.lostText);
  const rest = restOfStep(now);
  if (answer.word === 'safe' && rest) {
    return tile({
      ...common, look: LOOKS[rest.priority], symbol: aheadSymbol(rest.priority), word: 'Safe now',
      why: [rest.why], small: ambientNote(answer),
    });
  }
  if (answer.word === 'safe') {
    const { warning } = reading?.limits ?? {};
    return tile({
      ...common, symbol: calm(), word: WORDS.safe, small: ambientNote(answer),
      why: [reading ? [of, v('b', {}, `${fixed(warning - reading.value)} K`), ` below warning ${warning} °C`]
        : answer.reasons[0]],
    });
  }
  const limit = answer.limit?.value_c;
  const why = isNumber(limit) ? [of, v('b', {}, `${fixed(reading.value - limit)} K`),
    ` over ${answer.limit.level} ${limit} °C`] : answer.reasons[0];
  if (answer.word === 'recovering') {
    return tile({
      ...common, look: LOOKS[rest?.priority ?? 0], symbol: rest ? aheadSymbol(rest.priority) : nothing(),
      word: WORDS.recovering, why: [why, rest?.why, missing].filter(Boolean),
    });
  }
  const priority = answer.limit?.level === 'alarm' ? 1 : standing ?? 2;
  return tile({
    ...common, look: `solid p${priority}`, symbol: icon(priority, 'inverse', SYMBOL),
    word: WORDS['not safe'], why: [why, missing].filter(Boolean),
  });
}

/** What the rest of the present step brings where it is not safe: { priority, why }, else null. */
function restOfStep({ nowMs, verdict: { present_step: answer, time } }) {
  if (answer.word !== 'not safe') return null;
  const { limit, probability, alarm_probability: alarm, seconds_to_limit: seconds } = answer;
  const left = isNumber(seconds) ? Math.max(0, seconds - (nowMs - Date.parse(time)) / 1000) : null;
  const over = limit && `over ${limit.value_c} °C`;
  const when = left === null ? [answer.reasons.at(-1)]
    : [v('b', {}, `${over} in ${spanText(left)}`), `, ${percent(probability)}`];
  return {
    priority: alarm >= ALARM_LIKELY ? 1 : 2, why: [v('b', {}, 'not to the end of this step'), ': ', ...when],
  };
}

const ambientNote = ({ reasons }) => reasons.find((reason) => reason.startsWith('ambient assumed'));
const LOOKS = { 0: '', 1: 'p1', 2: 'p2' };
const aheadSymbol = (priority) => (priority ? icon(priority, 'dashed', SYMBOL) : calm());

export const noForecastTile = (label, title, why) => tile({
  look: 'none', label, title, symbol: nothing(), why: [why],
  word: why === LOADING ? '…' : 'No forecast',
});

export const computingTile = (label, title) =>
  tile({ look: 'none', label, title, symbol: nothing(), word: v('small', {}, 'Computing …') });

export const offlineTile = (label, title) =>
  unknownTile({ label, title, why: 'the service does not answer' });

export const missingTile = (label, title, now, small) => unknownTile({
  label, title, why: now.missingText, doubtful: !lacksModelOnly(now.missing), small,
});

function lastPoint({ speed, load }) {
  const figures = [[speed, 'rpm'], [load, 'N']].filter(([{ value }]) => value !== null);
  return figures.length > 0 && figures.map(([reading, unit], i) => [i ? ', ' : '', pointFigure(reading, unit)]);
}

/** Is the next step safe? `record`: how forecasts like this one have done. */
export function nextStepTile(now, record = '') {
  const { nowMs, planned, steps, fan, alone } = now;
  const { next_step: answer } = now.verdict;
  const label = 'Is the next step safe';
  const held = steps.length < 2;
  const step = held ? steps[0] : steps[1];
  const rest = planned ? 'Current step (last)' : 'Hold current operating point';
  const title = held || !step ? rest : ['Next step in ', spanText((step.from - nowMs) / 1000), ', ',
      timeElement(wholeMinute(step.from))];
  if (answer.word === 'unknown') {
    const last = now.lostChannels.length > 0 && lastPoint(now);
    return missingTile(label, held ? 'Next step' : title, now, last);
  }
  const point = step && [v('b', {}, `${fixed(step.speed_rpm, 0)} rpm`), `, ${fixed(step.load_n, 0)} N, `,
    spanText(step.duration_s)];
  const { channel, value_c: limit } = answer.limit;
  const peak = fan?.bands[channel] && step && overSpan(fan, channel, step.from, step.to);
  const common = { label, title, record, why: [point].filter(Boolean) };
  if (answer.word === 'recovering') {
    const cools = peak && coolsBelow(fan, channel, limit, step.from, step.to);
    return tile({
      ...common, symbol: nothing(), word: WORDS.recovering,
      ...(cools ? coolingWords({ sensor: channel, limit, fromMs: step.from, ...cools }) : {}),
    });
  }
  const priority = answer.word === 'safe' ? 0 : answer.alarm_probability >= ALARM_LIKELY ? 1 : 2;
  // Over the limit where it begins, because of the step before: it cools all the same.
  const cools = priority && peak ? coolsBelow(fan, channel, limit, step.from, step.to) : null;
  if (cools) common.why.push(['cools down: ',
    coolingWords({ sensor: channel, fromMs: step.from, limit, ...cools }).why[0]]);
  return tile({
    ...common, look: LOOKS[priority], symbol: aheadSymbol(priority), word: WORDS[answer.word],
    figure: percent(answer.probability), note: `over ${limit} °C`,
    small: peak && [`${lowerName(channel)} peak ${fixed(peak.median)} °C, 95 % `,
      `${fixed(peak.low)} … ${fixed(peak.high)}`, alone && [', ', twinAlone()]],
  });
}

function coolingWords({ sensor, limit, fromMs, belowMs, surelyMs }) {
  const into = (ms) => spanText((ms - fromMs) / 1000);
  return {
    why: [[v('b', {}, `below ${limit} °C ${into(belowMs)} into the step`),
      surelyMs !== null && ` (97.5 %: ${into(surelyMs)})`]],
    small: lowerName(sensor),
  };
}

/** Is a whole profile safe? `answer` is that of `judgeProfile`. @param {any} answer */
export function profileTile(answer) {
  const { peak, cools, fromMs, word, priority } = answer;
  const common = {
    look: LOOKS[priority], label: 'Is this profile safe', title: 'This profile', word: WORDS[word],
  };
  if (word === 'recovering') {
    const { sensor, limits } = cools;
    return tile({ ...common, symbol: nothing(),
      ...coolingWords({ ...cools, sensor, limit: limits.warning, fromMs }) });
  }
  return tile({
    ...common, symbol: aheadSymbol(priority),
    why: [joined(`${percent(peak.warning)} over ${peak.limits.warning} °C, `
      + `${percent(peak.alarm)} over ${peak.limits.alarm} °C`)],
  });
}

export function peakTile(/** @type {any} */ { peak }, planned) {
  return tile({
    label: 'Peak', title: `Peak ${lowerName(peak.sensor)}`, word: celsius(peak.median),
    why: [['upper bound (97.5 %) ', v('b', {}, `${fixed(peak.high)} °C`),
      planned && `, as planned ${fixed(planned.median)} °C`]],
  });
}

const TO_LIMIT = 'Time to limit';

/** How long until a limit, by the service's word; figures run down with the page's clock. */
export function liveLimitTile(now) {
  const { time_to_limit: answer, time } = now.verdict;
  if (!answer) return missingTile(TO_LIMIT, TO_LIMIT, now);
  const { channel, level, value_c: limitC } = answer.limit;
  // As in the banner, from the forecast itself; the verdict's own figures until it is there.
  const crossing = now.forecast?.time_to_limit?.[channel]?.[level]
    ? timeToLimit(now.forecast, channel, level, now.nowMs)
    : { probability: answer.probability, median: answer.median_s, earliest: answer.earliest_s };
  return timeToLimitTile({
    sensor: channel, level, limitC, expected: answer.expected, ...crossing,
    endMs: Date.parse(time) + answer.horizon_s * 1000,
  }, now);
}

export function timeToLimitTile(answer, { alone, nowMs }) {
  const { sensor, level, limitC, probability, median, earliest, expected, endMs } = answer;
  const common = {
    label: TO_LIMIT, title: joined(`Time to ${level} ${limitC} °C`), figure: percent(probability),
    small: alone && twinAlone(),
  };
  if (!expected) {
    return tile({
      ...common, symbol: calm(), word: 'Not expected', note: 'probability',
      why: [`${lowerName(sensor)}, until ${hourMinute(endMs)}`],
    });
  }
  const crosses = isNumber(median);
  const priority = level === 'alarm' ? 1 : 2;
  const first = earliest ?? median ?? (endMs - nowMs) / 1000;
  return tile({
    ...common, look: LOOKS[priority], symbol: aheadSymbol(priority), note: 'probability',
    word: [v('small', {}, 'earliest in '), spanNodes(first)],
    why: [[lowerName(sensor), crosses ? [', median in ', v('b', {}, spanText(median))]
      : ', median stays below']],
  });
}
