// Alarms after ISA-18.2: colour, shape and text show the state.
import { isNumber, joined, milliseconds, percent, spanText, valueText } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { isActive, isDistrust } from '../live/readings.js';

// What each state is called, how its symbol looks, and where it stands in the list.
const STATES = {
  UNACK: { text: 'UNACKNOWLEDGED', look: 'filled', rank: 0 },
  ACKED: { text: 'ACKNOWLEDGED', look: 'filled', rank: 1 },
  RTNUN: { text: 'RETURNED, UNACK', look: 'hollow', rank: 2 },
  LATCH: { text: 'LATCHED, RESET REQUIRED', look: 'hollow', rank: 3 },
  SHLVD: { text: 'SHELVED', look: 'shelved', rank: 4 },
  DSUPR: { text: 'SUPPRESSED', look: 'suppressed', rank: 5 },
  OOSRV: { text: 'OUT OF SERVICE', look: 'struck', rank: 6 },
};
const STANDING_KINDS = ['measured limit', 'above ambient'];
const ASIDE = { SHLVD: 'shelved', DSUPR: 'by design', OOSRV: 'out of service' };
export const stateOf = (alarm) => STATES[alarm.state];
export const needsAcknowledge = (alarm) => alarm.state === 'UNACK' || alarm.state === 'RTNUN';
export const isShown = (alarm) => alarm.state in STATES;
/** Suppressed by a user or by design: shown in grey, never counted. */
export const isAside = (alarm) => alarm.state in ASIDE;
export const isStanding = (alarm) => isActive(alarm) && STANDING_KINDS.includes(alarm.kind);
export const isLimit = (alarm) => Boolean(alarm.limit_level);
export const assetsOf = (alarm) => alarm.assets ?? [alarm.asset];

/** One alarm for all assets of its cause: of a source, or of the service itself. */
export const isShared = (alarm) => ['source', 'service'].includes(alarm.cause?.kind);

/** When it was raised; an alarm that was suppressed before it ever came has no such time. */
export const raisedMs = (alarm) => milliseconds(alarm.raised_at ?? alarm.since);

// ISA-18.2: what has to be answered first, then by priority. Of one priority, what is measured over
// a limit outweighs what has no data, and both outweigh what is only predicted; then by how far over.
const certainty = (alarm) => (alarm.predicted ? 2 : isDistrust(alarm) ? 1 : 0);
// By how many whole units it is over its limit: whole ones, so that rows stay where they are.
const excess = ({ value, limit_value: limit }) =>
  (isNumber(value) && isNumber(limit) ? Math.floor(Math.max(value - limit, 0)) : 0);
const rank = (alarm) => [stateOf(alarm).rank, alarm.priority, certainty(alarm), -excess(alarm) || 0,
  -raisedMs(alarm) || 0];

export function byUrgency(a, b) {
  const [one, other] = [rank(a), rank(b)];
  const first = one.findIndex((value, i) => value !== other[i]);
  return first < 0 ? 0 : one[first] - other[first];
}

/** The message without its probability, which stands next to it and changes with each forecast. */
export const headline = ({ message }) => message.replace(/, (?:[<>] )?\d+ %$/, '');
export const ranked = (alarms) => [...alarms.values()].filter(isShown).sort(byUrgency);
export const worst = (alarms) => ranked(alarms).find(isActive) ?? null;

/** How many are suppressed, and how: "6 suppressed (shelved 2, by design 4)"; '' for none. */
export function suppressedText(alarms) {
  const aside = alarms.filter(isAside);
  const parts = Object.entries(ASIDE).map(([state, name]) =>
    [name, aside.filter((alarm) => alarm.state === state).length]);
  const counts = parts.filter(([, count]) => count).map(([name, count]) => `${name} ${count}`);
  return aside.length ? `${aside.length} suppressed (${counts.join(', ')})` : '';
}

export function summary(alarms) {
  const all = [...alarms.values()];
  return [`${all.filter(isActive).length} active`,
    `${all.filter(needsAcknowledge).length} unacknowledged`, suppressedText(all)]
    .filter(Boolean).join(', ');
}

/**
 * What stands behind an alarm now: lead time and probability of a predicted one, the value of a
 * measured one. `live` has the present values of forecast and sensor, newer than the alarm's own.
 */
export function detailText(alarm, live) {
  if (alarm.state === 'SHLVD') return joined(timeLeft(alarm, live));
  if (alarm.state === 'DSUPR') return alarm.suppressed_reason ?? alarm.kind;
  if (alarm.state === 'OOSRV') return alarm.comment ?? alarm.kind;
  if (alarm.predicted && !isActive(alarm)) return 'no longer predicted';
  if (!alarm.predicted) {
    if (isDistrust(alarm)) return joined(silenceText(alarm, live));
    if (alarm.returned_at && !isActive(alarm)) return joined(pastText(alarm));
    const value = presentText(alarm, live);
    return value === null ? alarm.kind : joined(value);
  }
  const { probability, earliest } = live.crossing(alarm.channel, alarm.limit_level)
    ?? { probability: alarm.probability, earliest: alarm.lead_time_s };
  const parts = [];
  if (isNumber(earliest)) parts.push(`earliest in ${spanText(earliest)}`);
  if (isNumber(probability)) parts.push(percent(probability));
  return joined(parts.join(' · '));
}

function pastText(alarm) {
  const { peak, duration_s: lastedS, unit } = alarm;
  return [isNumber(peak?.value) && `peak ${valueText(peak.value, unit)}`,
    isNumber(lastedS) && `lasted ${spanText(lastedS)}`].filter(Boolean).join(', ') || alarm.kind;
}

/** For how long there is no usable value; of one that has come back only its kind. */
function silenceText(alarm, live) {
  const standsS = (live.nowMs - raisedMs(alarm)) / 1000;
  return isActive(alarm) && standsS >= 0 ? `${alarm.kind}, for ${spanText(standsS)}` : alarm.kind;
}

function presentText(alarm, live) {
  const ofSensor = alarm.kind === 'measured limit' && (alarm.unit ?? '°C') === '°C';
  const value = (ofSensor ? live.value(alarm.channel) : null) ?? alarm.value;
  return isNumber(value) ? valueText(value, alarm.unit) : null;
}

function timeLeft(alarm, live) {
  const leftS = (milliseconds(alarm.shelved_until) - live.nowMs) / 1000;
  return Number.isFinite(leftS) ? `${spanText(leftS)} left` : 'shelved';
}

export function whoOf(alarm) {
  if (alarm.state === 'ACKED') return alarm.acknowledged_by ?? '';
  return alarm.state === 'SHLVD' ? alarm.shelved_by ?? '' : '';
}

export function symbol(alarm, size, inverse = false) {
  const { look } = stateOf(alarm);
  const kind = isDistrust(alarm) ? 'bad' : alarm.priority;
  if (isAside(alarm)) return icon(kind, look, size);
  return icon(kind, alarm.predicted && kind !== 'bad' ? 'dashed' : inverse ? 'inverse' : look, size);
}

/**
 * Keep an alarm as the service sends it, of one asset or (null) of all; what is normal and
 * acknowledged, or not about the asset any more, leaves the list.
 */
export function applyAlarm(store, alarm, assetId = null) {
  const alarms = new Map(store.get('alarms'));
  const isAbout = assetId === null || assetsOf(alarm).includes(assetId);
  if (isShown(alarm) && isAbout) alarms.set(alarm.id, alarm);
  else alarms.delete(alarm.id);
  store.set('alarms', alarms);
}
