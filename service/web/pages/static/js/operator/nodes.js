// The nodes of a network of one's own: nothing is known of its shape, so they are shown as tiles.
import { channelName, estimated, fixed } from '../parts/format.js';
import { v } from '../parts/panel.js';

const RAMP = [20, 36, 52, 68, 84, 100];

/** Grey of a temperature in °C, mixed in OKLab; the panel's own where there is none. */
export function heatOf(temperature) {
  if (!Number.isFinite(temperature)) return 'var(--panel-2)';
  const step = (RAMP.at(-1) - RAMP[0]) / (RAMP.length - 1);
  const place = Math.max(0, Math.min(RAMP.length - 1, (temperature - RAMP[0]) / step));
  const index = Math.min(RAMP.length - 2, Math.floor(place));
  const share = Math.round((place - index) * 100);
  return `color-mix(in oklab, var(--t${index + 1}) ${share}%, var(--t${index}))`;
}

export function heatLegend() {
  const ramp = 'var(--t0),var(--t1),var(--t2),var(--t3),var(--t4),var(--t5)';
  const sensor = v('svg', { width: 14, height: 14, 'aria-hidden': 'true' }, v('circle', {
    cx: 7, cy: 7, r: 5, fill: 'var(--panel)', stroke: 'var(--ink)', 'stroke-width': 2.5,
  }));
  return v('div', { class: 'lrow' },
    v('div', { class: 'slegend' },
      v('span', { class: 'ramp', style: { background: `linear-gradient(90deg in oklab,${ramp})` } }),
      v('span', { class: 'tick' },
        RAMP.map((value) => v('i', {}, value === RAMP.at(-1) ? `${value} °C` : String(value))))),
    v('div', { class: 'skeys' },
      v('span', { class: 'key' }, sensor, 'measured'),
      v('span', { class: 'key es' }, v('b', {}, '00.0'), ' estimated, ± 95 %'),
      v('span', { class: 'key' }, v('i', { class: 'hatch' }), 'not known: no sensor shows it')));
}

/**
 * nodes, spreads: { name: estimate in °C, its standard deviation in K }; unknown: names of those without
 * a useful estimate, reasons: { name: why }; measured: { name: { value, usable } } of measured points,
 * which need not be nodes; alerts: { name: { priority, predicted } }; stale: all is of the past; open(name).
 */
export function NodeTiles({ nodes, spreads, unknown, reasons = {}, measured, alerts, stale, open = (_) => {} }) {
  const tile = (name) => {
    const [reading, alert] = [measured[name], alerts[name]];
    const isKnown = !unknown.includes(name);
    const text = estimated(nodes[name], spreads[name], isKnown);
    const mean = isKnown ? nodes[name] : null;
    const look = [reading?.usable === false && 'gone', alert && `a${alert.priority}`, alert?.predicted && 'ahead'];
    return v('li', { class: look.filter(Boolean).join(' '), title: (!reading && !isKnown && reasons[name]) || null,
      onclick: () => reading && open(name), key: name },
    v('i', { class: !reading && !isKnown ? 'hatch' : '',
      style: { background: reading || isKnown ? heatOf(reading?.value ?? mean) : '' } }),
    v('span', {}, channelName(name)),
    v('b', { 'data-figure': name, class: reading ? (reading.usable ? 'me' : 'st') : 'es' },
      reading ? fixed(reading.value ?? mean) : text),
    v('small', {}, reading && Number.isFinite(mean) ? `twin ${text}` : reading ? 'measured' : 'estimated'));
  };
  return [v('ul', { class: `ntiles${stale ? ' stale' : ''}` },
    [...new Set([...Object.keys(measured), ...Object.keys(nodes)])].map(tile)), heatLegend()];
}
