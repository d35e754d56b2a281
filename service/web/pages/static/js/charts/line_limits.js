// Limits in the charts of the past. A limit belongs to a line: it has the line's dash and stands at its end.
import { highestOf, isNumber, lowerName } from '../parts/format.js';
import { stroke } from './paint.js';

const LEVELS = [['warning', 2], ['alarm', 1]];
const BAR = 60;
const NEAR = 24; // pixels between the pointer and the line that it is on

/** The channel of a line: the limits of a ring hold for the twin's estimate of it, too. */
export const channelOf = (name) => name.replace(/\.twin$/, '');

/**
 * The limits of the lines that are drawn, as [{ name, channel, level, priority, value, headroom,
 * endMs, over }]. `limits` are { channel: { warning, alarm } }. `headroom` is from the line's
 * highest value to the limit, `endMs` where the line ends, `over` lists [fromMs, toMs] above the limit.
 */
export function limitsOfLines(limits, names, lines) {
  const channels = [...new Set(names.map(channelOf))].filter((channel) => limits?.[channel]);
  return channels.flatMap((channel) => {
    const name = names.includes(channel) ? channel : `${channel}.twin`;
    const line = lines[name];
    const last = line?.values.findLastIndex(isNumber) ?? -1;
    const highest = last < 0 ? -Infinity : highestOf(line.high);
    return LEVELS.map(([level, priority]) => ({
      name, channel, level, priority, value: limits[channel][level],
      headroom: limits[channel][level] - highest,
      endMs: last < 0 ? null : line.times[last],
      over: last < 0 ? [] : spansOver(line, limits[channel][level]),
    }));
  });
}

function spansOver({ times, high }, limit) {
  const spans = [];
  let open = false;
  times.forEach((time, i) => {
    const isOver = isNumber(high[i]) && high[i] > limit;
    if (isOver && !open) spans.push([time, time]);
    if (isOver) spans.at(-1)[1] = time;
    open = isOver;
  });
  return spans;
}

/**
 * Those that are drawn: of one line, and what is exceeded of the others. The line is the chosen
 * one or, without a choice, the one that came closest to a limit.
 */
export function shownLimits(all, chosen) {
  const closest = all.toSorted((a, b) => a.headroom - b.headroom)[0]?.channel;
  const channel = all.some((one) => one.channel === chosen) ? chosen : closest;
  return all.filter((one) => one.channel === channel || one.over.length);
}

/** Limits with their text and their place: within the axis, or beyond its upper or lower edge. */
export const placed = (limits, { min, max }) => limits.map((one) => {
  const place = one.value > max ? 'above' : one.value < min ? 'below' : 'inside';
  const arrow = { above: ' ↑', below: ' ↓', inside: '' }[place];
  return { ...one, place, text: `${lowerName(one.channel)} ${one.level} ${one.value} °C${arrow}` };
});

export function lineUnder(plot, names, column) {
  const { idx: index, top } = plot.cursor;
  if (!plot.over.matches(':hover') || !isNumber(index)) return null;
  const distances = names.map((name, i) => {
    const value = plot.data[column(i)][index];
    return [isNumber(value) ? Math.abs(plot.valToPos(value, 'y') - top) : Infinity, name];
  });
  const [distance, name] = distances.sort((a, b) => a[0] - b[0])[0] ?? [Infinity];
  return distance <= NEAR ? channelOf(name) : null;
}

/** Draw what `placed` gives; `taken` are places of other texts, as [left, top, right, bottom]. */
export function paintLimits(pen, limits, dashOf, taken) {
  const { ratio, size } = pen;
  for (const { name, priority, value, endMs, over, place, text } of limits) {
    const isOver = over.length > 0;
    const y = pen.y(value);
    const end = Math.min(pen.right, endMs === null ? pen.right : Math.max(pen.at(endMs), pen.left + BAR * ratio));
    const begin = end - stroke(BAR) * ratio;
    const bar = (from, to, dash, width) => pen.line({ colour: isOver ? `--p${priority}-line` : '--ink-2', width, dash },
      [[from, y], [to, y]]);
    if (place === 'inside') {
      over.forEach(([from, to]) => bar(pen.at(from), Math.max(pen.at(to), pen.at(from) + 2 * ratio), [], 2));
      bar(begin, end, dashOf(name), 2.5);
    }
    const width = pen.widthOf(text, size, isOver);
    const gap = 8 * ratio;
    const at = place === 'inside' ? begin - gap : end - gap;
    const left = at - width < pen.left ? Math.min(end + gap, pen.right - width - gap) : at - width;
    const top = { above: pen.top + 3 * ratio, below: pen.bottom - 1.4 * size, inside: y - 0.6 * size }[place];
    // At an edge there is more room to the left than towards the lines.
    const lefts = place === 'inside' ? [left] : [left, left - width - 2 * gap];
    const spots = [0, 1, 2, 3].flatMap((row) => lefts.map((x0) => {
      const y0 = top + row * 1.25 * size * (place === 'below' ? -1 : 1);
      return [x0, y0, x0 + width, y0 + 1.2 * size];
    })).filter(([x0]) => x0 >= pen.left);
    const spot = spots.find((one) => !taken.some((other) => covers(one, other))) ?? [left, top, left, top];
    taken.push(spot);
    pen.text(text, spot[0], spot[1],
      { base: 'top', strong: isOver, colour: isOver ? `--p${priority}-text` : '--ink-2' });
  }
}

/** @param {number[]} one @param {number[]} other */
const covers = ([left, top, right, bottom], [l, t, r, b]) => l < right && r > left && t < bottom && b > top;
