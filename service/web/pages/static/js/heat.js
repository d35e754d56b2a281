// The ramp of six greys that shows how hot a node is; colour is kept for limits.
import { h, s } from './dom.js';

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

/** The ramp with its figures, and how measured and estimated values look. */
export function heatLegend() {
  const ramp = 'var(--t0),var(--t1),var(--t2),var(--t3),var(--t4),var(--t5)';
  const sensor = s('svg', { width: 14, height: 14, 'aria-hidden': 'true' }, s('circle', {
    cx: 7, cy: 7, r: 5, fill: 'var(--panel)', stroke: 'var(--ink)', 'stroke-width': 2.5,
  }));
  return h('div', { class: 'lrow' },
    h('div', { class: 'slegend' },
      h('span', { class: 'ramp', style: { background: `linear-gradient(90deg in oklab,${ramp})` } }),
      h('span', { class: 'tick' },
        RAMP.map((value) => h('i', {}, value === RAMP.at(-1) ? `${value} °C` : String(value))))),
    h('div', { class: 'skeys' },
      h('span', { class: 'key' }, sensor, 'measured'),
      h('span', { class: 'key es' }, h('b', {}, '00.0'), ' estimated, ± 95 %'),
      h('span', { class: 'key' }, h('i', { class: 'hatch' }), 'not known: no sensor shows it')));
}
