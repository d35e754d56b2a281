// One lane of the plan below the temperatures: measured past, planned future.
import { token } from '../parts/dom.js';
import { fixed, isNumber } from '../parts/format.js';
import { Chart, Pen } from './chart.js';
import { lineOf, roomAround, timeAxis, timeScale, valueAxis } from './paint.js';

const SAME = 0.005; // a measured value this near to its set-point needs no second figure
const LANE_STEPS = [500, 1000, 2000, 3000, 5000, 10000, 20000];

/**
 * Speed or load, with the set-point written on every step ahead.
 *
 * A model is { nowMs, fromMs, endMs, times (ms), values, current, steps, key }.
 */
export class LaneChart extends Chart {
  /** @param {any} given label, showTime: whether the axis has figures, syncKey */
  constructor(box, given) {
    super(box);
    this.given = given;
  }

  update(model) {
    this.model = model;
    const seen = [...model.values, ...model.steps.map((step) => step[model.key])];
    const top = Math.max(0, ...seen.filter(isNumber));
    this.step = LANE_STEPS.find((step) => top <= 2.5 * step) ?? top / 2;
    const times = [...model.times, model.nowMs];
    const planned = Array(times.length).fill(null);
    const values = [...model.values, model.current];
    for (const step of model.steps) {
      times.push(step.from + 1, step.to);
      planned.push(step[model.key], step[model.key]);
      values.push(null, null);
    }
    this.show([times.map((time) => time / 1000), values, planned]);
  }

  options() {
    return {
      scales: { x: timeScale(() => this.model.fromMs, () => this.model.endMs),
        y: { range: () => [-0.13 * this.step, 2.65 * this.step] } },
      axes: [timeAxis(this.given.showTime), valueAxis({
        splits: () => [0, this.step, 2 * this.step],
        values: (_, splits) => splits.map((value) => (value ? `${value / 1000} k` : '0')),
      })],
      series: [{}, lineOf(token('--ink'), 2), lineOf(token('--ink-2'), 2, { dash: [7, 5] })],
      padding: [2, 8, this.given.showTime ? 0 : roomAround()[2] / 2, 0], cursor: { sync: { key: this.given.syncKey } },
      hooks: { drawClear: [(plot) => new Pen(plot).ahead(this.model.nowMs)] },
    };
  }

  paint(pen) {
    const { steps, key, nowMs } = this.model;
    steps.forEach((step, i) => {
      const value = step[key];
      const change = i ? Math.abs(value - steps[i - 1][key]) : Infinity;
      if (change < SAME * Math.abs(value)) return;
      const [next, size] = i === 1 ? [true, pen.size * 1.1] : [false, pen.size];
      const [left, right] = [pen.at(step.from), Math.min(pen.at(step.to), pen.right)];
      const text = fixed(value, 0);
      if (pen.widthOf(text, size, next) > right - left - 8 * pen.ratio) return;
      const y = pen.y(value);
      const above = y - pen.size * 1.5 > pen.top;
      pen.text(text, left + 6 * pen.ratio, y + (above ? -4 : 5) * pen.ratio, {
        size, strong: next, base: above ? 'bottom' : 'top', colour: next ? '--ink' : '--ink-2', halo: '',
      });
    });
    pen.title(this.given.label, '');
    pen.now(nowMs);
  }
}
