// How the best fitness of an identification falls, next to that of the active version.
import { token } from './dom.js';
import { isNumber, significant } from './format.js';
import { mount, pixelRatio, fontSize, timeAxis, valueAxis, write } from './paint.js';

const FEW = 300; // times from the least to the greatest figure

/** Whether a figure is a digit of these times a power of ten. */
function isRound(value, digits) {
  const mantissa = value / 10 ** Math.floor(Math.log10(value) + 1e-9);
  return digits.includes(Number(mantissa.toFixed(6)));
}

export class ConvergenceChart {
  constructor(box) {
    this.box = box;
  }

  /** points: [[evaluations, fitness], …]; reference: { fitness, label } or null. */
  update(points, reference) {
    this.reference = isNumber(reference?.fitness) ? reference : null;
    this.empty = !points.length;
    const data = points.length ? [points.map(([count]) => count), points.map(([, fit]) => fit)]
      : [[0, 1], [null, null]];
    if (!this.mounted) this.create(data);
    else this.mounted.plot.setData(data);
  }

  create(data) {
    const thousands = (value) => (value >= 1000 ? `${value / 1000} k` : String(value));
    this.mounted = mount(this.box, {
      scales: {
        x: { time: false, range: (_, low, high) => [0, Math.max(high * 1.05, 100)] },
        y: { distr: 3, range: (_, low, high) => this.range(low, high) },
      },
      axes: [{ ...timeAxis(true), values: (_, splits) => splits.map(thousands), space: 60 },
        valueAxis({ values: (_, splits) => this.labels(splits), space: 22 })],
      series: [{}, { stroke: token('--twin'), width: 2.5, points: { show: false } }],
      cursor: { show: false }, padding: [8, 10, 0, 0],
      hooks: { draw: [(plot) => this.paint(plot)] },
    }, data);
  }

  /** A little more than the data and the reference need; the lines of the axis begin at its foot. */
  range(low, high) {
    const ends = [low, high, this.reference?.fitness].filter((value) => value > 0);
    if (!ends.length) return [1, 100];
    const foot = Math.min(...ends) / 1.3;
    const power = 10 ** Math.floor(Math.log10(foot));
    return [Math.floor(foot / power) * power, Math.max(...ends) * 1.6];
  }

  /** 1, 2 and 5 where there is room for them, else powers of ten. */
  labels(splits) {
    const known = splits.filter(isNumber);
    const digits = Math.max(...known) / Math.min(...known) < FEW ? [1, 2, 5] : [1];
    return splits.map((value) =>
      (value !== null && isRound(value, digits) ? significant(value) : ''));
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const right = bbox.left + bbox.width - 6 * ratio;
    const look = { size: fontSize() * ratio, colour: token('--ink-2'), align: 'right' };
    context.save();
    if (this.reference) {
      const y = plot.valToPos(this.reference.fitness, 'y', true);
      context.strokeStyle = token('--ink-3');
      context.lineWidth = 1.5 * ratio;
      context.setLineDash([4 * ratio, 4 * ratio]);
      context.beginPath();
      context.moveTo(bbox.left, y);
      context.lineTo(bbox.left + bbox.width, y);
      context.stroke();
      context.setLineDash([]);
      write(context, this.reference.label, right, y - 3 * ratio,
        { ...look, halo: token('--panel') });
    }
    if (this.empty) {
      write(context, 'No data yet', bbox.left + bbox.width / 2,
        bbox.top + bbox.height / 2, { ...look, align: 'center', base: 'middle' });
    }
    context.restore();
  }

  destroy() {
    this.mounted?.destroy();
  }
}
