// A chart of the past: mean lines within their minimum and maximum, holes hatched.
import { rem, token } from '../parts/dom.js';
import { v } from '../parts/panel.js';
import { channelName, dayTimeSecond, fixed, isNumber, utc } from '../parts/format.js';
import { Chart } from './chart.js';
import { channelOf, limitsOfLines, lineUnder, paintLimits, placed, shownLimits } from './line_limits.js';
import { CLEAR, fontSize, lineOf, stroke, timeAxis, timeScale, valueAxis } from './paint.js';
import { EMPTY_LINE, joined } from './measured.js';

const PER_LINE = 3;
const LEAST_DRAG = 6;
// Lines of the same colour differ by their dashes; names stand next to the figures.
const DASHES = [[], [10, 5], [3, 4], [12, 4, 3, 4], [6, 3]];
// The same on every asset, whatever the order of its channels.
const STANDARD_DASHES = { t_inner_ring_c: DASHES[0], t_outer_ring_c: DASHES[1], ambient_c: DASHES[2] };
const isTwin = (name) => name.endsWith('.twin');

/**
 * How a channel is drawn: the twin in its blue, everything measured in ink. Temperatures of an own
 * network take, in the order of their names, the dashes that the standard ones of `all` leave.
 */
export function lookOf(all, name) {
  return { colour: isTwin(name) ? '--twin' : '--ink', dash: dashOf(all.map(channelOf), channelOf(name)) };
}

function dashOf(channels, channel) {
  if (STANDARD_DASHES[channel]) return STANDARD_DASHES[channel];
  const own = [...new Set(channels)].filter((one) => one.endsWith('_c') && !STANDARD_DASHES[one]).sort();
  const left = DASHES.filter((dash) => !channels.some((one) => STANDARD_DASHES[one] === dash));
  const place = own.indexOf(channel);
  return place < 0 ? DASHES[0] : left[place % left.length]; // speed and load have charts of their own
}

export const swatch = (colour, dash) => v('svg', { class: 'swatch', 'aria-hidden': 'true' },
  v('line', { x1: 0, x2: '100%', y1: '50%', y2: '50%', style: { stroke: `var(${colour})` },
    'stroke-width': 2, 'stroke-dasharray': dash.join(' ') || null }));

export const lineName = (name) => (isTwin(name) ? `${channelName(channelOf(name))}, twin`
  : channelName(name));

export class PastChart extends Chart {
  /**
   * given: title, unit, syncKey; onZoom(fromMs, toMs): a range was selected with the mouse; onDrawn():
   * the chart was drawn.
   * @param {any} given
   */
  constructor(box, given) {
    super(box, { isRead: true });
    this.given = given;
  }

  /**
   * model: { all: [names], names, lines: { name: line }, fromMs, toMs, showTime,
   * limits: { channel: { warning, alarm } }, picked: channel, notes: [{ ms, text }] }; `all` are
   * the lines that may be drawn, `names` those that are.
   */
  update(model) {
    this.model = model;
    const { names, lines, showTime } = model;
    this.show(joined(names.map((name) => lines[name] ?? EMPTY_LINE)), [...names, showTime].join());
  }

  pick(channel) {
    if (!this.plot) return;
    this.model.picked = channel;
    this.plot.redraw(false);
  }

  options() {
    const { all, names, showTime } = this.model;
    const series = [{}];
    const bands = [];
    names.forEach((name, i) => {
      const { colour, dash } = lookOf(all, name);
      series.push(lineOf(token(colour), 2, { dash }), lineOf(CLEAR, 0), lineOf(CLEAR, 0));
      bands.push({ series: [PER_LINE * i + 3, PER_LINE * i + 2], fill: token(isTwin(name) ? '--fan95' : '--range') });
    });
    return {
      scales: { x: timeScale(() => this.model.fromMs, () => this.model.toMs),
        y: { range: (_, low, high) => roomy(low, high, this.box.clientHeight) } },
      axes: [timeAxis(showTime, { size: showTime ? rem() * 2 : 0, space: stroke(96),
        values: showTime ? spanTexts : (_, splits) => splits.map(() => '') }), valueAxis({
        values: (_, splits) => splits.map((value) => fixed(value, decimals(splits))),
      })],
      series, bands,
      cursor: { sync: { key: this.given.syncKey }, drag: { x: true, y: false, setScale: false } },
      hooks: {
        setCursor: [(plot) => {
          this.reading.show();
          this.point(plot);
        }],
        setSelect: [(plot) => this.select(plot)],
      },
    };
  }

  get heading() {
    return `${this.given.title}, ${this.given.unit}`;
  }

  area() {
    if (!this.plot) return null;
    const plot = this.plot.over.getBoundingClientRect();
    return { left: plot.left - this.box.getBoundingClientRect().left, width: plot.width };
  }

  select(plot) {
    const { left, width } = plot.select;
    if (width < LEAST_DRAG) return;
    const at = (pixel) => plot.posToVal(pixel, 'x') * 1000;
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    this.given.onZoom(at(left), at(left + width));
  }

  paint(pen) {
    pen.within(() => {
      this.paintGaps(pen);
      this.paintNotes(pen);
      this.paintLimits(pen, this.paintNames(pen));
      this.reading.paintMark(pen);
    });
    this.given.onDrawn?.();
    pen.title(this.heading);
    const { names, lines } = this.model;
    if (!names.some((name) => lines[name]?.values.some(isNumber))) {
      pen.nothing('no data in this range', { base: 'bottom', colour: '--ink-3' });
    }
  }

  paintNames(pen) {
    const { all, names } = this.model;
    if (names.length < 2) return [];
    const { data: [times, ...columns], scales } = pen.plot;
    return names.flatMap((name, i) => {
      const values = columns[PER_LINE * i];
      const first = values.findIndex((value, k) => isNumber(value) && times[k] >= scales.x.min);
      if (first < 0) return [];
      const left = Math.max(pen.left, pen.x(times[first])) + 8 * pen.ratio;
      const right = left + pen.widthOf(lineName(name), pen.size, true);
      const covered = values.filter((value, k) =>
        isNumber(value) && times[k] >= times[first] && pen.x(times[k]) <= right);
      const top = pen.y(Math.max(...covered)) - 6 * pen.ratio;
      pen.text(lineName(name), left, top, { strong: true, colour: lookOf(all, name).colour });
      return [[left, top - 1.2 * pen.size, right, top]];
    });
  }

  /** The limits of one line: of that under the pointer, else of the one picked in the table. */
  limits() {
    const { limits, names, lines, picked } = this.model;
    return shownLimits(limitsOfLines(limits, names, lines), this.pointed ?? picked);
  }

  paintLimits(pen, taken) {
    const title = [pen.left, pen.top, pen.left + 16 * pen.ratio + pen.widthOf(this.heading), pen.top + 1.4 * pen.size];
    paintLimits(pen, placed(this.limits(), pen.plot.scales.y), (name) => lookOf(this.model.all, name).dash,
      [title, ...taken]);
  }

  point(plot) {
    const before = this.pointed;
    this.pointed = lineUnder(plot, this.model.names, (i) => PER_LINE * i + 1);
    if (this.pointed !== before) plot.redraw(false);
  }

  paintNotes(pen) {
    (this.model.notes ?? []).forEach(({ ms }, number) => {
      const x = pen.at(ms);
      if (x < pen.left || x > pen.right) return;
      pen.upright(x, { colour: '--ink-2', width: 1, dash: [2, 3] });
      pen.text(String(number + 1), x + 3 * pen.ratio, pen.bottom - 3 * pen.ratio, { colour: '--ink-2' });
    });
  }

  at() {
    const { idx: index, left } = this.plot?.cursor ?? {};
    if (left >= 0 && isNumber(index)) return this.plot.data[0][index] * 1000;
    return this.reading?.mark?.ms ?? null;
  }

  paintGaps(pen) {
    const { names, lines } = this.model;
    names.filter((name) => !isTwin(name)).forEach((name, row) => {
      for (const [from, to, why] of lines[name]?.gaps ?? []) {
        const left = Math.max(pen.left, pen.at(from));
        const width = Math.max(2 * pen.ratio, Math.min(pen.right, pen.at(to)) - left);
        pen.hatch(left, width, 1);
        const text = `${lineName(name)}: ${why}`;
        if (pen.widthOf(text) + 12 * pen.ratio > width) continue;
        pen.text(text, left + 6 * pen.ratio, pen.top + (2 + 1.4 * (row + 1)) * pen.size, { colour: '--bad-text' });
      }
    });
  }

  readAt(index) {
    const { data } = this.plot;
    const { unit } = this.given;
    const ms = data[0][index] * 1000;
    const digits = unit === '°C' ? 2 : 0;
    const rows = this.model.names.map((name, i) => {
      const [value, low, high] = [1, 2, 3].map((column) => data[PER_LINE * i + column][index]);
      const more = isNumber(low) && high - low > 1e-9 ? `${fixed(low, digits)} … ${fixed(high, digits)}` : '';
      return { name: lineName(name), value, unit, digits, more };
    });
    return { ms, head: [dayTimeSecond(ms), utc(ms)], rows: rows.filter((row) => isNumber(row.value)) };
  }
}

/** Room below, and above for the title; never a line that fills everything with its noise. */
function roomy(low, high, height) {
  if (!isNumber(low) || !isNumber(high)) return [0, 1];
  const range = Math.max(high - low, 2, Math.abs(high) * 0.02);
  const middle = (low + high) / 2;
  const title = Math.min(0.5, 1.9 * fontSize() / Math.max(1, height));
  return [middle - range * 0.58, middle + range * 0.55 + range * title / (1 - title)];
}

function decimals(splits) {
  const step = splits.length > 1 ? Math.abs(splits[1] - splits[0]) : 1;
  return Math.max(0, Math.min(3, Math.ceil(-Math.log10(step) - 1e-9)));
}

/** Hours and minutes, the day where it changes, seconds where the span is short. */
function spanTexts(plot, splits) {
  const { max, min } = plot.scales.x;
  const at = (second, options) => new Date(second * 1000).toLocaleString([], { hourCycle: 'h23', ...options });
  let day = null;
  return splits.map((second) => {
    const today = at(second, { day: 'numeric', month: 'short' });
    const isChanged = max - min > 12 * 3600 && today !== day;
    day = today;
    if (plot.valToPos(max, 'x') - plot.valToPos(second, 'x') < 26) return '';
    return isChanged ? today : at(second, { hour: '2-digit', minute: '2-digit',
      ...(max - min < 600 && { second: '2-digit' }) });
  });
}
