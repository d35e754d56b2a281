// The chart of the temperatures: measured, estimated and forecast, with their limits.
import { ChartCursor } from './chart_cursor.js';
import { h, token, rem } from './dom.js';
import { QUANTILES } from './forecast.js';
import {
  channelName, fixed, hourMinute, hourMinuteSecond, isNumber, utc,
} from './format.js';
import {
  cursor, font, fontSize, hatching, mount, paintAhead, paintNow, paintPredicted, pixelRatio,
  roomAround, stroke, timeAxis, valueAxis, write,
} from './paint.js';

const CLEAR = 'rgba(0,0,0,0)';
const NARROW = 620;
const SERIES_PER_SENSOR = QUANTILES.length + 3;

const nulls = (count) => Array(count).fill(null);
const highest = (values) => values.reduce((top, v) => (isNumber(v) && v > top ? v : top), -Infinity);
const lowest = (values) => values.reduce((low, v) => (isNumber(v) && v < low ? v : low), Infinity);

/**
 * Temperatures: measured (ink), twin (ribbon), forecast (fan), limits.
 *
 * A model is { nowMs, fromMs, endMs, times (ms), past: { sensor: { measured, twin } },
 * sensors: [names], current: { sensor: { value, usable, timeMs } }, limits, fan, ghost, lostMs,
 * crossings: [{ timeMs, value, priority }], lanes: [{ name, unit, values, key }], steps }; what
 * the lanes below show is read at this chart's cursor.
 */
export class TrendChart {
  /** options: { small }: as on a card, without figures and names but with the hours. */
  constructor(box, syncKey, { small = false } = {}) {
    this.box = box;
    this.syncKey = syncKey;
    this.small = small;
    this.mounted = null;
  }

  update(model) {
    this.model = { ...model, limitLines: limitLines(model) };
    const data = this.columns();
    if (!this.mounted) this.create(data);
    else this.mounted.plot.setData(data);
  }

  destroy() {
    this.mounted?.destroy();
    this.reading?.destroy();
  }

  columns() {
    const { model } = this;
    const ahead = model.fan?.times ?? [model.nowMs];
    const past = (values, now) => [...values, now, ...nulls(ahead.length - 1)];
    const future = (values) => [...nulls(model.times.length), ...(values ?? nulls(ahead.length))];
    const ghost = (sensor) => {
      if (!model.ghost) return null;
      const along = new Map(model.ghost.times.map((time, i) => [time, i]));
      const values = model.ghost.bands[sensor]?.q50 ?? [];
      return ahead.map((time) => values[along.get(time)] ?? interpolate(model.ghost, values, time));
    };
    const data = [[...model.times, ...ahead].map((time) => time / 1000)];
    for (const sensor of model.sensors) {
      const band = model.fan?.bands[sensor];
      for (const quantile of QUANTILES) data.push(future(band?.[quantile]));
      const { measured, twin } = model.past[sensor];
      const now = model.current[sensor];
      data.push(future(ghost(sensor)));
      data.push(past(twin, null));
      data.push(past(measured, now.usable ? now.value : null));
    }
    return data;
  }

  create(data) {
    const ink = token('--ink');
    const blue = token('--twin');
    const line = (colour, width, dash) =>
      ({ stroke: colour, width: stroke(width), dash, points: { show: false }, spanGaps: false });
    const series = [{}];
    const bands = [];
    this.model.sensors.forEach((_, i) => {
      const first = 1 + i * SERIES_PER_SENSOR;
      series.push(line(CLEAR, 1), line(CLEAR, 1), line(blue, 2.5), line(CLEAR, 1),
        line(blue, 0.75), line(token('--ink-3'), 1.5, [3, 5]), line(token('--twin-past'), 8),
        line(ink, 2.25));
      bands.push({ series: [first + 4, first], fill: token('--fan95') });
      bands.push({ series: [first + 3, first + 1], fill: token('--fan50') });
    });
    if (!this.small) this.reading = new ChartCursor(this.box, (index) => this.readAt(index));
    this.mounted = mount(this.box, {
      scales: {
        x: { time: true, range: () => [this.model.fromMs / 1000, this.model.endMs / 1000] },
        y: { range: () => this.range() },
      },
      axes: [timeAxis(this.small),
        valueAxis({ least: this.small ? 34 : 46, values: (_, splits) => splits.map(String) })],
      series, bands, padding: roomAround(),
      cursor: this.small ? { show: false } : cursor(this.syncKey),
      hooks: {
        drawClear: [(plot) => paintAhead(plot, this.model.nowMs / 1000)],
        draw: [(plot) => this.paint(plot)],
        setCursor: [() => this.reading?.show()],
      },
    }, data);
    this.reading?.attach(this.mounted.plot);
  }

  /** The axis holds still and grows only, in steps, when the fan or a value needs it. */
  range() {
    const { model } = this;
    const alarms = Object.values(model.limits).map((limits) => limits.alarm);
    const seen = model.sensors.flatMap((sensor) => [
      highest(model.fan?.bands[sensor]?.q975 ?? []), highest(model.past[sensor].measured),
      model.current[sensor].value ?? -Infinity,
    ]);
    const low = Math.min(...model.sensors.map((sensor) => lowest(model.past[sensor].measured)));
    const calm = Math.max(...alarms, 60) + (this.small ? 16 : 7);
    const needed = Math.min(Math.max(...seen) + 3, calm + 40);
    const top = Math.max(calm, Math.ceil(needed / 5) * 5);
    return [low < 27 ? Math.floor((low - 12) / 10) * 10 : 20, top];
  }

  paint(plot) {
    const { ctx: context, bbox } = plot;
    context.save();
    context.beginPath();
    context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    context.clip();
    this.paintBeyondLimits(plot);
    this.paintMedians(plot);
    this.paintLimits(plot);
    this.paintLost(plot);
    paintNow(plot, this.model.nowMs / 1000);
    this.placeFlag(plot);
    this.paintFigures(plot);
    this.paintCrossings(plot);
    this.reading?.paintMark(plot);
    context.restore();
  }

  /** The flag with the time of now stands on the line; what it says comes from `showClock`. */
  placeFlag(plot) {
    if (this.small) return;
    const { over } = plot;
    if (!this.flag) this.flag = h('span', { class: 'nowflag', 'aria-hidden': 'true' });
    if (this.flag.parentNode !== over) over.append(this.flag);
    if (!this.flag.textContent) this.showClock(this.model.nowMs);
    const x = plot.valToPos(this.model.nowMs / 1000, 'x');
    this.flag.style.left = `${x}px`;
    this.flag.classList.toggle('aside', over.clientWidth < NARROW);
  }

  /** The time on the flag, as often as the header's clock shows another one. */
  showClock(nowMs) {
    const text = hourMinute(nowMs);
    if (this.flag && this.flag.textContent !== text) this.flag.textContent = text;
  }

  /** The part of the fan beyond a limit takes the limit's colour. */
  paintBeyondLimits(plot) {
    const { ctx: context } = plot;
    const { fan } = this.model;
    if (!fan) return;
    const x = (ms) => plot.valToPos(ms / 1000, 'x', true);
    const y = (value) => plot.valToPos(value, 'y', true);
    for (const { sensor, value, priority, hit } of this.model.limitLines) {
      const band = fan.bands[sensor];
      if (!hit || !band) continue;
      context.beginPath();
      fan.times.forEach((time, i) => context.lineTo(x(time), y(Math.max(value, band.q975[i]))));
      for (let i = fan.times.length - 1; i >= 0; i -= 1) {
        const low = Math.min(band.q025[i], band.q975[i]);
        context.lineTo(x(fan.times[i]), y(Math.max(value, low)));
      }
      context.closePath();
      context.fillStyle = token(`--p${priority}`);
      context.globalAlpha = priority === 1 ? 0.5 : 0.32;
      context.fill();
      context.globalAlpha = 1;
    }
  }

  paintMedians(plot) {
    const { ctx: context } = plot;
    const { fan, sensors } = this.model;
    if (!fan) return;
    context.strokeStyle = token('--twin');
    context.lineWidth = stroke(2.5) * pixelRatio();
    context.lineJoin = 'round';
    for (const sensor of sensors.filter((name) => fan.bands[name])) {
      context.beginPath();
      fan.times.forEach((time, i) => context.lineTo(plot.valToPos(time / 1000, 'x', true),
        plot.valToPos(fan.bands[sensor].q50[i], 'y', true)));
      context.stroke();
    }
  }

  paintLimits(plot) {
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    for (const { sensor, level, value, priority, hit, main } of this.model.limitLines) {
      if (!main && !hit) continue;
      const y = plot.valToPos(value, 'y', true);
      context.strokeStyle = token(hit ? `--p${priority}-line` : '--line-2');
      context.lineWidth = stroke(hit ? 2 : 1.5) * ratio;
      context.setLineDash(priority === 1 ? [] : [9 * ratio, 5 * ratio]);
      context.beginPath();
      context.moveTo(bbox.left, y);
      context.lineTo(bbox.left + bbox.width, y);
      context.stroke();
      context.setLineDash([]);
      const whose = main ? '' : `${channelName(sensor).toLowerCase()} `;
      // On a phone there is no room beside the line of now: the line's look says which limit it is.
      const named = this.box.clientWidth > NARROW || this.small ? `${whose}${level} ` : whose;
      write(context, `${named}${value} °C`, bbox.left + 8 * ratio, y - 3 * ratio, {
        size: fontSize() * ratio, strong: hit, halo: token('--panel'),
        colour: token(hit ? `--p${priority}-text` : '--ink-3'),
      });
    }
  }

  /** From the last usable sample to now there is nothing to see: hatched. */
  paintLost(plot) {
    const { lostMs, nowMs } = this.model;
    if (lostMs === null) return;
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const left = Math.max(bbox.left, plot.valToPos(lostMs / 1000, 'x', true));
    const area = [left, bbox.top, plot.valToPos(nowMs / 1000, 'x', true) - left, bbox.height];
    for (const paint of [token('--bad-tint'), hatching(context, token('--bad-hatch'))]) {
      context.fillStyle = paint;
      context.fillRect(...area);
    }
    context.strokeStyle = token('--bad');
    context.lineWidth = stroke(2) * ratio;
    context.setLineDash([4 * ratio, 4 * ratio]);
    context.strokeRect(...area);
    context.setLineDash([]);
    if (this.small) return;
    const size = fontSize() * ratio;
    write(context, 'no data', left - 6 * ratio, bbox.top + 3.6 * size,
      { size, strong: true, colour: token('--bad-text'), align: 'right', halo: token('--panel') });
  }

  /** A dot and a figure at the head of every measured line, its name where the line begins. */
  paintFigures(plot) {
    const { ctx: context } = plot;
    const { model } = this;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    const wide = this.box.clientWidth > NARROW;
    const y = (value) => plot.valToPos(value, 'y', true);
    const heads = model.sensors.map((sensor) => ({ sensor, ...model.current[sensor] }))
      .filter((head) => isNumber(head.value)).sort((a, b) => b.value - a.value);
    heads.forEach((head, i) => {
      const x = plot.valToPos((head.usable ? model.nowMs : head.timeMs) / 1000, 'x', true);
      context.fillStyle = token(head.usable ? '--ink' : '--panel');
      context.strokeStyle = token(head.usable ? '--panel' : '--bad');
      context.lineWidth = stroke(2) * ratio;
      context.beginPath();
      context.arc(x, y(head.value), stroke(5.5) * ratio, 0, 7);
      context.fill();
      context.stroke();
      const under = i > 0 && y(head.value) - y(heads[i - 1].value) < size * 2.2;
      if (this.small) return;
      this.paintName(plot, head.sensor, heads[i - 1]?.sensor);
      if (!wide) return;
      const right = x - 12 * ratio;
      const covered = this.measuredBetween(plot, head.sensor, right - size * 4, right);
      const at = under ? y(Math.min(head.value, lowest(covered))) + size * 2.2
        : y(Math.max(head.value, highest(covered))) - 9 * ratio;
      write(context, fixed(head.value), right, at, {
        size: size * 1.75, strong: true, align: 'right', halo: token('--panel'),
        colour: token(head.usable ? '--ink' : '--bad-text'),
      });
    });
  }

  /** Measured values between two places on the canvas, which a text there must not cover. */
  measuredBetween(plot, sensor, left, right) {
    const { times, past } = this.model;
    return past[sensor].measured.filter((_, i) => {
      const x = plot.valToPos(times[i] / 1000, 'x', true);
      return x >= left && x <= right;
    });
  }

  /**
   * The name of a line where it begins. `above` is the sensor of the line above, which the name
   * must not cover; where a limit has its own label, the name moves along.
   */
  paintName(plot, sensor, above, shift = 0) {
    const { times, past } = this.model;
    const { ctx: context, bbox } = plot;
    const ratio = pixelRatio();
    const size = fontSize() * ratio;
    const values = past[sensor].measured;
    const first = values.findIndex(isNumber);
    if (first < 0) return;
    const start = Math.max(bbox.left, plot.valToPos(times[first] / 1000, 'x', true));
    const left = start + 8 * ratio + shift;
    context.font = font(size * 1.15, true);
    const right = left + context.measureText(channelName(sensor)).width;
    const room = plot.valToPos(this.model.nowMs / 1000, 'x', true) - 70 * ratio;
    if (right > room) return;
    const covered = this.measuredBetween(plot, sensor, left - 8 * ratio, right);
    const gap = 9 * ratio;
    const over = plot.valToPos(highest(covered), 'y', true) - gap;
    const line = above ? lowest(this.measuredBetween(plot, above, left, right)) : Infinity;
    const hits = Number.isFinite(line) && over - size * 1.5 < plot.valToPos(line, 'y', true) + gap;
    const at = hits ? plot.valToPos(lowest(covered), 'y', true) + gap + size * 1.3 : over;
    const labelled = left < bbox.left + size * 9 && this.model.limitLines.some((limit) => {
      const y = plot.valToPos(limit.value, 'y', true);
      return (limit.main || limit.hit) && at > y - size * 1.6 && at - size * 1.3 < y;
    });
    if (labelled && !shift) {
      this.paintName(plot, sensor, above, size * 9.5);
      return;
    }
    write(context, channelName(sensor), left, at,
      { size: size * 1.15, strong: true, colour: token('--ink'), halo: token('--panel') });
  }

  /** Where a limit is most likely to be crossed first: the predicted symbol with its time. */
  paintCrossings(plot) {
    const { nowMs, crossings } = this.model;
    const { ctx: context } = plot;
    const ratio = pixelRatio();
    for (const { timeMs, value, priority } of crossings) {
      const x = plot.valToPos(timeMs / 1000, 'x', true);
      const y = plot.valToPos(value, 'y', true);
      paintPredicted(context, x, y, 20 * ratio * rem() / 16, priority);
      const far = plot.valToPos(timeMs / 1000, 'x') - plot.valToPos(nowMs / 1000, 'x') > 90;
      const left = this.box.clientWidth > NARROW && far;
      write(context, hourMinute(timeMs), x + (left ? -17 : 17) * ratio, y - 8 * ratio, {
        size: fontSize() * ratio * 1.15, strong: true, colour: token(`--p${priority}-text`),
        align: left ? 'right' : 'left', ground: token('--panel'),
      });
    }
  }

  /** What stands at a place of the axis of time: temperatures, then speed and load. */
  readAt(index) {
    const { times, sensors, past, fan, lanes = [], steps = [] } = this.model;
    const ms = this.mounted.plot.data[0][index] * 1000;
    const ahead = index - times.length;
    const rows = sensors.flatMap((sensor) => {
      const row = { name: channelName(sensor), unit: '°C', digits: 1 };
      const band = ahead > 0 && fan?.bands[sensor];
      if (band) {
        const range = `${fan.stated ?? '95 %'} ${fixed(band.q025[ahead])} … ${fixed(band.q975[ahead])}`;
        return { ...row, value: band.q50[ahead], more: range };
      }
      const { measured, twin } = past[sensor];
      return { ...row, value: measured[index], more: `twin ${fixed(twin[index])}` };
    });
    const planned = ahead > 0 && steps.find((step) => ms >= step.from && ms <= step.to);
    rows.push(...lanes.map(({ name, unit, values, key }) => ({
      name, unit, digits: 0, value: planned ? planned[key] : values[index],
      more: planned ? 'planned' : '',
    })));
    return {
      ms, head: [hourMinuteSecond(ms), utc(ms)], rows: rows.filter((row) => isNumber(row.value)),
    };
  }
}

function interpolate(fan, values, time) {
  const next = fan.times.findIndex((known) => known > time);
  if (next < 1) return null;
  const share = (time - fan.times[next - 1]) / (fan.times[next] - fan.times[next - 1]);
  return values[next - 1] + share * (values[next] - values[next - 1]);
}

/** All limit lines; those of the first sensor are always drawn, the others once they are hit. */
function limitLines(model) {
  const lines = [];
  Object.entries(model.limits).forEach(([sensor, limits], i) => {
    if (!model.sensors.includes(sensor)) return;
    const reach = Math.max(highest(model.fan?.bands[sensor]?.q975 ?? []),
      model.current[sensor].usable ? model.current[sensor].value : -Infinity);
    for (const [level, priority] of [['warning', 2], ['alarm', 1]]) {
      const value = limits[level];
      lines.push({ sensor, level, value, priority, hit: reach > value, main: i === 0 });
    }
  });
  return lines;
}
