// Temperature limits as a picture: a scale for each temperature with the present value.
import { labelOf, shortNumber } from './commissioning.js';
import { h, put, s } from './dom.js';

const [WIDTH, HEIGHT, LOWEST, HIGHEST] = [260, 34, 0, 150];
const at = (value) => Math.min(Math.max((value - LOWEST) / (HIGHEST - LOWEST), 0), 1) * WIDTH;

export class LimitScales {
  /** onchange is called with the channel and its { warning, alarm } */
  constructor(onchange) {
    this.onchange = onchange;
    this.element = h('div', { class: 'scales' });
  }

  /** rows: [channel, { warning, alarm }, present value or null] */
  show(rows) {
    put(this.element, rows.map(([name, limits, value]) => this.row(name, { ...limits }, value)));
  }

  row(name, limits, value) {
    const picture = s('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: 'limitscale', 'aria-hidden': 'true' });
    const draw = () => put(picture,
      s('rect', { class: 'calm', x: 0, y: 10, width: at(limits.warning), height: 12 }),
      s('rect', { class: 'warn', x: at(limits.warning), y: 10, height: 12,
        width: Math.max(at(limits.alarm) - at(limits.warning), 0) }),
      s('rect', { class: 'alarm', x: at(limits.alarm), y: 10, width: WIDTH - at(limits.alarm), height: 12 }),
      value != null && s('path', { class: 'now', d: `M${at(value)},4v24` }),
      [0, 50, 100, 150].map((one) => s('text', { x: Math.min(Math.max(at(one), 8), WIDTH - 13), y: 33,
        'text-anchor': 'middle' }, one)));
    draw();
    const input = (key, word) => h('input', { type: 'number', min: -50, max: 500, step: 'any', value: limits[key],
      required: true, 'aria-label': `${labelOf(name)}: ${word} in °C`, oninput: (event) => {
        limits[key] = event.target.value === '' ? NaN : Number(event.target.value);
        draw();
        this.onchange(name, { ...limits });
      } });
    return h('div', { class: 'limitrow' }, h('b', {}, labelOf(name)),
      h('span', { class: 's mut' }, value == null ? '' : `now ${shortNumber(value)} °C`), picture,
      h('label', { class: 's' }, 'Warning °C ', input('warning', 'warning')),
      h('label', { class: 's' }, 'Alarm °C ', input('alarm', 'alarm')));
  }
}
