// One lane of the plan below the temperatures: measured past, planned future.
import { token } from './dom.js';
import { fixed, isNumber } from './format.js';
import {
  cursor, font, fontSize, mount, paintAhead, paintNow, pixelRatio, roomAround, stroke, timeAxis,
  valueAxis, write,
} from './paint.js';

const nulls = (count) => Array(count).fill(null);
const SAME = 0.005; // a measured value this near to its set-point needs no second figure
const LANE_STEPS = [500, 1000, 2000, 3000, 5000, 10000, 20000];

/**
 * Speed or load, with the set-point written on every step ahead.
 *
 * A model is { nowMs, fromMs, endMs, times (ms), values, current, steps, key }.
 */
export class LaneChart {
  constructor(box, { label, showTime, syncKey }) {
    this.box = box;
    this.options = { label, showTime, syncKey };
    this.mounted = null;
    this.step = 1000;
  }

  update(model) {
    this.model = model;
    const seen = [...model.values, ...model.steps.map((step) => step[model.key])];
    const top = Math.max(0, ...seen.filter(isNumber));
    this.step = LANE_STEPS.find((step) => top <= 2.5 * step) ?? top / 2;
    const times = [...model.times, model.nowMs];
    const planned = nulls(times.length);
    const values = [...model.values, model.current];
    for (const step of model.steps) {
      times.push(step.from + 1, step.to);
      planned.push(step[model.key], step[model.key]);
      values.push(null, null);
    }
    const data = [times.map((time) => time / 1000), values, planned];
    if (!this.mounted) this.create(data);
    else this.mounted.plot.setData(data);
  }

  destroy() {
    this.mounted?.destroy();
  }

  create(data) {
    const thousands = (value) => (value ? `${value / 1000} k` : '0');
    this.mounted = mount(this.box, {
      scales: {
        x: { time: true, range: () => [this.model.fromMs / 1000, this.model.endMs / 1000] },
        y: { range: () => [-0.13 * this.step, 2.65 * this.step] },
      },
      axes: [timeAxis(this.options.showTime), valueAxis({
        splits: () => [0, this.step, 2 * this.step],
        values: (_, splits) => splits.map(thousands),
      })],
      series: [{},
        { stroke: token('--ink'), width: stroke(2), points: { show: false } },
        { stroke: token('--ink-2'), width: stroke(2), dash: [7, 5], points: { show: false } }],
      padding: [2, 8, this.options.showTime ? 0 : roomAround()[2] / 2, 0], cursor: cursor(this.options.syncKey),
      hooks: {
        drawClear: [(plot) => paintAhead(plot, this.model.nowMs / 1000)],
        draw: [(plot) => this.paint(plot)],
      },
    }, data);
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    const { model } = this;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    context.save();
    model.steps.forEach((step, i) => {
      const change = i ? Math.abs(step[model.key] - model.steps[i - 1][model.key]) : Infinity;
      if (change < SAME * Math.abs(step[model.key])) return;
      const next = i === 1;
      const left = plot.valToPos(step.from / 1000, 'x', true);
      const right = Math.min(plot.valToPos(step.to / 1000, 'x', true), bbox.left + bbox.width);
      const text = fixed(step[model.key], 0);
      context.font = font(size * (next ? 1.1 : 1), next);
      if (context.measureText(text).width > right - left - 8 * ratio) return;
      const y = plot.valToPos(step[model.key], 'y', true);
      const above = y - size * 1.5 > bbox.top;
      write(context, text, left + 6 * ratio, y + (above ? -4 : 5) * ratio, {
        size: size * (next ? 1.1 : 1), strong: next, base: above ? 'bottom' : 'top',
        colour: token(next ? '--ink' : '--ink-2'),
      });
    });
    write(context, this.options.label, bbox.left + 8 * ratio, bbox.top + 3 * ratio,
      { size, base: 'top', colour: token('--ink-2') });
    paintNow(plot, model.nowMs / 1000);
    context.restore();
  }
}
