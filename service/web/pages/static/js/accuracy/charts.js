// Charts of the accuracy view: reliability, error over lead time, forecasts against measured.
import { leadText, NAIVE, STATED } from './scores.js';
import { Chart, Pen } from '../charts/chart.js';
import { token } from '../parts/dom.js';
import { fixed, isNumber } from '../parts/format.js';
import { lineOf, stroke, timeAxis, timeScale, valueAxis } from '../charts/paint.js';

const DASHES = { persistence: [10, 5], linear: [3, 4], arx: [12, 4, 3, 4] };
const RISKS = ['low', 'high'];

const points = (colour, hollow = false) => ({
  show: true, size: stroke(9), stroke: token(colour), width: stroke(2),
  fill: token(hollow ? '--panel' : colour),
});

const under = (chart) => ({ draw: [], drawAxes: [(plot) => chart.paint(new Pen(plot))] });

export class ReliabilityChart extends Chart {
  update(shares) {
    const stated = Object.values(STATED);
    const rows = RISKS.map((risk) => Object.keys(STATED).map((name) => {
      const share = shares[risk]?.[name];
      return isNumber(share) ? 100 * share : null;
    }));
    this.show([stated, ...rows]);
  }

  options() {
    const axis = { incrs: [25], values: (_, splits) => splits.map((value) => `${value} %`) };
    const line = (dash, hollow) => lineOf(token('--twin'), 2, { dash, points: points('--twin', hollow) });
    return {
      scales: { x: { time: false, range: () => [0, 100] }, y: { range: () => [0, 100] } },
      axes: [timeAxis(true, { ...axis, space: 30 }), valueAxis(axis)],
      series: [{}, line([], false), line([6, 4], true)], hooks: under(this),
    };
  }

  paint(pen) {
    pen.line({ colour: '--ink-3', width: 1.5 }, [0, 100].map((value) => [pen.x(value), pen.y(value)]));
  }
}

/** Mean absolute error of the twin and of simple forecasts, by lead time. */
export class LeadChart extends Chart {
  update(rows) {
    this.rows = rows;
    this.show([rows.map((_, i) => i), rows.map((row) => row.mae_k),
      ...Object.keys(NAIVE).map((kind) => rows.map((row) => row.naive[kind]))]);
  }

  options() {
    return {
      scales: {
        x: { time: false, range: () => [-0.35, Math.max(this.rows.length - 0.65, 0.65)] },
        y: { range: (_, low, high) => [0, Math.max(high * 1.1, 0.5)] },
      },
      axes: [timeAxis(true, { incrs: [1], space: 30,
        values: (_, splits) => splits.map((i) => (this.rows[i] ? leadText(this.rows[i].lead) : '')) }),
      valueAxis({ values: (_, splits) => splits.map((value) => fixed(value, value % 1 ? 1 : 0)) })],
      series: [{}, lineOf(token('--twin'), 3, { points: points('--twin') }), ...Object.keys(NAIVE).map((kind) =>
        lineOf(token('--ink-2'), 2, { dash: DASHES[kind], points: points('--ink-2', true), spanGaps: true }))],
    };
  }
}

export class OutcomeChart extends Chart {
  update(model) {
    this.model = model;
    const { line: { times, values }, fromMs, toMs } = model;
    this.show(times.length ? [times.map((ms) => ms / 1000), values] : [[fromMs / 1000, toMs / 1000], [null, null]]);
  }

  options() {
    return {
      scales: { x: timeScale(() => this.model.fromMs, () => this.model.toMs),
        y: { range: (_, low, high) => this.range(low, high) } },
      axes: [timeAxis(true), valueAxis()], series: [{}, lineOf(token('--ink'), 2)], hooks: under(this),
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

  paint(pen) {
    const span = Math.max(this.model.points.length, 12);
    const wide = Math.min(Math.max(pen.width / span * 0.5, 3 * pen.ratio), 14 * pen.ratio);
    pen.within(() => this.model.points.forEach((point) => paintPoint(pen, point, wide)));
    if (!this.model.points.length) pen.nothing('No forecast of this lead time is due yet');
  }
}

/** The 95 % and the 50 % band of a forecast and its median; hollow where it is not scored. */
function paintPoint(pen, { time, reading, state }, wide) {
  const { context, ratio } = pen;
  const x = pen.at(time);
  const bar = (low, high, look) => {
    if (!isNumber(low) || !isNumber(high)) return;
    const area = [x - wide / 2, pen.y(high), wide, pen.y(low) - pen.y(high)];
    context.fillStyle = token(look);
    context.strokeStyle = token('--ink-3');
    context.lineWidth = ratio;
    context.setLineDash([3 * ratio, 3 * ratio]);
    if (state === 'scored') context.fillRect(...area);
    else context.strokeRect(...area);
    context.setLineDash([]);
  };
  bar(reading.q025, reading.q975, '--fan95');
  bar(reading.q25, reading.q75, '--fan50');
  if (state !== 'scored') return;
  context.fillStyle = token('--twin');
  context.fillRect(x - wide / 2, pen.y(reading.q50) - ratio, wide, 2 * ratio);
  if (reading.measured_c >= reading.q025 && reading.measured_c <= reading.q975) return;
  // A reading that was outside the 95 % band.
  const [y, size] = [pen.y(reading.measured_c), Math.max(wide * 0.6, 4 * ratio)];
  pen.line({ colour: '--ink', width: 2 }, [[x - size, y - size], [x + size, y + size]],
    [[x - size, y + size], [x + size, y - size]]);
}
