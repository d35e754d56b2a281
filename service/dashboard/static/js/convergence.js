// How the best fitness of a running identification falls.
import { token } from './dom.js';
import { significant } from './format.js';
import { mount, pixelRatio, fontSize, timeAxis, valueAxis, write } from './paint.js';

export class ConvergenceChart {
  constructor(box) {
    this.box = box;
  }

  /** `trace` is [evaluations, best fitness], as `Live` keeps it with a job. */
  update(trace) {
    if (this.mounted) {
      this.mounted.plot.setData(trace);
      return;
    }
    if (trace[0].length < 2) return;
    const thousands = (value) => (value >= 1000 ? `${value / 1000} k` : String(value));
    this.mounted = mount(this.box, {
      scales: { x: { time: false, range: (_, low, high) => [0, Math.max(high * 1.05, 100)] },
        y: { distr: 3 } },
      axes: [{ ...timeAxis(true), values: (_, splits) => splits.map(thousands), space: 60 },
        valueAxis({ values: (_, splits) => splits.map((value) =>
          (value === null ? '' : significant(value))), space: 30 })],
      series: [{}, { stroke: token('--twin'), width: 2.5, points: { show: false } }],
      cursor: { show: false }, padding: [8, 10, 0, 0],
      hooks: { draw: [(plot) => this.paint(plot)] },
    }, trace);
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const look = {
      size: fontSize() * ratio, colour: token('--ink-2'), align: 'right', base: 'top',
    };
    context.save();
    write(context, 'best fitness over evaluations', bbox.left + bbox.width - 6 * ratio,
      bbox.top + 4 * ratio, look);
    context.restore();
  }

  destroy() {
    this.mounted?.destroy();
  }
}
