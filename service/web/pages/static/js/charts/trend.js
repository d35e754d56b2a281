// The chart of the temperatures: measured, estimated and forecast, with their limits.
import { h, rem, token } from '../parts/dom.js';
import { QUANTILES } from '../forecast/forecast.js';
import {
  channelName, fixed, highestOf, hourMinute, hourMinuteSecond, isNumber, lowerName, lowestOf, utc,
} from '../parts/format.js';
import { Chart, Pen } from './chart.js';
import { CLEAR, lineOf, paintPredicted, stroke, timeAxis, timeScale, valueAxis } from './paint.js';

const NARROW = 620;
const SERIES_PER_SENSOR = QUANTILES.length + 3;
const nulls = (count) => Array(count).fill(null);

/**
 * Temperatures: measured (ink), twin (ribbon), forecast (fan), limits.
 *
 * A model is { nowMs, fromMs, endMs, times (ms), past: { sensor: { measured, twin } },
 * sensors: [names], current: { sensor: { value, usable, timeMs } }, limits, fan, ghost, lostMs,
 * crossings: [{ timeMs, value, priority }], lanes: [{ name, unit, values, key }], steps }; lanes are
 * read at this chart's cursor.
 */
export class TrendChart extends Chart {
  /** options: { small }: as on a card, without figures and names but with the hours. */
  constructor(box, syncKey, { small = false } = {}) {
    super(box, { isRead: !small });
    this.syncKey = syncKey;
    this.small = small;
  }

  update(model) {
    this.model = { ...model, limitLines: limitLines(model) };
    this.show(this.columns());
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

  options() {
    const [ink, blue] = [token('--ink'), token('--twin')];
    const series = [{}];
    const bands = [];
    this.model.sensors.forEach((_, i) => {
      const first = 1 + i * SERIES_PER_SENSOR;
      series.push(lineOf(CLEAR, 1), lineOf(CLEAR, 1), lineOf(blue, 2.5), lineOf(CLEAR, 1), lineOf(blue, 0.75),
        lineOf(token('--ink-3'), 1.5, { dash: [3, 5] }), lineOf(token('--twin-past'), 8), lineOf(ink, 2.25));
      bands.push({ series: [first + 4, first], fill: token('--fan95') },
        { series: [first + 3, first + 1], fill: token('--fan50') });
    });
    return {
      scales: { x: timeScale(() => this.model.fromMs, () => this.model.endMs), y: { range: () => this.range() } },
      axes: [timeAxis(this.small),
        valueAxis({ least: this.small ? 34 : 46, values: (_, splits) => splits.map(String) })],
      series, bands, cursor: this.small ? null : { sync: { key: this.syncKey } },
      hooks: { drawClear: [(plot) => new Pen(plot).ahead(this.model.nowMs)] },
    };
  }

  /** The axis holds still and grows only, in steps, when the fan or a value needs it. */
  range() {
    const { model } = this;
    const alarms = Object.values(model.limits).map((limits) => limits.alarm);
    const seen = model.sensors.flatMap((sensor) => [
      highestOf(model.fan?.bands[sensor]?.q975 ?? []), highestOf(model.past[sensor].measured),
      model.current[sensor].value ?? -Infinity,
    ]);
    const low = Math.min(...model.sensors.map((sensor) => lowestOf(model.past[sensor].measured)));
    const calm = Math.max(...alarms, 60) + (this.small ? 16 : 7);
    const needed = Math.min(Math.max(...seen) + 3, calm + 40);
    const top = Math.max(calm, Math.ceil(needed / 5) * 5);
    return [low < 27 ? Math.floor((low - 12) / 10) * 10 : 20, top];
  }

  paint(pen) {
    pen.within(() => {
      this.paintBeyondLimits(pen);
      this.paintHoles(pen);
      this.paintMedians(pen);
      this.paintLimits(pen);
      this.paintLost(pen);
      pen.now(this.model.nowMs);
      this.placeFlag(pen.plot);
      this.paintFigures(pen);
      this.paintCrossings(pen);
      this.reading?.paintMark(pen);
    });
  }

  /** The flag with the time of now stands on the line; what it says comes from `showClock`. */
  placeFlag(plot) {
    if (this.small) return;
    const { over } = plot;
    if (!this.flag) this.flag = h('span', { class: 'nowflag', 'aria-hidden': 'true' });
    if (this.flag.parentNode !== over) over.append(this.flag);
    if (!this.flag.textContent) this.showClock(this.model.nowMs);
    this.flag.style.left = `${plot.valToPos(this.model.nowMs / 1000, 'x')}px`;
    this.flag.classList.toggle('aside', over.clientWidth < NARROW);
  }

  /** The time on the flag, as often as the header's clock shows another one. */
  showClock(nowMs) {
    const text = hourMinute(nowMs);
    if (this.flag && this.flag.textContent !== text) this.flag.textContent = text;
  }

  paintBeyondLimits(pen) {
    const { context } = pen;
    const { fan, limitLines: lines } = this.model;
    for (const { sensor, value, priority, hit } of lines) {
      const band = fan?.bands[sensor];
      if (!hit || !band) continue;
      const edge = (values) => fan.times.map((time, i) => [pen.at(time), pen.y(Math.max(value, values[i]))]);
      const low = band.q025.map((one, i) => Math.min(one, band.q975[i]));
      context.beginPath();
      [...edge(band.q975), ...edge(low).reverse()].forEach((point) => context.lineTo(...point));
      context.closePath();
      context.fillStyle = token(`--p${priority}`);
      context.globalAlpha = priority === 1 ? 0.5 : 0.32;
      context.fill();
      context.globalAlpha = 1;
    }
  }

  paintMedians(pen) {
    const { fan, sensors } = this.model;
    pen.context.lineJoin = 'round';
    for (const band of sensors.map((name) => fan?.bands[name]).filter(Boolean)) {
      pen.line({ colour: '--twin', width: 2.5 }, fan.times.map((time, i) => [pen.at(time), pen.y(band.q50[i])]));
    }
  }

  paintLimits(pen) {
    for (const { sensor, level, value, priority, hit, main } of this.model.limitLines) {
      if (!main && !hit) continue;
      const y = pen.y(value);
      pen.across(y, { colour: hit ? `--p${priority}-line` : '--line-2', width: hit ? 2 : 1.5,
        dash: priority === 1 ? [] : [9, 5] });
      const whose = main ? '' : `${lowerName(sensor)} `;
      // On a phone there is no room next to the line of now: the line's look says which limit it is.
      const named = this.box.clientWidth > NARROW || this.small ? `${whose}${level} ` : whose;
      pen.text(`${named}${value} °C`, pen.left + 8 * pen.ratio, y - 3 * pen.ratio,
        { strong: hit, colour: hit ? `--p${priority}-text` : '--ink-3' });
    }
  }

  paintHoles(pen) {
    for (const [from, to] of this.holes()) {
      const left = Math.max(pen.left, pen.at(from));
      const width = pen.at(to) - left;
      pen.hatch(left, width);
      if (this.small || pen.widthOf('no data') + 12 * pen.ratio > width) continue;
      pen.text('no data', left + 6 * pen.ratio, pen.top + 1.6 * pen.size, { colour: '--bad-text' });
    }
  }

  /** Spans of two minutes or more without a value of one of the temperatures, as [fromMs, toMs]. */
  holes() {
    const { times, sensors, past } = this.model;
    const spans = new Map();
    for (const sensor of sensors) {
      let last = -1;
      past[sensor].measured.forEach((value, i) => {
        if (value === null) return; // undefined is no hole: it is bridged
        if (last >= 0 && i - last > 2) spans.set(`${last} ${i}`, [times[last], times[i]]);
        last = i;
      });
    }
    return [...spans.values()];
  }

  paintLost(pen) {
    const { lostMs, nowMs } = this.model;
    if (lostMs === null) return;
    const left = Math.max(pen.left, pen.at(lostMs));
    pen.hatch(left, pen.at(nowMs) - left, 2);
    if (!this.small) pen.text('no data', left - 6 * pen.ratio, pen.top + 3.6 * pen.size,
      { strong: true, colour: '--bad-text', align: 'right' });
  }

  paintFigures(pen) {
    const { context, ratio, size } = pen;
    const { sensors, current, nowMs } = this.model;
    const heads = sensors.map((sensor) => ({ sensor, ...current[sensor] }))
      .filter((head) => isNumber(head.value)).sort((a, b) => b.value - a.value);
    heads.forEach(({ sensor, value, usable, timeMs }, i) => {
      const x = pen.at(usable ? nowMs : timeMs);
      context.fillStyle = token(usable ? '--ink' : '--panel');
      context.strokeStyle = token(usable ? '--panel' : '--bad');
      context.lineWidth = stroke(2) * ratio;
      context.beginPath();
      context.arc(x, pen.y(value), stroke(5.5) * ratio, 0, 7);
      context.fill();
      context.stroke();
      if (this.small) return;
      this.paintName(pen, sensor, heads[i - 1]?.sensor);
      if (this.box.clientWidth <= NARROW) return;
      const under = i > 0 && pen.y(value) - pen.y(heads[i - 1].value) < size * 2.2;
      const right = x - 12 * ratio;
      const covered = this.measuredBetween(pen, sensor, right - size * 4, right);
      const at = under ? pen.y(Math.min(value, lowestOf(covered))) + size * 2.2
        : pen.y(Math.max(value, highestOf(covered))) - 9 * ratio;
      pen.text(fixed(value), right, at,
        { size: size * 1.75, strong: true, align: 'right', colour: usable ? '--ink' : '--bad-text' });
    });
  }

  /** Measured values between two places on the canvas, which a text there must not cover. */
  measuredBetween(pen, sensor, left, right) {
    const { times, past } = this.model;
    return past[sensor].measured.filter((_, i) => pen.at(times[i]) >= left && pen.at(times[i]) <= right);
  }

  /**
   * The name of a line where it begins. `above` is the sensor of the line above, which the name
   * must not cover; where a limit has its own label, the name moves along.
   */
  paintName(pen, sensor, above, shift = 0) {
    const { times, past, nowMs, limitLines: limits } = this.model;
    const { ratio, size } = pen;
    const first = past[sensor].measured.findIndex(isNumber);
    if (first < 0) return;
    const left = Math.max(pen.left, pen.at(times[first])) + 8 * ratio + shift;
    const right = left + pen.widthOf(channelName(sensor), size * 1.15, true);
    if (right > pen.at(nowMs) - 70 * ratio) return;
    const covered = this.measuredBetween(pen, sensor, left - 8 * ratio, right);
    const gap = 9 * ratio;
    const over = pen.y(highestOf(covered)) - gap;
    const line = above ? lowestOf(this.measuredBetween(pen, above, left, right)) : Infinity;
    const hits = Number.isFinite(line) && over - size * 1.5 < pen.y(line) + gap;
    const at = hits ? pen.y(lowestOf(covered)) + gap + size * 1.3 : over;
    const isLabelled = left < pen.left + size * 9 && limits.some(({ value, main, hit }) =>
      (main || hit) && at > pen.y(value) - size * 1.6 && at - size * 1.3 < pen.y(value));
    if (isLabelled && !shift) this.paintName(pen, sensor, above, size * 9.5);
    else pen.text(channelName(sensor), left, at, { size: size * 1.15, strong: true, colour: '--ink' });
  }

  paintCrossings(pen) {
    const { nowMs, crossings } = this.model;
    for (const { timeMs, value, priority } of crossings) {
      const [x, y] = [pen.at(timeMs), pen.y(value)];
      paintPredicted(pen.context, x, y, 20 * pen.ratio * rem() / 16, priority);
      const left = this.box.clientWidth > NARROW && x - pen.at(nowMs) > 90 * pen.ratio;
      pen.text(hourMinute(timeMs), x + (left ? -17 : 17) * pen.ratio, y - 8 * pen.ratio, {
        size: pen.size * 1.15, strong: true, colour: `--p${priority}-text`, align: left ? 'right' : 'left',
        ground: '--panel', halo: '',
      });
    }
  }

  readAt(index) {
    const { times, sensors, past, fan, lanes = [], steps = [] } = this.model;
    const ms = this.plot.data[0][index] * 1000;
    const ahead = index - times.length;
    const rows = sensors.flatMap((sensor) => {
      const row = { name: channelName(sensor), unit: '°C', digits: 1 };
      const band = ahead > 0 && fan?.bands[sensor];
      const { measured, twin } = past[sensor];
      return band ? { ...row, value: band.q50[ahead],
        more: `${fan.stated ?? '95 %'} ${fixed(band.q025[ahead])} … ${fixed(band.q975[ahead])}` }
        : { ...row, value: measured[index], more: `twin ${fixed(twin[index])}` };
    });
    const planned = ahead > 0 && steps.find((step) => ms >= step.from && ms <= step.to);
    rows.push(...lanes.map(({ name, unit, values, key }) => ({ name, unit, digits: 0,
      value: planned ? planned[key] : values[index], more: planned ? 'planned' : '' })));
    return { ms, head: [hourMinuteSecond(ms), utc(ms)], rows: rows.filter((row) => isNumber(row.value)) };
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
    const reach = Math.max(highestOf(model.fan?.bands[sensor]?.q975 ?? []),
      model.current[sensor].usable ? model.current[sensor].value : -Infinity);
    for (const [level, priority] of [['warning', 2], ['alarm', 1]]) {
      const value = limits[level];
      lines.push({ sensor, level, value, priority, hit: reach > value, main: i === 0 });
    }
  });
  return lines;
}
