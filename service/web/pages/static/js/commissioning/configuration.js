// Putting a bench into service: requests, and what makes tables of the configuration file of a draft.
import { call } from '../app/api.js';
import { LABELS, OBSERVED, OPERATION, RINGS, UNITS } from '../parts/channels.js';

const PROBE_MS = 60000;
const ROOT = '/commissioning';
export const loadCommissioning = () => call(ROOT);
export const loadVersions = () => call(`${ROOT}/versions`, { query: { limit: 50 } });
/** @param {'POST' | 'PUT'} method */
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
export const CHANNELS = [...OPERATION, ...OBSERVED, ...RINGS, ...NODES].map((name) => [
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

const NAME = /^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$/;

/**
 * The table of a source as the service takes it: an slcan adapter behind HOST:PORT is a socket.
 * Throws what is wrong with it, before anything is asked of it.
 */
export function completedSource(source) {
  const { name, interface: reached } = source;
  if (!NAME.test(name)) {
    throw new Error(`name "${name}": expected letters, digits, ".", "_" and "-", 64 at most`);
  }
  if (reached !== 'slcan') return source;
  const place = /^(?:[^\s/:[\]]+|\[[0-9A-Fa-f:.]+\]):\d{1,5}$/.test(source.channel)
    ? `socket://${source.channel}` : source.channel;
  if (!/^(?:socket:\/\/\S+:\d{1,5}|\/dev\/\S+)$/.test(place)) {
    throw new Error(`address "${place}": expected HOST:PORT or a path in /dev`);
  }
  return { ...source, channel: place };
}

export function placeOf(channel) {
  if (channel.message) return `${channel.message}.${channel.signal}`;
  if (channel.register === undefined) return 'pushed over REST';
  const order = Object.entries(ORDERS).find(([, [words, bytes]]) =>
    words === (channel.word_order ?? 'big') && bytes === (channel.byte_order ?? 'big'))[0];
  const unit = channel.unit_id === undefined ? '' : `unit ${channel.unit_id}, `;
  const type = channel.type ?? 'int16';
  const { scale = 1, offset = 0 } = channel;
  const words = /32/.test(type) ? ` ${order}` : '';
  const scaled = scale === 1 ? '' : ` × ${scale}`;
  const moved = offset ? ` ${offset < 0 ? '−' : '+'} ${Math.abs(offset)}` : '';
  return `${unit}${channel.kind ?? 'holding'} ${channel.register}, ${type}${words}${scaled}${moved}`;
}

export const scaled = (raw, { scale = 1, offset = 0 }) => raw * scale + offset;

/** Whether a number looks like a measured value: noise in the wrong order seldom does. */
export const isPlausible = (value) =>
  value !== null && (value === 0 || (Math.abs(value) >= 0.01 && Math.abs(value) < 100000));

export function shortNumber(value) {
  if (value === null || value === undefined) return '–';
  if (value === 0 || (Math.abs(value) >= 0.001 && Math.abs(value) < 1e7)) {
    return String(Number(value.toPrecision(6)));
  }
  return value.toExponential(2);
}

export function missing({ channels }) {
  const names = Object.keys(channels);
  return [
    !names.includes('speed_rpm') && 'speed', !names.includes('load_n') && 'load',
    !names.some(isTemperature) && 'a temperature',
  ].filter(Boolean);
}

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

export function limitsOf({ limits, channels }) {
  return Object.fromEntries(Object.keys(channels).filter(isTemperature).map((name) =>
    [name, limits[name] ?? USUAL_LIMITS[name] ?? { warning: 80, alarm: 95 }]));
}

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

export function limitFaults(draft) {
  const { speed_rpm_max: speed, load_n_max: load } = draft.low;
  if (!(speed > 0 && load > 0)) return ['Low risk: speed and load are needed.'];
  return Object.entries(limitsOf(draft)).flatMap(([name, { warning, alarm }]) => {
    if (!Number.isFinite(warning) || !Number.isFinite(alarm)) return [`${labelOf(name)}: both limits are needed.`];
    return warning < alarm ? [] : [`${labelOf(name)}: the warning must be below the alarm.`];
  });
}

// What is entered and not saved yet is kept in this tab when the page is loaded again.
const KEY = 'commissioning';

/** Nothing but what the configuration file holds; known: the answer of the service. */
export const newDraft = ({ file, revision, assets }) =>
  ({ file, revision, sources: [], values: {}, draft: draftOf(assets[0]) });

export const isUnsaved = (work) => Boolean(work?.touched && !work.saved);

export function keepDraft(work) {
  if (isUnsaved(work)) sessionStorage.setItem(KEY, JSON.stringify(work));
  else sessionStorage.removeItem(KEY);
}

export function keptDraft(file) {
  const work = JSON.parse(sessionStorage.getItem(KEY) ?? 'null');
  return work?.file === file ? { ...work, checked: false } : null;
}
