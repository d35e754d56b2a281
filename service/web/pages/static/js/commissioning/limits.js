// The low-risk region and the limits as pictures: a corner that is dragged or moved with the arrow keys, scales.
import { Panel, v } from '../parts/panel.js';
import { NumberField } from '../parts/number_field.js';
import { labelOf, shortNumber } from './configuration.js';

const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [520, 300, 62, 44, 16, 16];
const FLOOR = HEIGHT - BOTTOM;
const STEPS = { speed: 100, load: 100 };

const nice = (value) => {
  const size = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 4, 5, 8, 10].map((one) => one * size).find((one) => one >= value);
};

/** low: { speed_rpm_max, load_n_max }; present: { speed, load } as measured, or null; onchange(low) */
export class RegionPlane extends Panel {
  render({ low, present }) {
    // A number that is being typed may be none.
    if (low.speed_rpm_max > 0 && low.load_n_max > 0) this.low = low;
    const { speed_rpm_max: speed, load_n_max: load } = this.low ??= { speed_rpm_max: 100, load_n_max: 100 };
    if (!this.isDragged) {
      this.most = {
        speed: nice(Math.max(speed, present?.speed ?? 0, 100) * 1.5),
        load: nice(Math.max(load, present?.load ?? 0, 100) * 1.5),
      };
    }
    const [x, y] = [this.x(speed), this.y(load)];
    // The name of the region keeps away from the present point.
    const nameY = present && this.y(present.load) > (y + FLOOR) / 2 ? y + 20 : FLOOR - 10;
    const drop = () => { this.isDragged = false; };
    return v('div', { class: 'regionbox' }, v('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: 'region',
      role: 'group', 'aria-label': 'Low-risk region in the plane of speed and load', onpointerup: drop,
      onpointercancel: drop,
      onpointermove: (event) => this.isDragged && this.moveTo(event) },
    [0, 0.25, 0.5, 0.75, 1].map((part) => this.grid(part)),
    v('rect', { class: 'low', x: LEFT, y, width: x - LEFT, height: FLOOR - y }),
    v('text', { class: 'in', x: (LEFT + x) / 2, y: nameY, 'text-anchor': 'middle' }, 'low risk: learn here'),
    v('text', { class: 'out', x: WIDTH - RIGHT - 6, y: TOP + 16, 'text-anchor': 'end' }, 'forecast only'),
    v('text', { x: (LEFT + WIDTH) / 2, y: HEIGHT - 6, 'text-anchor': 'middle' }, 'Speed in rpm'),
    v('text', { x: 14, y: HEIGHT / 2, 'text-anchor': 'middle', transform: `rotate(-90 14 ${HEIGHT / 2})` },
      'Load in N'),
    present && v('g', { class: 'now' },
      v('path', { d: `M${this.x(present.speed) - 7},${this.y(present.load)}h14m-7,-7v14` }),
      v('text', { x: this.x(present.speed) + 9, y: this.y(present.load) - 6 }, 'now')),
    v('circle', {
      class: 'handle', cx: x, cy: y, r: 9, tabindex: 0, role: 'slider',
      'aria-label': 'Corner of the low-risk region; arrow keys move it',
      'aria-valuenow': Math.round(speed), 'aria-valuemin': 100, 'aria-valuemax': this.most.speed,
      'aria-valuetext': `up to ${speed} rpm and ${load} N`,
      onpointerdown: ({ currentTarget, pointerId }) => {
        this.isDragged = true;
        currentTarget.ownerSVGElement.setPointerCapture(pointerId);
      },
      onkeydown: (event) => this.key(event),
    })));
  }

  grid(part) {
    const [x, y] = [this.x(this.most.speed * part), this.y(this.most.load * part)];
    return [
      v('path', { class: 'grid', d: `M${x},${TOP}V${FLOOR}M${LEFT},${y}H${WIDTH - RIGHT}` }),
      v('text', { x, y: FLOOR + 17, 'text-anchor': 'middle' }, Math.round(this.most.speed * part)),
      part > 0 && v('text', { x: LEFT - 7, y: y + 4, 'text-anchor': 'end' }, Math.round(this.most.load * part)),
    ];
  }

  x(speed) { return LEFT + speed / this.most.speed * (WIDTH - LEFT - RIGHT); }

  y(load) { return FLOOR - load / this.most.load * (FLOOR - TOP); }

  key(event) {
    const [speed, load] = {
      ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
    }[event.key] ?? [0, 0];
    if (!speed && !load) return;
    event.preventDefault();
    this.change(this.low.speed_rpm_max + speed * STEPS.speed, this.low.load_n_max + load * STEPS.load);
  }

  moveTo({ currentTarget, clientX, clientY }) {
    const box = currentTarget.getBoundingClientRect();
    const [x, y] = [(clientX - box.left) / box.width * WIDTH, (clientY - box.top) / box.height * HEIGHT];
    const part = (value) => Math.min(Math.max(value, 0.02), 1);
    const speed = part((x - LEFT) / (WIDTH - LEFT - RIGHT)) * this.most.speed;
    const load = part((FLOOR - y) / (FLOOR - TOP)) * this.most.load;
    this.change(Math.round(speed / 50) * 50, Math.round(load / 50) * 50);
  }

  change(speed, load) {
    this.props.onchange({ speed_rpm_max: Math.max(speed, 50), load_n_max: Math.max(load, 50) });
  }
}

const [SCALE_WIDTH, SCALE_HEIGHT, LOWEST, HIGHEST] = [260, 34, 0, 150];
const scaleAt = (value) => Math.min(Math.max((value - LOWEST) / (HIGHEST - LOWEST), 0), 1) * SCALE_WIDTH;

/** rows: [channel, { warning, alarm }, present value or null]; onchange(channel, { warning, alarm }) */
export const limitScales = (rows, onchange) => v('div', { class: 'scales' }, rows.map(([name, limits, value]) => {
  const input = (key) => v(NumberField, { least: -50, most: 500, unit: '°C', unitShown: true, value: limits[key],
    required: true, 'aria-label': `${labelOf(name)}: ${key} in °C`,
    oninput: (degrees) => onchange(name, { ...limits, [key]: degrees ?? NaN }) });
  return v('div', { class: 'limitrow', key: name }, v('b', {}, labelOf(name)),
    v('span', { class: 's mut' }, value == null ? '' : `now ${shortNumber(value)} °C`),
    v('svg', { viewBox: `0 0 ${SCALE_WIDTH} ${SCALE_HEIGHT}`, class: 'limitscale', 'aria-hidden': 'true' },
      v('rect', { class: 'calm', x: 0, y: 10, width: scaleAt(limits.warning) || 0, height: 12 }),
      v('rect', { class: 'warn', x: scaleAt(limits.warning) || 0, y: 10, height: 12,
        width: Math.max(scaleAt(limits.alarm) - scaleAt(limits.warning), 0) || 0 }),
      v('rect', { class: 'alarm', x: scaleAt(limits.alarm) || 0, y: 10, height: 12,
        width: SCALE_WIDTH - scaleAt(limits.alarm) || 0 }),
      value != null && v('path', { class: 'now', d: `M${scaleAt(value)},4v24` }),
      [0, 50, 100, 150].map((one) => v('text', { x: Math.min(Math.max(scaleAt(one), 8), SCALE_WIDTH - 13), y: 33,
        'text-anchor': 'middle' }, one))),
    v('label', { class: 's' }, 'Warning ', input('warning')), v('label', { class: 's' }, 'Alarm ', input('alarm')));
}));
