// The low-risk region as a picture: its corner is drawn, dragged, or moved with the arrow keys.
import { h, put, s } from './dom.js';

const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [520, 300, 62, 44, 16, 16];
const STEPS = { speed: 100, load: 100 };

const nice = (value) => {
  const size = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 4, 5, 8, 10].map((one) => one * size).find((one) => one >= value);
};

export class RegionPlane {
  /** onchange is called with { speed_rpm_max, load_n_max } */
  constructor(onchange) {
    this.onchange = onchange;
    this.svg = s('svg', { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: 'region', role: 'group',
      'aria-label': 'Low-risk region in the plane of speed and load' });
    this.element = h('div', { class: 'regionbox' }, this.svg);
    this.svg.addEventListener('pointermove', (event) => this.dragged && this.moveTo(event));
    this.svg.addEventListener('pointerup', () => { this.dragged = false; });
    this.svg.addEventListener('pointercancel', () => { this.dragged = false; });
  }

  /** low: { speed_rpm_max, load_n_max }; present: { speed, load } as measured, or null */
  show(low, present = this.present) {
    this.low = low;
    this.present = present;
    if (!this.dragged) {
      this.most = {
        speed: nice(Math.max(low.speed_rpm_max, present?.speed ?? 0, 100) * 1.5),
        load: nice(Math.max(low.load_n_max, present?.load ?? 0, 100) * 1.5),
      };
    }
    const [x, y] = [this.x(low.speed_rpm_max), this.y(low.load_n_max)];
    const focused = document.activeElement === this.handle;
    const floor = HEIGHT - BOTTOM;
    this.handle = s('circle', {
      class: 'handle', cx: x, cy: y, r: 9, tabindex: 0, role: 'slider',
      'aria-label': 'Corner of the low-risk region; arrow keys move it',
      'aria-valuenow': Math.round(low.speed_rpm_max), 'aria-valuemin': 100, 'aria-valuemax': this.most.speed,
      'aria-valuetext': `up to ${low.speed_rpm_max} rpm and ${low.load_n_max} N`,
      onpointerdown: (event) => { this.dragged = true; this.svg.setPointerCapture(event.pointerId); },
      onkeydown: (event) => this.key(event),
    });
    put(this.svg,
      [0, 0.25, 0.5, 0.75, 1].map((part) => this.grid(part, floor)),
      s('rect', { class: 'low', x: LEFT, y, width: x - LEFT, height: floor - y }),
      s('text', { class: 'in', x: (LEFT + x) / 2, y: (y + floor) / 2, 'text-anchor': 'middle' },
        'low risk: learn here'),
      s('text', { class: 'out', x: WIDTH - RIGHT - 6, y: TOP + 16, 'text-anchor': 'end' }, 'forecast only'),
      s('text', { x: (LEFT + WIDTH) / 2, y: HEIGHT - 6, 'text-anchor': 'middle' }, 'Speed in rpm'),
      s('text', { x: 14, y: HEIGHT / 2, 'text-anchor': 'middle',
        transform: `rotate(-90 14 ${HEIGHT / 2})` }, 'Load in N'),
      present && s('g', { class: 'now' },
        s('path', { d: `M${this.x(present.speed) - 7},${this.y(present.load)}h14m-7,-7v14` }),
        s('text', { x: this.x(present.speed) + 9, y: this.y(present.load) - 6 }, 'now')),
      this.handle);
    if (focused) this.handle.focus();
  }

  grid(part, floor) {
    const [x, y] = [this.x(this.most.speed * part), this.y(this.most.load * part)];
    return [
      s('path', { class: 'grid', d: `M${x},${TOP}V${floor}M${LEFT},${y}H${WIDTH - RIGHT}` }),
      s('text', { x, y: floor + 17, 'text-anchor': 'middle' }, String(Math.round(this.most.speed * part))),
      part > 0 && s('text', { x: LEFT - 7, y: y + 4, 'text-anchor': 'end' }, String(Math.round(this.most.load * part))),
    ];
  }

  x(speed) { return LEFT + speed / this.most.speed * (WIDTH - LEFT - RIGHT); }

  y(load) { return HEIGHT - BOTTOM - load / this.most.load * (HEIGHT - BOTTOM - TOP); }

  key(event) {
    const [speed, load] = {
      ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
    }[event.key] ?? [0, 0];
    if (!speed && !load) return;
    event.preventDefault();
    this.change(this.low.speed_rpm_max + speed * STEPS.speed, this.low.load_n_max + load * STEPS.load);
  }

  moveTo(event) {
    const box = this.svg.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width * WIDTH, (event.clientY - box.top) / box.height * HEIGHT];
    const part = (value) => Math.min(Math.max(value, 0.02), 1);
    const speed = part((x - LEFT) / (WIDTH - LEFT - RIGHT)) * this.most.speed;
    const load = part((HEIGHT - BOTTOM - y) / (HEIGHT - BOTTOM - TOP)) * this.most.load;
    this.change(Math.round(speed / 50) * 50, Math.round(load / 50) * 50);
  }

  change(speed, load) {
    const low = { speed_rpm_max: Math.max(speed, 50), load_n_max: Math.max(load, 50) };
    this.show(low);
    this.onchange(low);
  }
}
