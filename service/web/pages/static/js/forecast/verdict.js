// Words for a forecast that the user asks for (what-if, envelope). The machine's own verdict comes
// from the service: live/verdict.js. Pure functions: forecast, limits and the setting of the verdict in
// (`safe_below_probability` of the asset), a word out.
import { coolsBelow, overSpan, timeToLimit } from './forecast.js';
import { fixed, isNumber, percent } from '../parts/format.js';

/** From this probability of the alarm limit on a look ahead is red; it changes no word. */
export const ALARM_LIKELY = 0.2;

/** Below this probability of a warning the service calls what is ahead safe. */
export const safeBelow = (asset) => asset.verdict.safe_below_probability;

/** Colour that a look ahead deserves: 1 where the alarm limit is near, 2, or 0 for calm. */
export function priorityFor(warning, alarm, safe) {
  if (warning < safe) return 0;
  return alarm >= ALARM_LIKELY ? 1 : 2;
}

/** Each sensor with limits that the forecast knows, with what `assess` says of it. */
const assessed = ({ limits, forecast, fan }, assess) => Object.entries(limits)
  .filter(([sensor]) => fan.bands[sensor] && forecast.time_to_limit?.[sensor])
  .map(([sensor, own]) => ({ sensor, limits: own, ...overSpan(fan, sensor), ...assess(sensor, own) }));
const highestBy = (sensors, rank) => sensors.toSorted((a, b) => rank(b) - rank(a))[0];

export function judgeProfile(/** @type {any} */ { forecast, fan, limits, nowMs, safe }) {
  if (!fan) return { word: null };
  const chance = (sensor, level) => timeToLimit(forecast, sensor, level, nowMs).probability;
  const peaks = assessed({ limits, forecast, fan }, (sensor) =>
    ({ warning: chance(sensor, 'warning'), alarm: chance(sensor, 'alarm') }));
  const peak = highestBy(peaks, (one) =>
    (one.alarm >= ALARM_LIKELY ? 1 + one.alarm : one.warning) + 1e-6 * (one.high - one.limits.warning));
  if (!peak) return { word: null };
  const cools = cooling(fan, peaks.filter(({ warning }) => warning >= safe));
  const over = peak.warning >= safe;
  return {
    word: !over ? 'safe' : cools ? 'recovering' : 'not safe', peak, cools, fromMs: fan.times[0],
    priority: cools ? 0 : priorityFor(peak.warning, peak.alarm, safe),
  };
}

/**
 * Over the limit only because it begins there: the result of `coolsBelow` for the sensor that takes
 * longest, or null when any sensor is likely to exceed its limit in another way.
 */
function cooling(fan, likely) {
  const over = likely.map(({ sensor, limits }) => ({ sensor, limits, cools: coolsBelow(fan, sensor, limits.warning) }));
  if (!over.length || over.some(({ cools }) => !cools)) return null;
  const { sensor, limits, cools } = highestBy(over, (one) => one.cools.belowMs);
  return { sensor, limits, ...cools };
}

/**
 * How long until a limit along a profile? { sensor, level, limitC, probability, median, earliest,
 * expected, endMs } with times in seconds from now; null without a forecast. Of a sensor over its
 * warning already, the alarm limit is asked for.
 */
export function timeAlongProfile(/** @type {any} */ { forecast, fan, readings, limits, nowMs, safe }) {
  if (!fan) return null;
  const endMs = fan.times.at(-1);
  const endS = (endMs - nowMs) / 1000;
  const soonest = (one) => one.median ?? one.earliest ?? endS;
  const expected = (one) => one.probability >= safe;
  const first = highestBy(assessed({ limits, forecast, fan }, (sensor, own) => {
    const over = readings.some((one) => one.sensor === sensor && one.usable && one.value >= own.warning);
    const level = over ? 'alarm' : 'warning';
    return { level, over, ...timeToLimit(forecast, sensor, level, nowMs) };
  }), (one) => (expected(one) ? 1000 - soonest(one) / endS * 100 : 0) + (one.over && expected(one) ? 1000 : 0)
    + one.probability + 1e-3 * (one.high - one.limits.warning));
  return first ? { ...first, limitC: first.limits[first.level], expected: expected(first), endMs } : null;
}

const ROUND_N = 50; // newtons are not known better

/** The margin of a forecast's heaviest point; empty without an identified model. */
export function marginText(margin) {
  if (!margin) return '';
  const { margin_n: newtons, margin_k: kelvins, load_n: load, probability } = margin;
  // Loads up to twice that of the point are looked at.
  const parts = [isNumber(newtons) ? `${fixed(ROUND_N * Math.round(newtons / ROUND_N), 0)} N`
    : `more than ${fixed(load, 0)} N`];
  if (isNumber(kelvins)) parts.push(`${fixed(kelvins, 0)} K`);
  return `Margin to thermal runaway: ${parts.join(' / ')}, probability ${percent(probability)}`;
}

export function marginTitle(margin) {
  if (!margin) return '';
  const at = `${fixed(margin.speed_rpm, 0)} rpm, ${fixed(margin.load_n, 0)} N`;
  return `The heaviest point of this forecast, held for 8 h: ${at}. N: more load until the `
    + 'probability is 5 %. K: how much hotter until the bearing heats itself.';
}
