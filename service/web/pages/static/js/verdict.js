// Words for a forecast that the user asks for (what-if). The machine's own verdict comes from the
// service: live_verdict.js. Pure functions: forecast and limits in, a verdict out.
import { coolsBelow, overSpan, timeToLimit } from './forecast.js';

/** Shares of forecast members: what is shown changes at these. */
export const THRESHOLDS = { atRisk: 0.05, notSafe: 0.5, alarm: 0.2 };

/** Priority that a look ahead deserves: 1 where the alarm limit is near, 2, or 0 for calm. */
export function priorityFor(warning, alarm) {
  if (alarm >= THRESHOLDS.alarm) return 1;
  return warning >= THRESHOLDS.atRisk ? 2 : 0;
}

/** Limits of the sensors that the forecast covers. */
const forecastLimits = (limits, forecast, fan) => Object.fromEntries(Object.entries(limits)
  .filter(([name]) => fan.bands[name] && forecast.time_to_limit?.[name]));

/** Of all sensors with limits, the one for which `rank` is highest. */
const worstSensor = (limits, assess, rank) => Object.entries(limits)
  .map(([sensor, own]) => ({ sensor, limits: own, ...assess(sensor, own) }))
  .toSorted((a, b) => rank(b) - rank(a))[0];

/** Is a whole profile safe? { word, priority, peak, cools }, word null without a forecast. */
export function judgeProfile({ forecast, fan, limits, nowMs }) {
  if (!fan) return { word: null };
  const [fromMs, toMs] = [fan.times[0], fan.times.at(-1)];
  const known = forecastLimits(limits, forecast, fan);
  const assess = (sensor, own) => {
    const chance = (level) => timeToLimit(forecast, sensor, level, nowMs).probability;
    return { ...overSpan(fan, sensor, own, fromMs, toMs), warning: chance('warning'), alarm: chance('alarm') };
  };
  const peaks = Object.entries(known).map(([sensor, own]) =>
    ({ sensor, limits: own, ...assess(sensor, own) }));
  const peak = worstSensor(known, assess, (one) =>
    (one.alarm >= THRESHOLDS.alarm ? 1 + one.alarm : one.warning)
      + 1e-6 * (one.high - one.limits.warning));
  if (!peak) return { word: null };
  const cools = cooling(fan, peaks, fromMs, toMs);
  const over = peak.warning >= THRESHOLDS.atRisk;
  return {
    word: !over ? 'safe' : cools ? 'recovering' : 'not safe', peak, cools, fromMs,
    priority: cools ? 0 : priorityFor(peak.warning, peak.alarm),
  };
}

/**
 * Over the limit only because it begins there: the result of `coolsBelow` for the sensor that takes
 * longest, or null when any sensor is likely to exceed its limit in another way.
 */
function cooling(fan, peaks, fromMs, toMs) {
  const over = peaks.filter((peak) => peak.warning >= THRESHOLDS.atRisk)
    .map(({ sensor, limits }) => ({
      sensor, limits, cools: coolsBelow(fan, sensor, limits.warning, fromMs, toMs),
    }));
  if (!over.length || over.some(({ cools }) => !cools)) return null;
  const { sensor, limits, cools } = over.toSorted((a, b) => b.cools.belowMs - a.cools.belowMs)[0];
  return { sensor, limits, ...cools };
}

/**
 * How long until a limit along a profile? { sensor, level, limitC, probability, median, earliest,
 * expected, endMs } with times in seconds from now; null without a forecast. Of a sensor over its
 * warning already, the alarm limit is asked for.
 */
export function timeAlongProfile({ forecast, fan, readings, limits, nowMs }) {
  if (!fan) return null;
  const endMs = fan.times.at(-1);
  const endS = (endMs - nowMs) / 1000;
  const assess = (sensor, own) => {
    const reading = readings.find((one) => one.sensor === sensor);
    const over = Boolean(reading?.usable && reading.value >= own.warning);
    const level = over ? 'alarm' : 'warning';
    const { high } = overSpan(fan, sensor, own, fan.times[0], endMs);
    return { level, over, high, ...timeToLimit(forecast, sensor, level, nowMs) };
  };
  const soonest = (one) => one.median ?? one.earliest ?? endS;
  const expected = (one) => one.probability >= THRESHOLDS.atRisk;
  const worst = worstSensor(forecastLimits(limits, forecast, fan), assess, (one) =>
    (expected(one) ? 1000 - soonest(one) / endS * 100 : 0)
      + (one.over && expected(one) ? 1000 : 0)
      + one.probability + 1e-3 * (one.high - one.limits.warning));
  if (!worst) return null;
  return { ...worst, limitC: worst.limits[worst.level], expected: expected(worst), endMs };
}
