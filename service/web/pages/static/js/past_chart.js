// A chart of the past: mean lines within their minimum and maximum, holes hatched.
import { ChartCursor } from './chart_cursor.js';
import { rem, token } from './dom.js';
import { channelName, dayTimeSecond, fixed, isNumber, utc } from './format.js';
import {
  font, fontSize, hatching, mount, pixelRatio, roomAround, stroke, valueAxis, write,
} from './paint.js';
import { joined } from './past.js';

const CLEAR = 'rgba(0,0,0,0)';
const PER_LINE = 3;
const LEAST_DRAG = 6;
// Lines of the same colour differ by their dashes; names stand beside the figures.
const DASHES = [[], [10, 5], [3, 4], [12, 4, 3, 4], [6, 3]];

const isTwin = (name) => name.endsWith('.twin');

/** How a channel is drawn: the twin in its blue, everything measured in ink. */
export function lookOf(names, name) {
  const same = names.filter((one) => isTwin(one) === isTwin(name));
  return {
    colour: isTwin(name) ? '--twin' : '--ink', dash: DASHES[same.indexOf(name) % DASHES.length],
  };
}

export const lineName = (name) => (isTwin(name) ? `${channelName(name.slice(0, -5))}, twin`
  : channelName(name));

export class PastChart {
  /** onZoom(fromMs, toMs): a range was selected with the mouse; onDrawn(): the chart was drawn. */
  constructor(box, { title, unit, syncKey, onZoom, onDrawn = () => {} }) {
    Object.assign(this, { box, title, unit, syncKey, onZoom, onDrawn });
  }

  /**
   * model: { names, lines: { name: line }, fromMs, toMs, showTime,
   * limits: [{ name, level, value, priority }], notes: [{ ms, text }] }.
   */
  update(model) {
    this.model = model;
    const key = [...model.names, model.showTime].join();
    const data = joined(model.names.map((name) => model.lines[name] ?? EMPTY));
    if (this.mounted && key === this.key) {
      this.mounted.plot.setData(data);
      return;
    }
    this.destroy();
    this.key = key;
    this.create(data);
  }

  destroy() {
    this.mounted?.destroy();
    this.reading?.destroy();
    this.mounted = null;
  }

  create(data) {
    const { names } = this.model;
    const series = [{}];
    const bands = [];
    names.forEach((name, i) => {
      const { colour, dash } = lookOf(names, name);
      const line = (ink, width, dashes) => ({
        stroke: ink, width, dash: dashes, points: { show: false }, spanGaps: false,
      });
      series.push(line(token(colour), stroke(2), dash), line(CLEAR, 0), line(CLEAR, 0));
      bands.push({
        series: [PER_LINE * i + 3, PER_LINE * i + 2],
        fill: token(isTwin(name) ? '--fan95' : '--range'),
      });
    });
    this.reading = new ChartCursor(this.box, (index) => this.readAt(index));
    this.mounted = mount(this.box, {
      scales: {
        x: { time: true, range: () => [this.model.fromMs / 1000, this.model.toMs / 1000] },
        y: { range: (_, low, high) => roomy(low, high, this.box.clientHeight) },
      },
      axes: [spanAxis(this.model.showTime), valueAxis({
        values: (_, splits) => splits.map((value) => fixed(value, decimals(splits))),
      })],
      series, bands, padding: roomAround(),
      cursor: {
        y: false, points: { show: false }, sync: { key: this.syncKey },
        drag: { x: true, y: false, setScale: false },
      },
      hooks: {
        draw: [(plot) => this.paint(plot)],
        setCursor: [() => this.reading.show()],
        setSelect: [(plot) => this.select(plot)],
      },
    }, data);
    this.reading.attach(this.mounted.plot);
  }

  /** Where the plot stands within its box: { left, width } in pixels; null before it is drawn. */
  area() {
    if (!this.mounted) return null;
    const plot = this.mounted.plot.over.getBoundingClientRect();
    return { left: plot.left - this.box.getBoundingClientRect().left, width: plot.width };
  }

  select(plot) {
    const { left, width } = plot.select;
    if (width < LEAST_DRAG) return;
    const at = (pixel) => plot.posToVal(pixel, 'x') * 1000;
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.onZoom(at(left), at(left + width));
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    context.save();
    context.beginPath();
    context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    context.clip();
    this.paintGaps(plot);
    this.paintLimits(plot);
    this.paintNotes(plot);
    this.paintNames(plot);
    this.reading.paintMark(plot);
    context.restore();
    this.onDrawn();
    write(context, `${this.title}, ${this.unit}`, bbox.left + 8 * ratio, bbox.top + 3 * ratio,
      { size, base: 'top', colour: token('--ink-2'), halo: token('--panel') });
    const nothing = this.model.names.every((name) =>
      !this.model.lines[name]?.values.some(isNumber));
    if (nothing) {
      write(context, 'no data in this range', bbox.left + bbox.width / 2,
        bbox.top + bbox.height / 2, { size, align: 'center', colour: token('--ink-3') });
    }
  }

  /** The name of every line, above its highest point near its beginning. */
  paintNames(plot) {
    const { names } = this.model;
    if (names.length < 2) return;
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    const [times] = plot.data;
    names.forEach((name, i) => {
      const values = plot.data[PER_LINE * i + 1];
      const first = values.findIndex((value, k) => isNumber(value) && times[k] >= plot.scales.x.min);
      if (first < 0) return;
      const left = Math.max(bbox.left, plot.valToPos(times[first], 'x', true)) + 8 * ratio;
      context.font = font(size, true);
      const right = left + context.measureText(lineName(name)).width;
      const covered = values.filter((value, k) => isNumber(value) && times[k] >= times[first]
        && plot.valToPos(times[k], 'x', true) <= right);
      const top = plot.valToPos(Math.max(...covered), 'y', true) - 6 * ratio;
      write(context, lineName(name), left, top, {
        size, strong: true, colour: token(lookOf(names, name).colour), halo: token('--panel'),
      });
    });
  }

  /** Limits of the temperatures that are drawn, with their names. */
  paintLimits(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    const { min, max } = plot.scales.y;
    for (const { name, level, value, priority } of this.model.limits ?? []) {
      if (value < min || value > max) continue;
      const y = plot.valToPos(value, 'y', true);
      context.strokeStyle = token('--line-2');
      context.lineWidth = stroke(1.5) * ratio;
      context.setLineDash(priority === 1 ? [] : [9 * ratio, 5 * ratio]);
      context.beginPath();
      context.moveTo(bbox.left, y);
      context.lineTo(bbox.left + bbox.width, y);
      context.stroke();
      context.setLineDash([]);
      write(context, `${lineName(name).toLowerCase()} ${level} ${value} °C`,
        bbox.left + bbox.width - 8 * ratio, y - 3 * ratio,
        { size, align: 'right', colour: token('--ink-3'), halo: token('--panel') });
    }
  }

  /** What was noted: a line at its time, with its number in the list of notes. */
  paintNotes(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    (this.model.notes ?? []).forEach(({ ms }, number) => {
      const x = plot.valToPos(ms / 1000, 'x', true);
      if (x < bbox.left || x > bbox.left + bbox.width) return;
      context.strokeStyle = token('--ink-2');
      context.lineWidth = stroke(1) * ratio;
      context.setLineDash([2 * ratio, 3 * ratio]);
      context.beginPath();
      context.moveTo(x, bbox.top);
      context.lineTo(x, bbox.top + bbox.height);
      context.stroke();
      context.setLineDash([]);
      write(context, String(number + 1), x + 3 * ratio, bbox.top + bbox.height - 3 * ratio,
        { size: fontSize() * ratio, colour: token('--ink-2'), halo: token('--panel') });
    });
  }

  /** Time of the cursor or, without one, of its mark; null where there is neither. */
  at() {
    const { idx: index, left } = this.mounted?.plot.cursor ?? {};
    if (left >= 0 && isNumber(index)) return this.mounted.plot.data[0][index] * 1000;
    return this.reading?.mark?.ms ?? null;
  }

  /** Where a channel has no good data: hatched, with its name and the reason. */
  paintGaps(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    const { names, lines } = this.model;
    const hatch = hatching(context, token('--bad-hatch'));
    names.filter((name) => !isTwin(name)).forEach((name, row) => {
      for (const [from, to, why] of lines[name]?.gaps ?? []) {
        const left = Math.max(bbox.left, plot.valToPos(from / 1000, 'x', true));
        const right = Math.min(bbox.left + bbox.width, plot.valToPos(to / 1000, 'x', true));
        const width = Math.max(2 * ratio, right - left);
        for (const fill of [token('--bad-tint'), hatch]) {
          context.fillStyle = fill;
          context.fillRect(left, bbox.top, width, bbox.height);
        }
        context.strokeStyle = token('--bad');
        context.lineWidth = stroke(1) * ratio;
        context.setLineDash([4 * ratio, 4 * ratio]);
        context.strokeRect(left, bbox.top, width, bbox.height);
        context.setLineDash([]);
        const text = `${lineName(name)}: ${why}`;
        context.font = font(size);
        if (context.measureText(text).width + 12 * ratio > width) continue;
        write(context, text, left + 6 * ratio, bbox.top + (2 + 1.4 * (row + 1)) * size,
          { size, colour: token('--bad-text'), halo: token('--panel') });
      }
    });
  }

  readAt(index) {
    const { data } = this.mounted.plot;
    const ms = data[0][index] * 1000;
    const rows = this.model.names.map((name, i) => {
      const [value, low, high] = [1, 2, 3].map((column) => data[PER_LINE * i + column][index]);
      const more = isNumber(low) && high - low > 1e-9
        ? `${fixed(low, this.digits())} … ${fixed(high, this.digits())}` : '';
      return { name: lineName(name), value, unit: this.unit, digits: this.digits(), more };
    });
    return {
      ms, head: [dayTimeSecond(ms), utc(ms)], rows: rows.filter((row) => isNumber(row.value)),
    };
  }

  digits() {
    return this.unit === '°C' ? 2 : 0;
  }
}

const EMPTY = { times: [], values: [], low: [], high: [], gaps: [] };

/** Room below, and above for the title; never a line that fills everything with its noise. */
function roomy(low, high, height) {
  if (!isNumber(low) || !isNumber(high)) return [0, 1];
  const range = Math.max(high - low, 2, Math.abs(high) * 0.02);
  const middle = (low + high) / 2;
  const title = Math.min(0.5, 1.9 * fontSize() / Math.max(1, height));
  return [middle - range * 0.58, middle + range * 0.55 + range * title / (1 - title)];
}

/** As many decimals as the steps of an axis need. */
function decimals(splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  return Math.max(0, Math.min(3, Math.ceil(-Math.log10(step) - 1e-9)));
}

/** Hours and minutes, the day where it changes, seconds where the span is short. */
function spanAxis(show) {
  const at = (second, options) => new Date(second * 1000)
    .toLocaleString([], { hourCycle: 'h23', ...options });
  return {
    stroke: token('--ink-2'), font: font(fontSize()), size: show ? rem() * 2 : 0,
    space: stroke(96), grid: { stroke: token('--grid'), width: stroke(1) }, ticks: { show: false },
    values: (plot, splits) => {
      if (!show) return splits.map(() => '');
      const spanS = plot.scales.x.max - plot.scales.x.min;
      let day = null;
      return splits.map((second) => {
        const today = at(second, { day: 'numeric', month: 'short' });
        const changed = spanS > 12 * 3600 && today !== day;
        day = today;
        const room = plot.valToPos(plot.scales.x.max, 'x') - plot.valToPos(second, 'x');
        if (room < 26) return '';
        if (changed) return today;
        return at(second, spanS < 600
          ? { hour: '2-digit', minute: '2-digit', second: '2-digit' }
          : { hour: '2-digit', minute: '2-digit' });
      });
    },
  };
}
