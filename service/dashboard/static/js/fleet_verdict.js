// What the fleet's card says of one asset, and how urgent that is. Pure.
import { byUrgency, isStanding } from './alarms.js';
import { bold } from './dom.js';
import { ageText, fixed, percent, spanText } from './format.js';

const degrees = (value) => `${fixed(value, value % 1 ? 1 : 0)} °C`;
const opening = { rank: 8, group: 'wait', look: 'idle', symbol: ['none'], word: 'Opening …', why: '' };

const nextText = ({ next }) => (next.peak && next.step
  ? `next step ${fixed(next.step.speed_rpm, 0)} rpm: ${percent(next.peak.warning)}` : '');

/** The worst alarm of a measured limit that stands, null without one. */
export const standingAlarm = (alarms) =>
  [...alarms.values()].filter(isStanding)
    .sort((a, b) => a.priority - b.priority || byUrgency(a, b))[0] ?? null;

/**
 * The verdict of a card: { rank, group, look, symbol, word, why, channel, lost }; lowest rank first.
 *
 * now: the asset's situation; standing: its worst alarm over a measured limit, or null. An alarm
 * that stands outweighs that its data are lost meanwhile (`lost`, a second mark).
 */
export function cardVerdict(now, standing) {
  if (!now) return opening;
  const { now: answer } = now;
  const lost = answer.word === 'unknown';
  if (now.live && answer.word === 'over') return overVerdict(now);
  if (now.live && standing) return standingVerdict(now, standing, lost);
  if (lost || !now.live) return lostVerdict(now);
  if (answer.word === 'rest') {
    return { rank: 7, group: 'rest', look: 'idle', symbol: ['none'], word: 'At rest',
      why: now.steps.length > 1 ? nextText(now) : 'no run under way' };
  }
  if (now.toLimit.word === 'some') return aheadVerdict(now);
  return {
    rank: answer.word === 'safe' ? 6 : 5, group: 'safe', look: '', symbol: ['ok'],
    word: answer.word === 'safe' ? 'Safe' : 'Safe now',
    why: now.noForecast ? `no forecast: ${now.noForecast}`
      : `peak ahead ${fixed(now.toLimit.peak?.median)} °C, no limit`,
  };
}

function overVerdict({ now: answer, toLimit, noForecast, lostMs }) {
  const { reading, level, priority } = answer;
  const { limits } = reading;
  const ahead = toLimit.asked && level === 'warning' && !noForecast
    && `alarm ${degrees(limits.alarm)}: ${percent(toLimit.alarm.probability)}`;
  return {
    rank: priority - 1, group: 'over', look: `p${priority} solid`, symbol: [priority, 'filled'],
    word: `Over ${degrees(limits[level])}`, lost: lostMs !== null,
    why: ahead || `${fixed(reading.value - limits[level])} K over`,
  };
}

function standingVerdict({ readings, now: answer }, alarm, lost) {
  const { priority, channel } = alarm;
  const reading = readings.find((one) => one.sensor === channel) ?? answer.reading;
  const old = reading && !reading.usable;
  return {
    rank: priority - 1, group: 'over', look: `p${priority} solid`, symbol: [priority, 'filled'],
    word: `Over ${fixed(alarm.limit_value, alarm.limit_value % 1 ? 1 : 0)} ${alarm.unit ?? '°C'}`,
    channel, lost, why: old ? ['last value ', bold(ageText(reading.ageS)), ' old'] : alarm.message,
  };
}

function lostVerdict({ now: answer }) {
  const age = answer.reading?.ageS ?? null;
  return {
    rank: 4, group: 'lost', look: 'bad', symbol: ['bad', 'hollow'], word: 'Unknown', lost: true,
    why: age === null ? 'no temperature yet' : ['no data for ', bold(ageText(age))],
  };
}

function aheadVerdict(now) {
  const { asked, limits, level, priority } = now.toLimit;
  const limit = degrees(limits[level]);
  return {
    rank: priority === 1 ? 2.5 : 3, group: 'ahead', look: `p${priority}`,
    symbol: [priority, 'dashed'],
    word: asked.median === null ? `${percent(asked.probability)} over ${limit}`
      : `${spanText(asked.median)} to ${limit}`,
    why: now.next.held ? 'current operating point held' : nextText(now),
  };
}
