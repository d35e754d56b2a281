// What the fleet's card shows of one asset, and how urgent that is. Pure.
import { byUrgency, isStanding } from './alarms.js';
import { bold } from './dom.js';
import { ageText, fixed, isNumber, percent, spanText } from './format.js';
import { lacksModelOnly } from './live_verdict.js';

const degrees = (value) => `${fixed(value, value % 1 ? 1 : 0)} °C`;
const opening = { rank: 8, group: 'wait', look: 'idle', symbol: ['none'], word: 'Opening …', why: '' };

/** The worst alarm of a measured limit that stands, null without one. */
export const standingAlarm = (alarms) =>
  [...alarms.values()].filter(isStanding)
    .sort((a, b) => a.priority - b.priority || byUrgency(a, b))[0] ?? null;

/**
 * What a card shows: { rank, group, look, symbol, word, why, channel, lost }; lowest rank first.
 *
 * now: the asset's situation; standing: its worst alarm over a measured limit, or null. The word is
 * the service's. An alarm that stands keeps its colour and its place while data are lost (`lost`, a
 * second mark).
 */
export function cardVerdict(now, standing) {
  if (!now) return opening;
  const { now: answer, next_step: next, time_to_limit: toLimit } = now.verdict;
  const lost = now.live && now.lostChannels.length > 0;
  if (!now.live) return unknownCard(now);
  // Over a limit keeps its colour, also where the word is unknown because an input is missing.
  const over = answer.word === 'not safe' || (answer.word === 'unknown' && answer.limit);
  if (over || standing) return overCard(now, answer, standing, lost);
  if (answer.word === 'unknown') return unknownCard(now);
  if (answer.word === 'recovering') {
    return { rank: 3.5, group: 'over', look: '', symbol: ['none'], word: 'Recovering',
      why: answer.reasons[0], channel: answer.limit?.channel };
  }
  if (toLimit?.expected) return aheadCard(toLimit);
  const why = next.word === 'unknown' ? `next step unknown: ${now.missingText}`
    : `limit ahead: ${percent(toLimit?.probability)}`;
  return {
    rank: next.word === 'unknown' ? 5 : 6, group: 'safe', look: '', symbol: ['ok'], word: 'Safe', why,
  };
}

function overCard(now, answer, alarm, lost) {
  const channel = answer.limit?.channel ?? alarm?.channel;
  const priority = Math.min(answer.limit?.level === 'alarm' ? 1 : 2, alarm?.priority ?? 2);
  const level = answer.limit?.level ?? alarm?.limit_level ?? 'limit';
  const limit = answer.limit?.value_c ?? alarm?.limit_value;
  const reading = now.readings.find((one) => one.sensor === channel);
  const unit = answer.limit ? '°C' : alarm?.unit ?? '°C';
  const over = isNumber(limit) ? `over ${level} ${fixed(limit, limit % 1 ? 1 : 0)} ${unit}`
    : answer.reasons[0];
  return {
    rank: priority - 1, group: 'over', look: `p${priority} solid`, symbol: [priority, 'filled'],
    word: { 'not safe': 'Not safe', unknown: 'Unknown', safe: 'Safe', recovering: 'Recovering' }[answer.word],
    channel, lost,
    why: reading && !reading.usable ? [over, ', ', bold(ageText(reading.ageS)), ' old'] : over,
  };
}

function unknownCard(now) {
  const doubtful = !now.live || !lacksModelOnly(now.missing);
  return {
    rank: 4, group: 'lost', look: doubtful ? 'bad' : 'idle', word: 'Unknown', lost: true,
    symbol: doubtful ? ['bad', 'hollow'] : ['none'], why: now.missingText,
  };
}

function aheadCard({ limit, probability, median_s: median }) {
  const priority = limit.level === 'alarm' ? 1 : 2;
  const words = isNumber(median) ? `${spanText(median)} to ${degrees(limit.value_c)}`
    : `${percent(probability)} over ${degrees(limit.value_c)}`;
  return {
    rank: priority === 1 ? 2.5 : 3, group: 'ahead', look: `p${priority}`,
    symbol: [priority, 'dashed'], word: 'Safe', why: ['limit ahead: ', bold(words)],
    channel: limit.channel,
  };
}
