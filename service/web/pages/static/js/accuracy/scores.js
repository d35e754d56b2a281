// How good kept forecasts were: scores of several kinds put together. Pure functions.
import { channelName, isNumber, milliseconds, wholeSpan } from '../parts/format.js';

export const NAIVE = { persistence: 'persistence', linear: 'linear', arx: 'ARX' };
export const STATED = { q025: 2.5, q25: 25, q50: 50, q75: 75, q975: 97.5 };
const MEANS = ['coverage_50', 'coverage_95', 'bias_k', 'mae_k', 'crps_k', 'interval_score_k'];
const DAY_MS = 86400e3;
export const RECORD_DAYS = 30;

/** 5 min, 1 h: as a lead time is called. */
export const leadText = (seconds) => wholeSpan(seconds).replace(/^60 min$/, '1 h');

/** Mean of a figure over items, each weighted with its readings; null where none has it. */
function mean(items, figure) {
  const known = items.filter((item) => item.n && isNumber(figure(item)));
  const count = known.reduce((sum, item) => sum + item.n, 0);
  return count ? known.reduce((sum, item) => sum + item.n * figure(item), 0) / count : null;
}

const total = (items, figure) => items.reduce((sum, item) => sum + figure(item), 0);

// What was interrupted is scored at the last minute that was followed, and counts like all others.
const scoredOf = (item) => item.n + item.left;
const insideOf = (item) => item.n * (item.coverage_95 ?? 0) + item.left_inside_95;

/** Runs of which no two overlap: of the sensor and lead time that has most. */
function independent(items) {
  const runs = new Map();
  for (const item of items) {
    const key = `${item.channel} ${item.lead_time_s}`;
    runs.set(key, (runs.get(key) ?? 0) + item.independent_runs);
  }
  return Math.max(0, ...runs.values());
}

/** Items as one: counts are added, means weighted. @returns {any} */
export function together(items) {
  const by = (name) => total(items, (item) => item.set_aside_by[name]);
  const scored = total(items, scoredOf);
  return {
    n: total(items, (item) => item.n),
    setAside: total(items, (item) => item.set_aside),
    by: { plan: by('plan'), data: by('data'), model: by('model') },
    waiting: total(items, (item) => item.waiting),
    left: total(items, (item) => item.left),
    leftInside: total(items, (item) => item.left_inside_95),
    scored,
    share: scored ? total(items, insideOf) / scored : null,
    runs: total(items, (item) => item.whole_runs),
    runsInside: total(items, (item) => item.whole_runs_inside),
    independent: independent(items),
    ...Object.fromEntries(MEANS.map((name) => [name, mean(items, (item) => item[name])])),
    below: Object.fromEntries(
      Object.keys(STATED).map((name) => [name, mean(items, (item) => item.below[name])])),
    naive: Object.fromEntries(
      Object.keys(NAIVE).map((kind) => [kind, mean(items, (item) => item.naive[kind].mae_k)])),
    // The twin's own error where there was such a forecast: before the first identification
    // there is none but persistence.
    beside: Object.fromEntries(Object.keys(NAIVE).map((kind) => [kind,
      mean(items.filter((item) => isNumber(item.naive[kind].mae_k)), (item) => item.mae_k)])),
  };
}

/** What of the items is asked for; a wish that is null asks for all. */
export const chosen = (items, { channel = null, risk = null, version = null }) => items.filter(
  (item) => (!channel || item.channel === channel) && (!risk || item.risk === risk)
    && (!version || item.model_version === version));

export function byLead(items) {
  const leads = [...new Set(items.map((item) => item.lead_time_s))].sort((a, b) => a - b);
  return leads.map((lead) => ({ lead, ...together(items.filter((item) => item.lead_time_s === lead)) }));
}

export const inside = (items) => Math.round(total(items, insideOf));

const runsText = (count) => `${countText(count)} independent run${count === 1 ? '' : 's'}`;

/** “31 of 32 inside 1 h ahead at high risk (4 independent runs)”: of the nearest lead time; or empty. */
export function recordFor(items, { channel, aheadS, risk }) {
  const wanted = chosen(items ?? [], { channel, risk }).filter(scoredOf);
  const far = (item) => Math.abs(Math.log(item.lead_time_s / Math.max(aheadS, 1)));
  const lead = wanted.sort((a, b) => far(a) - far(b))[0]?.lead_time_s;
  const those = wanted.filter((item) => item.lead_time_s === lead);
  const { scored, independent: runs } = together(those);
  return scored ? `${countText(inside(those))} of ${countText(scored)} inside ${leadText(lead)} ahead at ${risk} `
    + `risk (${runsText(runs)})` : '';
}

/** Whether a span of the plan leaves the low-risk region; set-points at its edge do not. */
export const riskOf = (steps, region) => (region && steps.some((step) =>
  Math.abs(step.speed_rpm) > 1.02 * region.speed_rpm_max || step.load_n > 1.02 * region.load_n_max)
  ? 'high' : 'low');

/** Whether a simple forecast was better than the twin at the same readings. */
export const loses = (row) => Object.keys(NAIVE).some(
  (kind) => isNumber(row.naive[kind]) && isNumber(row.beside[kind]) && row.naive[kind] < row.beside[kind]);

const countText = (count) => count.toLocaleString('en').replaceAll(',', '\u202f');

/** “Forecasts of the last 30 days: 94 of 97 inside the band”, or why there is no such figure. */
export function recordText(items) {
  const { scored, setAside, waiting, independent: runs } = together(items);
  const begin = `Forecasts of the last ${RECORD_DAYS} days: `;
  if (scored) return `${begin}${countText(inside(items))} of ${countText(scored)} readings inside the band${
    runs ? `, ${runsText(runs)}` : ''}`;
  if (setAside) return `${begin}none evaluated, ${countText(setAside)} excluded`;
  return waiting ? `${begin}none due yet` : '';
}

export const recordStart = (nowMs) => new Date(nowMs - RECORD_DAYS * DAY_MS).toISOString();

/**
 * The kept forecasts of a channel at a lead time whose time has come, oldest first:
 * [{ time, madeMs, state, reading, risk, reason, version }].
 */
export function pastPoints(forecasts, channel, lead, nowMs) {
  const points = forecasts.flatMap((one) => one.points.filter(
    (point) => point.lead_time_s === lead && milliseconds(point.time) <= nowMs,
  ).flatMap((point) => point.readings.filter((reading) => reading.channel === channel)
    .map((reading) => ({
      time: milliseconds(point.time), madeMs: milliseconds(one.made_at), reading,
      state: reading.state, risk: point.risk, reason: one.reason, version: one.model_version,
    }))));
  return points.sort((a, b) => a.time - b.time);
}

export const channelsOf = (items) => [...new Set(items.map((item) => item.channel))]
  .sort((a, b) => channelName(a).localeCompare(channelName(b)));
