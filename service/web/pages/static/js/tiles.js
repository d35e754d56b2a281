// The answer tiles: one word, one figure, the reason below. The words are the service's.
import { bold, h, unit } from './dom.js';
import { coolsBelow, overSpan, timeToLimit } from './forecast.js';
import {
  ageText, channelName, celsius, fixed, hourMinute, isNumber, joined, percent, spanNodes, spanText,
  timeElement, wholeMinute,
} from './format.js';
import { icon } from './icons.js';
import { lacksModelOnly } from './live_verdict.js';
import { LOADING } from './situation.js';
import { THRESHOLDS } from './verdict.js';

const SYMBOL = '.86em';
const calm = () => icon('ok', 'filled', '.8em');
const nothing = () => icon('none', 'filled', '.8em');
const WORDS = {
  safe: 'Safe', 'not safe': 'Not safe', recovering: 'Recovering', unknown: 'Unknown',
};
const lower = (sensor) => channelName(sensor).toLowerCase();

/** The answer rests on no sensor. */
const twinAlone = () => h('b', { class: 'bt' }, 'no sensor');

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

/** Nothing is known; `doubtful`: because measured values are missing, not only a model. */
const unknown = ({ label, title, why, small, doubtful = true, ...more }) => tile({
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
  const range = (from, to, look) => to > from && h('span', {
    class: `rng ${look}`, style: { left: `${at(from)}%`, width: `${at(to) - at(from)}%` },
  });
  const limit = (value, look) => h('span', {
    class: `lim ${look}`, style: { left: `${at(value)}%` },
  }, h('i', {}, String(value)));
  const { value } = reading;
  const far = Math.max(high ?? value, value);
  const touches = far >= warning;
  return h('div', { class: 'gauge', 'aria-hidden': 'true' },
    range(value, Math.min(far, warning), touches ? '' : 'out'),
    range(Math.max(value, warning), Math.min(far, alarm), 'w'),
    range(Math.max(value, alarm), far, 'a'),
    limit(warning, far > warning ? 'w' : ''), limit(alarm, far > alarm ? 'a' : ''),
    h('span', { class: 'ptr', style: { left: `${at(value)}%` } }));
}

/** Figure and gauge of the temperature next to the word; struck through when it is not current. */
function measured(reading, high) {
  if (!reading || reading.value === null) return {};
  return {
    figure: reading.usable ? h('span', {}, celsius(reading.value))
      : h('span', { class: 'st' }, celsius(reading.value)),
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
    const over = answer.limit && [bold(answer.reasons[0]), '; '];
    return unknown({ ...common, why: [over, now.missingText].filter(Boolean) });
  }
  const of = reading ? `${lower(reading.sensor)}, ` : '';
  const missing = now.lostText && h('b', { class: 'bt' }, now.lostText);
  if (answer.word === 'safe') {
    const { warning } = reading?.limits ?? {};
    return tile({
      ...common, symbol: calm(), word: WORDS.safe, small: ambientNote(answer),
      why: [reading ? [of, bold(`${fixed(warning - reading.value)} K`), ` below warning ${warning} °C`]
        : answer.reasons[0]],
    });
  }
  const limit = answer.limit?.value_c;
  const why = isNumber(limit) ? [of, bold(`${fixed(reading.value - limit)} K`),
    ` over ${answer.limit.level} ${limit} °C`] : answer.reasons[0];
  if (answer.word === 'recovering') {
    return tile({ ...common, symbol: nothing(), word: WORDS.recovering, why: [why, missing].filter(Boolean) });
  }
  const priority = answer.limit?.level === 'alarm' ? 1 : standing ?? 2;
  return tile({
    ...common, look: `solid p${priority}`, symbol: icon(priority, 'inverse', SYMBOL),
    word: WORDS['not safe'], why: [why, missing].filter(Boolean),
  });
}

const ambientNote = ({ reasons }) => reasons.find((reason) => reason.startsWith('ambient assumed'));

const LOOKS = { 0: '', 1: 'p1', 2: 'p2' };
const aheadSymbol = (priority) => (priority ? icon(priority, 'dashed', SYMBOL) : calm());

export const noForecastTile = (label, title, why) => tile({
  look: 'none', label, title, symbol: nothing(), why: [why],
  word: why === LOADING ? '…' : 'No forecast',
});

export const awayTile = (label, title) =>
  unknown({ label, title, why: 'the service does not answer' });

/** What is missing, for a tile about what lies ahead. */
export const missingTile = (label, title, now, small) => unknown({
  label, title, why: now.missingText, doubtful: !lacksModelOnly(now.missing), small,
});

/** Speed and load that were known last, struck through. */
function lastPoint({ speed, load }) {
  const figures = [[speed, 'rpm'], [load, 'N']].filter(([{ value }]) => value !== null)
    .map(([{ value, usable }, name], i) => [i ? ', ' : '',
      h(usable ? 'span' : 's', {}, joined(`${fixed(value, 0)} ${name}`))]);
  return figures.length > 0 && figures;
}

/** Is the next step safe? */
export function nextStepTile(now) {
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
  const point = step && [bold(`${fixed(step.speed_rpm, 0)} rpm`), `, ${fixed(step.load_n, 0)} N, `,
    spanText(step.duration_s)];
  const { channel, value_c: limit } = answer.limit;
  const peak = fan?.bands[channel] && step
    && overSpan(fan, channel, now.limits[channel], step.from, step.to);
  const common = { label, title, why: [point].filter(Boolean) };
  if (answer.word === 'recovering') {
    const cools = peak && coolsBelow(fan, channel, limit, step.from, step.to);
    return tile({
      ...common, symbol: nothing(), word: WORDS.recovering,
      ...(cools ? coolingWords({ sensor: channel, limit, fromMs: step.from, ...cools }) : {}),
    });
  }
  const priority = answer.word === 'safe' ? 0 : answer.alarm_probability >= THRESHOLDS.alarm ? 1 : 2;
  return tile({
    ...common, look: LOOKS[priority], symbol: aheadSymbol(priority), word: WORDS[answer.word],
    figure: percent(answer.probability), note: `over ${limit} °C`,
    small: peak && [`${lower(channel)} peak ${fixed(peak.median)} °C, 95 % `,
      `${fixed(peak.low)} … ${fixed(peak.high)}`, alone && [', ', twinAlone()]],
  });
}

/** A span that begins over a limit and cools: when it is below. */
function coolingWords({ sensor, limit, fromMs, belowMs, surelyMs }) {
  const into = (ms) => spanText((ms - fromMs) / 1000);
  return {
    why: [[bold(`below ${limit} °C ${into(belowMs)} into the step`),
      surelyMs !== null && ` (97.5 %: ${into(surelyMs)})`]],
    small: lower(sensor),
  };
}

/** Is a whole profile safe? `answer` is that of `judgeProfile`. */
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

/** The hottest moment of a profile; `planned` is that of the plan, or null. */
export function peakTile({ peak }, planned) {
  return tile({
    label: 'Peak', title: `Peak ${lower(peak.sensor)}`, word: celsius(peak.median),
    why: [['upper bound (97.5 %) ', bold(`${fixed(peak.high)} °C`),
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

/** How long until a limit? */
export function timeToLimitTile(answer, { alone, nowMs }) {
  const { sensor, level, limitC, probability, median, earliest, expected, endMs } = answer;
  const common = {
    label: TO_LIMIT, title: joined(`Time to ${level} ${limitC} °C`), figure: percent(probability),
    small: alone && twinAlone(),
  };
  if (!expected) {
    return tile({
      ...common, symbol: calm(), word: 'Not expected', note: 'probability',
      why: [`${lower(sensor)}, until ${hourMinute(endMs)}`],
    });
  }
  const crosses = isNumber(median);
  const priority = level === 'alarm' ? 1 : 2;
  const first = earliest ?? median ?? (endMs - nowMs) / 1000;
  return tile({
    ...common, look: LOOKS[priority], symbol: aheadSymbol(priority), note: 'probability',
    word: [h('small', {}, 'earliest in '), spanNodes(first)],
    why: [[lower(sensor), crosses ? [', median in ', bold(spanText(median))]
      : ', median stays below']],
  });
}
