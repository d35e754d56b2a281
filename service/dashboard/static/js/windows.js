// Low-risk windows on a time axis: what may be learned from, and what was.
import { h, put, s } from './dom.js';
import { dayTime, fixed, hourMinute, milliseconds, spanText } from './format.js';

const HEIGHT = 132;
const BASE = 94;

export const pointText = (point) =>
  `${fixed(point.speed_rpm, 0)} rpm, ${fixed(point.load_n, 0)} N, ${spanText(point.duration_s)}`;

const overlaps = (one, other) => milliseconds(one.start) < milliseconds(other.end)
  && milliseconds(one.end) > milliseconds(other.start);

export const isUsed = (window, used) => used.some((other) => overlaps(window, other));

/** Draw the windows in a box; `used` are those that the active model was trained with. */
export function drawWindows(box, windows, used, nowMs) {
  if (!windows.length) {
    put(box, h('p', { class: 'mut s pad' }, 'No low-risk window in the store yet: at least 30 min '
      + 'of good data inside the low-risk region are needed.'));
    return;
  }
  const width = Math.max(280, box.clientWidth);
  const first = Math.min(...windows.map((window) => milliseconds(window.start)));
  const span = Math.max(nowMs - first, 3600e3);
  const x = (ms) => 8 + (ms - first) / span * (width - 16);
  const highest = Math.max(...windows.map((window) => window.score), 1e-9);
  put(box, s('svg', {
    viewBox: `0 0 ${width} ${HEIGHT}`, role: 'img',
    'aria-label': `${windows.length} low-risk windows, the last one until `
      + dayTime(Math.max(...windows.map((window) => milliseconds(window.end)))),
  },
  s('path', { d: `M8 ${BASE}H${width - 8}`, stroke: 'var(--line-2)' }),
  timeMarks(first, span, x),
  windows.map((window) => windowBox(window, isUsed(window, used), x, highest))));
}

function windowBox(window, used, x, highest) {
  const left = x(milliseconds(window.start));
  const width = Math.max(14, x(milliseconds(window.end)) - left);
  const height = 12 + 56 * window.score / highest;
  const durationS = (milliseconds(window.end) - milliseconds(window.start)) / 1000;
  const middle = left + width / 2;
  const wide = width > 40;
  const text = (y, style, content) => wide
    && s('text', { x: middle, y, 'text-anchor': 'middle', style }, content);
  return s('g', {},
    s('title', {}, [`${dayTime(milliseconds(window.start))}, ${spanText(durationS)}`,
      `score ${fixed(window.score, 2)}`, ...window.operating_points.map(pointText)].join('\n')),
    s('rect', {
      x: left, y: BASE - height, width, height, rx: 2, 'stroke-width': 1.5,
      fill: used ? 'var(--fan50)' : 'var(--panel)', stroke: used ? 'var(--twin)' : 'var(--ink-3)',
    }),
    text(BASE - height - 5, { fill: 'var(--ink)', fontWeight: 700 }, fixed(window.score, 2)),
    text(109, { fill: 'var(--ink-3)' }, spanText(durationS)));
}

function timeMarks(first, span, x) {
  const marks = [];
  const hour = 3600e3;
  const step = [hour, 2 * hour, 6 * hour, 24 * hour, 7 * 24 * hour]
    .find((one) => span / one <= 12) ?? 30 * 24 * hour;
  const zone = new Date(first).getTimezoneOffset() * 60000;
  for (let at = Math.ceil((first - zone) / step) * step + zone; at < first + span; at += step) {
    const fits = x(at) < x(first + span) - 40;
    marks.push(s('path', { d: `M${x(at)} 8V112`, stroke: 'var(--line)' }), fits && s('text',
      { x: x(at) + 5, y: 128 },
      step < 24 * hour ? hourMinute(at) : dayTime(at).replace(/ \d\d:\d\d$/, '')));
  }
  return marks;
}
