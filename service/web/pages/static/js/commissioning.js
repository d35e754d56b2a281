// Putting a bench into service: requests, and what makes tables of the configuration file of a draft.
import { call } from './api.js';
import { LABELS, OPERATION, RINGS, UNITS } from './channels.js';

const PROBE_MS = 60000;
const ROOT = '/commissioning';

export const loadCommissioning = () => call(ROOT);
export const loadVersions = () => call(`${ROOT}/versions`, { query: { limit: 50 } });
const probe = (path, body, method = 'POST') => call(`${ROOT}${path}`, { method, body, timeoutMs: PROBE_MS });
export const scanUnits = (source, first, count) => probe('/units', { source, first, count });
export const readRegisters = (request) => probe('/registers', request);
export const uploadDbc = (name, text) => probe('/dbc', { name, text });
export const listenTo = (source, seconds) => probe('/signals', { source, listen_s: seconds });
export const checkChange = (change) => probe('/check', change);
export const saveChange = (change) => probe('/configuration', change, 'PUT');
export const restoreVersion = (number, revision) => probe(`/versions/${number}/restore`, { revision });

export const TYPES = ['float32', 'int32', 'uint32'];
/** Orders of two registers as data sheets write them: [word_order, byte_order]. */
export const ORDERS = {
  ABCD: ['big', 'big'], CDAB: ['little', 'big'], BADC: ['big', 'little'], DCBA: ['little', 'little'],
};
export const NODES = Array.from({ length: 13 }, (_, number) => `t_node_${number + 1}_c`);
/** The channels that a bench may have, [name, label, unit]. */
export const CHANNELS = [...OPERATION, ...RINGS, ...NODES].map((name) => [
  name, LABELS[name] ?? `Node ${name.split('_')[2]}`, UNITS[name] ?? '°C',
]);
export const labelOf = (name) => CHANNELS.find(([one]) => one === name)?.[1] ?? name;
export const unitOf = (name) => CHANNELS.find(([one]) => one === name)?.[2] ?? '';
export const isTemperature = (name) => name.startsWith('t_') && name.endsWith('_c');
const USUAL_LIMITS = { t_inner_ring_c: { warning: 90, alarm: 105 }, t_outer_ring_c: { warning: 80, alarm: 95 } };

/** The keys of a channel that is a register read as a type, such as `int16` or `float32 CDAB`. */
export function registerChannel({ source, unit, usual, kind, register, type }) {
  const [name, order] = type.split(' ');
  const [words, bytes] = ORDERS[order ?? 'ABCD'];
  return {
    source, register, kind, type: name,
    ...(words === 'little' ? { word_order: 'little' } : {}),
    ...(bytes === 'little' ? { byte_order: 'little' } : {}),
    ...(unit === usual ? {} : { unit_id: unit }),
  };
}

/** Where a channel comes from, for people. */
export function placeOf(channel) {
  if (channel.message) return `${channel.message}.${channel.signal}`;
  if (channel.register === undefined) return 'pushed over REST';
  const order = Object.entries(ORDERS).find(([, [words, bytes]]) =>
    words === (channel.word_order ?? 'big') && bytes === (channel.byte_order ?? 'big'))[0];
  const unit = channel.unit_id === undefined ? '' : `unit ${channel.unit_id}, `;
  const type = channel.type ?? 'int16';
  return `${unit}${channel.kind ?? 'holding'} ${channel.register}, ${type}${/32/.test(type) ? ` ${order}` : ''}`;
}

/** A raw value as a channel shows it. */
export const scaled = (raw, { scale = 1, offset = 0 }) => raw * scale + offset;

/** Whether a number looks like a measured value: noise in the wrong order seldom does. */
export const isPlausible = (value) =>
  value !== null && (value === 0 || (Math.abs(value) >= 0.01 && Math.abs(value) < 100000));

/** A number in at most seven significant characters. */
export function shortNumber(value) {
  if (value === null || value === undefined) return '–';
  if (value === 0 || (Math.abs(value) >= 0.001 && Math.abs(value) < 1e7)) {
    return String(Number(value.toPrecision(6)));
  }
  return value.toExponential(2);
}

/** What a bench still lacks; empty when it may be followed. */
export function missing({ channels }) {
  const names = Object.keys(channels);
  return [
    !names.includes('speed_rpm') && 'speed', !names.includes('load_n') && 'load',
    !names.some(isTemperature) && 'a temperature',
  ].filter(Boolean);
}

/** A draft of a bench: a new one, or one of the file. */
export function draftOf(asset) {
  if (!asset) {
    return {
      id: 'bench-1', name: '', catalogue: true, bearing: '', dimensions: {}, agreed: false,
      low: { speed_rpm_max: 4300, load_n_max: 3400 }, limits: {}, channels: {}, rest: {},
    };
  }
  const { id, name = '', bearing, low_risk: low, limits = {}, channels = {}, ...rest } = asset;
  const named = typeof bearing === 'string';
  return {
    id, name, rest, catalogue: named, bearing: named ? bearing : '', dimensions: named ? {} : { ...bearing },
    low: { ...low }, limits: structuredClone(limits), channels: structuredClone(channels), known: true,
    agreed: true,
  };
}

/** Limits of every temperature that is measured, with the usual ones where none are set. */
export function limitsOf({ limits, channels }) {
  return Object.fromEntries(Object.keys(channels).filter(isTemperature).map((name) =>
    [name, limits[name] ?? USUAL_LIMITS[name] ?? { warning: 80, alarm: 95 }]));
}

/** The [[assets]] table of a draft. */
export function assetTable(draft) {
  return {
    id: draft.id.trim(),
    ...(draft.name.trim() ? { name: draft.name.trim() } : {}),
    ...(draft.rest.network && !draft.bearing && !draft.dimensions.bore_mm ? {}
      : { bearing: draft.catalogue ? draft.bearing : draft.dimensions }),
    ...draft.rest,
    low_risk: draft.low,
    limits: { ...draft.limits, ...limitsOf(draft) },
    channels: draft.channels,
  };
}

/** What is wrong with the limits, in words; empty when nothing is. */
export function limitFaults(draft) {
  return Object.entries(limitsOf(draft)).flatMap(([name, { warning, alarm }]) => {
    if (!Number.isFinite(warning) || !Number.isFinite(alarm)) return [`${labelOf(name)}: both limits are needed.`];
    return warning < alarm ? [] : [`${labelOf(name)}: the warning must be below the alarm.`];
  });
}
