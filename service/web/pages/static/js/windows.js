// Low-risk windows on a time axis: what may be learned from, what was, and what is chosen by hand.
import { h, put, s } from './dom.js';
import { counted, dayTime, fixed, hourMinute, milliseconds, spanText } from './format.js';

const HEIGHT = 140;
const BASE = 102;
const HOUR_MS = 3600e3;
const MARGIN = 8;
const LEAST_DRAG_MS = 5 * 60000;

export const pointText = (point) =>
  `${fixed(point.speed_rpm, 0)} rpm, ${fixed(point.load_n, 0)} N, ${spanText(point.duration_s)}`;

const startOf = (window) => milliseconds(window.start);
const endOf = (window) => milliseconds(window.end);

export const overlaps = (one, other) =>
  startOf(one) < endOf(other) && endOf(one) > startOf(other);

export const isUsed = (window, used) => used.some((other) => overlaps(window, other));

/** A span of milliseconds as the service takes it. */
export const windowOf = (fromMs, toMs) =>
  ({ start: new Date(fromMs).toISOString(), end: new Date(toMs).toISOString() });

export class WindowTimeline {
  /** actions: { toggle(window), drag(fromMs, toMs), remove(window) }, used by hand only. */
  constructor(box, actions) {
    this.box = box;
    this.actions = actions;
    this.dragged = null;
    box.addEventListener('pointerdown', (event) => this.begin(event));
    box.addEventListener('pointermove', (event) => this.move(event));
    box.addEventListener('pointerup', (event) => this.end(event));
    box.addEventListener('pointercancel', () => this.stop());
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(box);
  }

  destroy() {
    this.observer.disconnect();
  }

  /**
   * scene: { windows, used (of the active model), chosen, byHand, nowMs, minutes
   * (`OperationMinutes`), region }.
   */
  update(scene) {
    this.scene = scene;
    this.draw();
  }

  draw() {
    if (!this.scene || this.dragged || this.box.clientWidth < 50) return;
    const { windows, chosen, byHand, nowMs, minutes, region } = this.scene;
    const times = [...windows, ...chosen].map(startOf);
    const first = Math.min(minutes.firstMs() ?? Infinity, ...times);
    if (!Number.isFinite(first)) {
      put(this.box, h('p', { class: 'mut s pad' }, 'No data in the store yet.'));
      return;
    }
    this.width = Math.max(280, this.box.clientWidth);
    this.first = first;
    this.span = Math.max(nowMs - first, HOUR_MS);
    const focused = document.activeElement?.closest?.('.wtl [data-window]')?.dataset.window;
    put(this.box, s('svg', {
      viewBox: `0 0 ${this.width} ${HEIGHT}`, role: 'group', class: byHand ? 'byhand' : null,
      'aria-label': `${counted(windows.length, 'low-risk window')} over ${spanText(this.span / 1000)}`,
    },
    this.timeMarks(),
    this.highRiskBoxes(minutes, region), this.speedLine(minutes),
    s('path', { d: `M${MARGIN} ${BASE}H${this.width - MARGIN}`, stroke: 'var(--line-2)' }),
    windows.map((window) => this.windowBox(window)),
    byHand && chosen.filter((one) => !windows.includes(one)).map((one) => this.ownBox(one)),
    this.dragBox = s('rect', {
      y: 12, height: BASE - 12, x: 0, width: 0, fill: 'var(--fan50)', stroke: 'var(--ink)',
      'stroke-dasharray': '4 3', 'pointer-events': 'none',
    })));
    if (focused) this.box.querySelector(`[data-window="${CSS.escape(focused)}"]`)?.focus();
  }

  x(ms) {
    return MARGIN + (ms - this.first) / this.span * (this.width - 2 * MARGIN);
  }

  msAt(event) {
    const box = this.box.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * this.width;
    const share = (x - MARGIN) / (this.width - 2 * MARGIN);
    return this.first + Math.min(1, Math.max(0, share)) * this.span;
  }

  // ---------------------------------------------------------------- by hand
  begin(event) {
    if (!this.scene?.byHand || event.button !== 0 || event.target.closest('[data-own]')) return;
    this.dragged = { fromMs: this.msAt(event), window: event.target.closest('[data-window]') };
    this.box.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.dragged) return;
    const [from, to] = [this.dragged.fromMs, this.msAt(event)].sort((a, b) => a - b);
    this.dragBox.setAttribute('x', this.x(from));
    this.dragBox.setAttribute('width', this.x(to) - this.x(from));
  }

  end(event) {
    if (!this.dragged) return;
    const { fromMs, window } = this.dragged;
    const [from, to] = [fromMs, this.msAt(event)].sort((a, b) => a - b);
    this.stop();
    if (to - from >= Math.max(LEAST_DRAG_MS, this.span / this.width * 6)) {
      this.actions.drag(from, to);
    } else if (window) {
      this.actions.toggle(this.scene.windows.find((one) => one.start === window.dataset.window));
    }
  }

  stop() {
    this.dragged = null;
    this.draw();
  }

  // ---------------------------------------------------------------- drawing
  highRiskBoxes(minutes, region) {
    return region ? minutes.highRisk(region).map(({ fromMs, toMs }) => {
      const [left, width] = [this.x(fromMs), Math.max(2, this.x(toMs) - this.x(fromMs))];
      return s('g', {}, s('title', {}, `high-risk from ${dayTime(fromMs)} for `
        + `${spanText((toMs - fromMs) / 1000)}: never used for training`),
      s('rect', { x: left, y: 34, width, height: BASE - 34, fill: 'var(--line)', opacity: 0.65 }),
      width > 62 && s('text', { x: left + 6, y: 74, style: { fill: 'var(--ink-3)' } },
        'high-risk'));
    }) : null;
  }

  speedLine(minutes) {
    const runs = minutes.speedRuns(this.span / this.width);
    const top = Math.max(1000, ...runs.flat().map(([, speed]) => speed));
    const y = (speed) => BASE - 2 - (BASE - 16) * speed / top;
    const line = (run) => run.map(([ms, speed], i) =>
      `${i ? 'L' : 'M'}${this.x(ms).toFixed(1)} ${y(speed).toFixed(1)}`).join('');
    return s('path', { d: runs.map(line).join(''), class: 'speedline' });
  }

  windowBox(window) {
    const { used, chosen, byHand, windows } = this.scene;
    const highest = Math.max(...windows.map((one) => one.score), 1e-9);
    const left = this.x(startOf(window));
    const width = Math.max(10, this.x(endOf(window)) - left);
    const height = 12 + 64 * window.score / highest;
    const on = chosen.includes(window);
    const learned = isUsed(window, used);
    const durationS = (endOf(window) - startOf(window)) / 1000;
    const text = (y, style, content, room) => width > room
      && s('text', { x: left + width / 2, y, 'text-anchor': 'middle', style }, content);
    const lines = [`${dayTime(startOf(window))}, ${spanText(durationS)}`,
      `score ${fixed(window.score, 2)} (information per hour)`, ...window.operating_points.map(pointText),
      learned && 'in the active model'].filter(Boolean);
    return s('g', {
      'data-window': window.start, class: 'win', tabindex: byHand ? 0 : null,
      role: byHand ? 'checkbox' : null, 'aria-checked': byHand ? String(on) : null,
      'aria-label': lines.join(', '),
      onkeydown: (event) => {
        if (!byHand || ![' ', 'Enter'].includes(event.key)) return;
        event.preventDefault();
        this.actions.toggle(window);
      },
    },
    s('title', {}, lines.join('\n')),
    s('rect', {
      x: left, y: BASE - height, width, height, rx: 2, 'stroke-width': 1.5,
      fill: on ? 'var(--fan50)' : 'var(--panel)', 'fill-opacity': on ? 1 : 0.6,
      stroke: on ? 'var(--twin)' : 'var(--ink-3)',
    }),
    learned && s('rect', { x: left, y: BASE + 1, width, height: 4, fill: 'var(--twin)' }),
    text(BASE - height - 5, { fill: 'var(--ink)', fontWeight: 700 }, fixed(window.score, 2), 30),
    text(BASE + 18, { fill: 'var(--ink-3)' }, spanText(durationS), 52));
  }

  ownBox(window) {
    const left = this.x(startOf(window));
    const width = Math.max(6, this.x(endOf(window)) - left);
    return s('g', { 'data-own': window.start },
      s('title', {}, `added manually: ${dayTime(startOf(window))} to ${dayTime(endOf(window))}`),
      s('rect', {
        x: left, y: 12, width, height: BASE - 12, rx: 2, fill: 'var(--fan50)',
        stroke: 'var(--twin)', 'stroke-width': 1.5, 'stroke-dasharray': '5 3',
      }),
      width > 56 && s('text', { x: left + width / 2, y: 26, 'text-anchor': 'middle',
        style: { fill: 'var(--ink)', fontWeight: 700 } }, 'manual'));
  }

  timeMarks() {
    const marks = [];
    const step = [1, 2, 6, 12, 24, 7 * 24].map((hours) => hours * HOUR_MS)
      .find((one) => this.span / one <= this.width / 80) ?? 30 * 24 * HOUR_MS;
    const zone = new Date(this.first).getTimezoneOffset() * 60000;
    let at = Math.ceil((this.first - zone) / step) * step + zone;
    for (; at < this.first + this.span; at += step) {
      const midnight = hourMinute(at) === '00:00';
      const fits = this.x(at) < this.width - 50;
      marks.push(s('path', { d: `M${this.x(at)} 8V${BASE + 22}`, stroke: 'var(--line)' }),
        fits && s('text', { x: this.x(at) + 5, y: HEIGHT - 3,
          style: midnight ? { fill: 'var(--ink)', fontWeight: 700 } : {} },
        midnight ? dayTime(at).replace(/ \d\d:\d\d$/, '') : hourMinute(at)));
    }
    return marks;
  }
}
