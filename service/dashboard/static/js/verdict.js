// The three answers. Pure functions: readings, limits and forecast in, a verdict out.
import { coolsBelow, overSpan, timeToLimit } from './forecast.js';

/** Shares of forecast members: the words change at these. */
export const THRESHOLDS = { atRisk: 0.05, notSafe: 0.5, alarm: 0.2 };

const STANDING_RPM = 5;
const COLD_C = 20;

/** The word for a probability of passing the warning limit. */
function wordFor(probability) {
  if (probability < THRESHOLDS.atRisk) return 'safe';
  return probability < THRESHOLDS.notSafe ? 'risk' : 'unsafe';
}

/** Priority that a look ahead deserves: 1 where the alarm limit is near, 2, or 0 for calm. */
function priorityFor(warning, alarm) {
  if (alarm >= THRESHOLDS.alarm) return 1;
  return warning >= THRESHOLDS.atRisk ? 2 : 0;
}

const levelOf = (reading) => {
  if (reading.value >= reading.limits.alarm) return 1;
  return reading.value >= reading.limits.warning ? 2 : 0;
};

/**
 * Is it safe now?
 *
 * readings: [{ sensor, value, usable, ageS, limits: { warning, alarm } }] of all sensors with
 * limits. A usable sensor over a limit is a fact; failing that, one unusable sensor makes the
 * answer unknown.
 */
export function answerNow({ readings, speedRpm, trusted }) {
  const usable = readings.filter((reading) => reading.usable);
  // How far on its way from a cold machine to its own limit: a ring that runs cooler by nature
  // does not take the place of the one that matters.
  const nearness = ({ value, limits }) => (value - COLD_C) / (limits.warning - COLD_C);
  const worst = usable.toSorted(
    (a, b) => (levelOf(a) || 9) - (levelOf(b) || 9) || nearness(b) - nearness(a))[0];
  const lost = readings.find((reading) => !reading.usable);
  if (worst && levelOf(worst)) {
    const priority = levelOf(worst);
    return { word: 'over', priority, level: priority === 1 ? 'alarm' : 'warning', reading: worst };
  }
  if (lost || !worst) return { word: 'unknown', reading: lost ?? null };
  const standing = speedRpm !== null && Math.abs(speedRpm) < STANDING_RPM;
  if (standing) return { word: 'rest', reading: worst };
  return { word: trusted ? 'safe' : 'safe now', reading: worst };
}

/** Limits of the sensors that the forecast speaks of. */
const foretold = (limits, forecast, fan) => Object.fromEntries(Object.entries(limits)
  .filter(([name]) => fan.bands[name] && forecast.time_to_limit?.[name]));

/** Of all sensors with limits, the one for which `rank` is highest. */
const worstSensor = (limits, assess, rank) => Object.entries(limits)
  .map(([sensor, own]) => ({ sensor, limits: own, ...assess(sensor, own) }))
  .toSorted((a, b) => rank(b) - rank(a))[0];

/**
 * Is the next step safe? `steps` are those of `stepsFrom`, made distinct; with no further step
 * the answer is for the present point, held to the end of the forecast.
 */
export function answerNextStep({ forecast, fan, steps, limits, nowMs }) {
  if (!fan) return { word: 'no forecast' };
  const held = steps.length < 2;
  const step = held ? steps[0] : steps[1];
  const fromMs = step?.from ?? fan.times[0];
  const toMs = step?.to ?? fan.times.at(-1);
  const known = foretold(limits, forecast, fan);
  const assess = (sensor, own) => {
    const peak = overSpan(fan, sensor, own, fromMs, toMs);
    const told = (level) => timeToLimit(forecast, sensor, level, nowMs).probability;
    // Members counted over the whole forecast know best; a part of it cannot be likelier.
    const share = (level) => (held ? told(level) : Math.min(peak[level], told(level)));
    return { ...peak, warning: share('warning'), alarm: share('alarm') };
  };
  const worst = worstSensor(known, assess, (peak) =>
    (peak.alarm >= THRESHOLDS.alarm ? 1 + peak.alarm : peak.warning)
      + 1e-6 * (peak.high - peak.limits.warning));
  if (!worst) return { word: 'no forecast' };
  const priority = priorityFor(worst.warning, worst.alarm);
  const cools = cooling(fan, Object.keys(known).map((sensor) =>
    ({ sensor, limits: known[sensor], ...assess(sensor, known[sensor]) })), fromMs, toMs);
  return { word: wordFor(worst.warning), priority, held, step, fromMs, toMs, peak: worst, cools };
}

/**
 * Over the limit only because it begins there: what `coolsBelow` says of the sensor that takes
 * longest, or null when any sensor is likely to pass its limit in another way.
 */
function cooling(fan, peaks, fromMs, toMs) {
  const over = peaks.filter((peak) => peak.warning >= THRESHOLDS.atRisk)
    .map(({ sensor, limits }) => ({
      sensor, limits, found: coolsBelow(fan, sensor, limits.warning, fromMs, toMs),
    }));
  if (!over.length || over.some(({ found }) => !found)) return null;
  const { sensor, limits, found } = over.toSorted((a, b) => b.found.belowMs - a.found.belowMs)[0];
  return { sensor, limits, ...found };
}

/** How long until a limit? Over the warning already, the alarm limit is asked for. */
export function answerTimeToLimit({ forecast, fan, readings, limits, nowMs }) {
  if (!fan) return { word: 'no forecast' };
  const endS = (fan.times.at(-1) - nowMs) / 1000;
  const assess = (sensor, own) => {
    const reading = readings.find((one) => one.sensor === sensor);
    const over = Boolean(reading?.usable && reading.value >= own.warning);
    const level = over ? 'alarm' : 'warning';
    const peak = overSpan(fan, sensor, own, fan.times[0], fan.times.at(-1));
    const asked = timeToLimit(forecast, sensor, level, nowMs);
    return { level, over, asked, alarm: timeToLimit(forecast, sensor, 'alarm', nowMs), peak };
  };
  const known = foretold(limits, forecast, fan);
  const soonest = (one) => one.asked.median ?? one.asked.earliest ?? endS;
  const worst = worstSensor(known, assess, (one) =>
    (one.asked.probability >= THRESHOLDS.atRisk ? 1000 - soonest(one) / endS * 100 : 0)
      + (one.over && one.asked.probability >= THRESHOLDS.atRisk ? 1000 : 0)
      + one.asked.probability + 1e-3 * (one.peak.high - one.limits.warning));
  if (!worst) return { word: 'no forecast' };
  if (worst.asked.probability < THRESHOLDS.atRisk) return { word: 'none', endS, ...worst };
  return { word: 'some', priority: worst.level === 'alarm' ? 1 : 2, endS, ...worst };
}
