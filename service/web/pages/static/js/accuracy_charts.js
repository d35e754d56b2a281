// Charts of the accuracy view: reliability, error over lead time, forecasts over what came.
import { leadText, NAIVE, STATED } from './accuracy.js';
import { token } from './dom.js';
import { fixed, isNumber } from './format.js';
import {
  fontSize, mount, pixelRatio, roomAround, stroke, timeAxis, valueAxis, write,
} from './paint.js';

const DASHES = { persistence: [10, 5], linear: [3, 4], arx: [12, 4, 3, 4] };
const RISKS = ['low', 'high'];

const points = (colour, hollow = false) => ({
  show: true, size: stroke(9), stroke: token(colour), width: stroke(2),
  fill: token(hollow ? '--panel' : colour),
});

class Chart {
  constructor(box) {
    this.box = box;
  }

  /** Draw data; a chart of another `kind` is made again. */
  show(data, kind, create) {
    if (this.mounted && kind === this.kind) {
      this.mounted.plot.setData(data);
      return;
    }
    this.destroy();
    this.kind = kind;
    this.mounted = mount(this.box, create(), data);
  }

  destroy() {
    this.mounted?.destroy();
    this.mounted = null;
  }
}

/** Share of the measurements below each quantile, over what the quantile states. */
export class ReliabilityChart extends Chart {
  /** shares: { low: below, high: below }, as `together` gives them. */
  update(shares) {
    const stated = Object.values(STATED);
    const rows = RISKS.map((risk) => Object.keys(STATED).map((name) => {
      const share = shares[risk]?.[name];
      return isNumber(share) ? 100 * share : null;
    }));
    this.show([stated, ...rows], 'reliability', () => this.options());
  }

  options() {
    const percent = (_, splits) => splits.map((value) => `${value} %`);
    const axis = { incrs: [25], values: percent };
    const line = (dash, hollow) => ({
      stroke: token('--twin'), width: stroke(2), dash, points: points('--twin', hollow),
    });
    return {
      scales: { x: { time: false, range: () => [0, 100] }, y: { range: () => [0, 100] } },
      axes: [{ ...timeAxis(true), ...axis, space: 30 }, valueAxis(axis)],
      series: [{}, line([], false), line([6, 4], true)],
      cursor: { show: false }, padding: roomAround(),
      hooks: { drawAxes: [(plot) => this.paint(plot)] },
    };
  }

  /** The line on which stated and measured shares are the same. */
  paint(plot) {
    const { ctx: context } = plot;
    const at = (value) => [plot.valToPos(value, 'x', true), plot.valToPos(value, 'y', true)];
    context.save();
    context.strokeStyle = token('--ink-3');
    context.lineWidth = stroke(1.5) * pixelRatio();
    context.beginPath();
    context.moveTo(...at(0));
    context.lineTo(...at(100));
    context.stroke();
    context.restore();
  }
}

/** Mean absolute error of the twin and of simple forecasts, by lead time. */
export class LeadChart extends Chart {
  /** rows: as `byLead` gives them. */
  update(rows) {
    const data = [rows.map((_, i) => i), rows.map((row) => row.mae_k),
      ...Object.keys(NAIVE).map((kind) => rows.map((row) => row.naive[kind]))];
    this.rows = rows;
    this.show(data, 'leads', () => this.options());
  }

  options() {
    const leads = (_, splits) => splits.map((i) => (this.rows[i] ? leadText(this.rows[i].lead) : ''));
    return {
      scales: {
        x: { time: false, range: () => [-0.35, Math.max(this.rows.length - 0.65, 0.65)] },
        y: { range: (_, low, high) => [0, Math.max(high * 1.1, 0.5)] },
      },
      axes: [{ ...timeAxis(true), incrs: [1], space: 30, values: leads },
        valueAxis({ values: (_, splits) => splits.map((value) => fixed(value, value % 1 ? 1 : 0)) })],
      series: [{}, { stroke: token('--twin'), width: stroke(3), points: points('--twin') },
        ...Object.keys(NAIVE).map((kind) => ({
          stroke: token('--ink-2'), width: stroke(2), dash: DASHES[kind],
          points: points('--ink-2', true), spanGaps: true,
        }))],
      cursor: { show: false }, padding: roomAround(),
    };
  }
}

/** Kept forecasts at the time that they were for, over what was measured then. */
export class OutcomeChart extends Chart {
  /** model: { line: { times, values }, points, fromMs, toMs } */
  update(model) {
    this.model = model;
    const { times, values } = model.line;
    const data = times.length ? [times.map((ms) => ms / 1000), values]
      : [[model.fromMs / 1000, model.toMs / 1000], [null, null]];
    this.show(data, 'outcomes', () => this.options());
  }

  options() {
    return {
      scales: {
        x: { time: true, range: () => [this.model.fromMs / 1000, this.model.toMs / 1000] },
        y: { range: (_, low, high) => this.range(low, high) },
      },
      axes: [timeAxis(true), valueAxis()],
      series: [{}, { stroke: token('--ink'), width: stroke(2), points: { show: false } }],
      cursor: { show: false }, padding: roomAround(),
      hooks: { drawAxes: [(plot) => this.paint(plot)] },
    };
  }

  range(low, high) {
    const edges = this.model.points.flatMap(({ reading }) => [reading.q025, reading.q975]);
    const all = [low, high, ...edges].filter(isNumber);
    if (!all.length) return [0, 100];
    const [least, most] = [Math.min(...all), Math.max(...all)];
    const room = Math.max((most - least) * 0.06, 1);
    return [least - room, most + room];
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const span = Math.max(this.model.points.length, 12);
    const wide = Math.min(Math.max(bbox.width / span * 0.5, 3 * ratio), 14 * ratio);
    context.save();
    context.beginPath();
    context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    context.clip();
    for (const point of this.model.points) this.paintPoint(plot, point, wide);
    context.restore();
    if (!this.model.points.length) {
      write(context, 'No forecast of this lead time is due yet', bbox.left + bbox.width / 2,
        bbox.top + bbox.height / 2,
        { size: fontSize() * ratio, colour: token('--ink-2'), align: 'center', base: 'middle' });
    }
  }

  /** The 95 % and the 50 % band of a forecast and its median; hollow where it is not scored. */
  paintPoint(plot, { time, reading, state }, wide) {
    const { ctx: context } = plot;
    const ratio = pixelRatio();
    const x = plot.valToPos(time / 1000, 'x', true);
    const at = (value) => plot.valToPos(value, 'y', true);
    const bar = (low, high, width, look) => {
      if (!isNumber(low) || !isNumber(high)) return;
      const [top, bottom] = [at(high), at(low)];
      if (state === 'scored') {
        context.fillStyle = token(look);
        context.fillRect(x - width / 2, top, width, bottom - top);
      } else {
        context.strokeStyle = token('--ink-3');
        context.lineWidth = ratio;
        context.setLineDash([3 * ratio, 3 * ratio]);
        context.strokeRect(x - width / 2, top, width, bottom - top);
        context.setLineDash([]);
      }
    };
    bar(reading.q025, reading.q975, wide, '--fan95');
    bar(reading.q25, reading.q75, wide, '--fan50');
    if (state === 'scored') {
      context.fillStyle = token('--twin');
      context.fillRect(x - wide / 2, at(reading.q50) - ratio, wide, 2 * ratio);
      const outside = reading.measured_c < reading.q025 || reading.measured_c > reading.q975;
      if (outside) this.paintOutside(context, x, at(reading.measured_c), wide);
    }
  }

  /** A reading that was outside the 95 % band. */
  paintOutside(context, x, y, wide) {
    const size = Math.max(wide * 0.6, 4 * pixelRatio());
    context.strokeStyle = token('--ink');
    context.lineWidth = stroke(2) * pixelRatio();
    context.beginPath();
    context.moveTo(x - size, y - size);
    context.lineTo(x + size, y + size);
    context.moveTo(x - size, y + size);
    context.lineTo(x + size, y - size);
    context.stroke();
  }
}
