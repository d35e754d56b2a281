// Figures, times and names as the operator reads them. Minus is U+2212, no value is an en dash.
import { LABELS } from './channels.js';
import { v } from './panel.js';

export const NODE_NAMES = [
  'Housing', 'Outer ring', 'Balls', 'Inner ring', 'Shaft left', 'Cage', 'Grease',
  'End cap L', 'End cap R', 'Sleeve L', 'Sleeve R', 'Shaft centre', 'Bench', 'Air',
];

export function channelName(channel) {
  const node = /^t_node_(\d+)_c$/.exec(channel);
  return (node && NODE_NAMES[Number(node[1]) - 1]) ?? LABELS[channel] ?? ownName(channel);
}

export const lowerName = (channel) => channelName(channel).toLowerCase();

/** The name of a temperature of one's own network: t_gearbox_oil_c is Gearbox oil. */
function ownName(channel) {
  if (channel.startsWith('source:')) return `Source ${channel.slice(7)}`;
  const words = /^t_(.+)_c$/.exec(channel)?.[1].replaceAll('_', ' ');
  return words ? words[0].toUpperCase() + words.slice(1) : channel;
}

const FORECAST_LABELS = { 'runaway not excluded': 'thermal runaway not ruled out' };
export const labelText = (label) => FORECAST_LABELS[label] ?? label;
export const isNumber = (value) => typeof value === 'number' && Number.isFinite(value);

/** The greatest and the least number among values that may be missing; as many as there are raw samples. */
export const highestOf = (values) => values.reduce((top, one) => (isNumber(one) && one > top ? one : top), -Infinity);
export const lowestOf = (values) => values.reduce((low, one) => (isNumber(one) && one < low ? one : low), Infinity);

export const fixed = (value, digits = 1) =>
  isNumber(value) ? value.toFixed(digits).replace(/^-(?=0\.?0*$)/, '').replace('-', '−') : '–';

const WIDE_K = 1; // half of a 95 % interval that is shown next to its mean
const NORMAL_95 = 1.96;
export const NOT_KNOWN = 'not known';

/**
 * An estimate in °C; whole degrees with ± where the twin does not know it better, no figure where
 * the service says that it is not known at all.
 */
export function estimated(mean, std, known = true) {
  if (!known) return NOT_KNOWN;
  const half = NORMAL_95 * std;
  return isNumber(mean) && half >= WIDE_K ? `${fixed(mean, 0)} ±${fixed(half, 0)}` : fixed(mean);
}

export function significant(value) {
  if (!isNumber(value)) return '–';
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) {
    return value.toExponential(2).replace(/-/g, '−');
  }
  return String(Number(value.toPrecision(3))).replace('-', '−');
}

export const counted = (count, noun) => `${count} ${noun}${count === 1 ? '' : 's'}`;

/** 70.1 °C; the unit of a value is °C where none is given. */
export const valueText = (value, of) => `${fixed(value)} ${of ?? '°C'}`.trim();
const unit = (text) => v('span', { class: 'u' }, text);
export const celsius = (value) => [fixed(value), unit('°C')];

/** A probability in words that never promise 0 or 100 %. */
export function percent(probability) {
  if (!isNumber(probability)) return '–';
  if (probability < 0.005) return '< 1 %';
  if (probability >= 0.995) return '> 99 %';
  return `${Math.round(probability * 100)} %`;
}

/** @type {Intl.DateTimeFormatOptions} */
const CLOCK = { hour: '2-digit', minute: '2-digit', hourCycle: 'h23' };
export const hourMinute = (ms) => new Date(ms).toLocaleTimeString([], CLOCK);
export const hourMinuteSecond = (ms) =>
  new Date(ms).toLocaleTimeString([], { ...CLOCK, second: '2-digit' });
const day = (ms) => new Date(ms).toLocaleDateString([], { day: 'numeric', month: 'short' });
export const dayTime = (ms) => `${day(ms)} ${hourMinute(ms)}`;
export const dayTimeSecond = (ms) => `${day(ms)} ${hourMinuteSecond(ms)}`;
/** The time of day, with its day where that is not today's. */
export const dayOrTime = (ms, nowMs) =>
  (Math.abs(nowMs - ms) < 12 * 3600e3 || sameDay(ms, nowMs) ? hourMinute(ms) : dayTime(ms));
const sameDay = (a, b) => new Date(a).toDateString() === new Date(b).toDateString();
export const utc = (ms) => new Date(ms).toISOString().replace('T', ' ').replace(/\.\d+Z/, ' UTC');
export const timeZone = (ms) =>
  new Date(ms).toLocaleTimeString([], { timeZoneName: 'short' }).split(' ').pop();

/** A local date and time for an input: to the second, or to the minute where `length` is 16. */
export const localInput = (ms, length = 19) =>
  new Date(ms - new Date(ms).getTimezoneOffset() * 60000).toISOString().slice(0, length);

/** The nearest full minute: plans are made in minutes, the clock that places them is not. */
export const wholeMinute = (ms) => Math.round(ms / 60000) * 60000;

/** Local time on screen, UTC on hover and for assistive technology. */
export const timeElement = (ms, text = hourMinute(ms)) =>
  v('time', { datetime: new Date(ms).toISOString(), title: utc(ms) }, text);

/** A time of the service, null where there is none. */
export const moment = (rfc3339, text = dayTime) =>
  (rfc3339 ? timeElement(Date.parse(rfc3339), text(Date.parse(rfc3339))) : null);

/** A span of time as [number, unit, …] pairs: 33 min, 1 h 40 min, 12 s. */
function spanParts(seconds) {
  const minutes = Math.max(0, Math.round(seconds / 60));
  if (minutes < 1) return [['< 1', 'min']];
  if (minutes < 100) return [[String(minutes), 'min']];
  if (minutes < 48 * 60) {
    return [[String(Math.floor(minutes / 60)), 'h'], [String(minutes % 60).padStart(2, '0'), 'min']];
  }
  return [[String(Math.round(minutes / 1440)), 'd']];
}

export const spanText = (seconds) => spanParts(seconds).flat().join(' ');

/** The same for round figures: 8 h, not 8 h 00 min. */
export const wholeSpan = (seconds) => spanText(seconds).replace(' h 00 min', ' h');

/** The same with small units, for large figures. */
export const spanNodes = (seconds) =>
  spanParts(seconds).map(([number, name], i) => [i ? ' ' : '', number, unit(name)]);

export const joined = (text) =>
  text.replace(/(?<=[<>]) (?=\d)| (?=°C|%|min\b|h\b|s\b|K\b|N\b|rpm)/g, '\u00a0');

/** Speed or load; struck through where it is of the past. */
export const pointFigure = ({ value, usable }, name) =>
  v(usable || value === null ? 'span' : 's', {}, joined(`${fixed(value, 0)} ${name}`));

/** An age that grows: 0.6 s, 42 s, 4 min 05 s, 2 h 10 min. */
export function ageText(seconds) {
  if (!isNumber(seconds)) return '–';
  if (seconds < 9.95) return `${fixed(Math.max(0, seconds))} s`;
  if (seconds < 60) return `${Math.floor(seconds)} s`;
  if (seconds < 3600) {
    const rest = String(Math.floor(seconds % 60)).padStart(2, '0');
    return `${Math.floor(seconds / 60)} min ${rest} s`;
  }
  return spanText(seconds);
}

/** The same in one short unit, for the header where room is scarce. */
export const shortAge = (seconds) => (!isNumber(seconds) ? '' : seconds < 60 ? ageText(seconds) : spanText(seconds));
export const milliseconds = (rfc3339) => (rfc3339 ? Date.parse(rfc3339) : NaN);
