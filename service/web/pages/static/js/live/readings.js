// What an asset measures, and what a channel is worth right now: a value is used only while it is good, fresh and
// connected. The service decides how old a value may be: by channel, and by what its verdict lacks.
import { ageText, fixed, isNumber } from '../parts/format.js';
import { RINGS } from '../parts/channels.js';

export const GOOD = 192;
export const UNCERTAIN = 64;
const LOST_KINDS = ['stale data', 'sensor fault', 'clock ahead'];
export const isActive = (alarm) => alarm.state === 'UNACK' || alarm.state === 'ACKED';
export const isDistrust = (alarm) => LOST_KINDS.includes(alarm.kind);
const channelOf = (asset, name) => asset?.channels.find((channel) => channel.name === name);

/**
 * The latest word on a channel: { value, timeMs, quality, ageS, usable, reason }. What cannot be used
 * keeps its last good figure as `value`, to be shown struck through.
 */
export function readChannel(state, clock, name) {
  const tag = state.tags[name];
  const nowMs = clock.now();
  const timeMs = tag?.goodTime ?? null;
  const ageS = timeMs === null || nowMs === null ? null : Math.max(0, (nowMs - timeMs) / 1000);
  const reading = { name, value: tag?.goodValue ?? null, timeMs, ageS, quality: tag?.quality ?? 0 };
  const reason = whyUnusable(state, name, tag, ageS);
  return { ...reading, usable: reason === null, reason };
}

function whyUnusable(state, name, tag, ageS) {
  if (state.link.status !== 'live') return 'service not connected';
  if (!tag || !isNumber(tag.goodValue)) return 'no value yet';
  const { source, max_age_s: maxAgeS } = channelOf(state.asset, name) ?? {};
  const health = state.sources.find((one) => one.name === source);
  if (health && !health.up) return `source ${source} does not answer`;
  const alarm = [...state.alarms.values()].find((one) => isDistrust(one) && isActive(one)
    && (one.channel === name || (one.channel === `source:${source}` && tag.quality === UNCERTAIN)));
  if (alarm) return alarm.message;
  if (tag.quality < GOOD) return qualityText(tag.quality);
  if (isNumber(maxAgeS) && ageS > maxAgeS) return 'no new value';
  return state.verdict?.missing.includes(name) ? 'no usable value' : null;
}

function qualityText(quality) {
  if (quality === 83) return 'value frozen';
  const words = {
    4: 'configuration error', 8: 'not connected', 12: 'device failure', 16: 'sensor failure',
    20: 'last known value', 24: 'no communication', 28: 'out of service',
    32: 'waiting for the first value', 68: 'last usable value',
    80: 'sensor not accurate', 84: 'out of range', 88: 'sub-normal',
  };
  return words[quality & 0xfc] ?? (quality >= UNCERTAIN ? 'uncertain' : 'bad');
}

/** A reading for ears: its value while it can be used, else for how long it is lost. */
export function spoken({ value, usable, ageS }, unit) {
  if (usable) return `${fixed(value, unit === 'degrees Celsius' ? 1 : 0)} ${unit}`;
  return ageS === null ? 'no value yet' : `lost for ${ageText(ageS)}`;
}

export const limitedReadings = (state, clock) => Object.entries(state.asset?.limits ?? {})
  .filter(([sensor]) => channelOf(state.asset, sensor))
  .map(([sensor, limits]) => ({ sensor, limits, ...readChannel(state, clock, sensor) }));

const MOST_LINES = 3;
const NOT_SHOWN = 'ambient_c';

export const channelNames = (asset) => (asset?.channels ?? []).map((channel) => channel.name)
  .filter((name) => !name.endsWith('.twin'));

/** Names of the measured channels by their source: [[source, names], …], as they are configured. */
export const bySource = (asset) => [...Map.groupBy(channelNames(asset), (name) =>
  asset.channels.find((channel) => channel.name === name).source)];

/**
 * The measured temperatures of the charts, at most three: the rings of a bearing, else those
 * with limits first.
 */
export function chartSensors(asset) {
  const measured = channelNames(asset);
  const rings = RINGS.filter((name) => measured.includes(name));
  if (rings.length) return rings;
  const limited = Object.keys(asset?.limits ?? {}).filter((name) => measured.includes(name));
  const others = measured.filter((name) =>
    /^t_.*_c$/.test(name) && name !== NOT_SHOWN && !limited.includes(name));
  return [...limited, ...others].slice(0, MOST_LINES);
}
