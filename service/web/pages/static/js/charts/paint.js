// Canvas helpers of the charts, and the axes and lines that all of them share.
import { rem, token } from '../parts/dom.js';
import { hourMinute } from '../parts/format.js';

export const pixelRatio = () => window.devicePixelRatio || 1;
export const fontSize = () => rem() * 0.8125;
export const font = (pixels, strong) =>
  `${strong ? 700 : 400} ${Math.round(pixels)}px B612, "Segoe UI", sans-serif`;

const AXIS_WIDTH = 54 / 16;
const DESK_REM = 14;
const MOST_FIGURES = 8; // on an axis of values, however high it is

export const CLEAR = 'rgba(0,0,0,0)';

/** Width of a line in CSS pixels that grows with the type: a wall is looked at from afar. */
export const stroke = (pixels) => pixels * Math.max(1, rem() / DESK_REM);

/** Room around a plot, so that the first and the last figure of an axis are whole. */
export const roomAround = () => [fontSize() * 0.65, 8, fontSize() * 0.65, 0];

const axis = (ink, more) => ({
  stroke: token(ink), font: font(fontSize()), grid: { stroke: token('--grid'), width: stroke(1) },
  ticks: { show: false }, ...more,
});

export const timeAxis = (show, more = {}) => axis('--ink-2', {
  size: show ? rem() * 1.9 : 0, space: stroke(90),
  values: (plot, splits) => splits.map((second) => {
    const room = plot.valToPos(plot.scales.x.max, 'x') - plot.valToPos(second, 'x');
    return !show || room < 24 ? '' : hourMinute(second * 1000);
  }),
  ...more,
});

/**
 * An axis of values with a figure every `least` pixels of a desk's type at most.
 * @param {any} options
 */
export const valueAxis = ({ least = 34, ...options } = {}) => axis('--ink-3', {
  size: AXIS_WIDTH * rem(),
  space: (plot, side, low, high, length) => Math.max(stroke(least), length / MOST_FIGURES),
  ...options,
});

/** How a line of a chart is drawn; without points, and not over holes. */
export const lineOf = (colour, width, more = {}) =>
  ({ stroke: colour, width: stroke(width), points: { show: false }, spanGaps: false, ...more });

/** A scale of time between two times in ms that may change. */
export const timeScale = (from, to) => ({ time: true, range: () => [from() / 1000, to() / 1000] });

/**
 * A piece of text. look: { size, strong, colour, align, base, ground (a box behind it), halo (a rim
 * of this colour, where it crosses a line) }.
 */
export function write(context, text, x, y, look) {
  context.font = font(look.size, look.strong);
  context.textAlign = look.align ?? 'left';
  context.textBaseline = look.base ?? 'bottom';
  if (look.ground) {
    const width = context.measureText(text).width;
    const left = look.align === 'right' ? x - width : x;
    context.save();
    context.fillStyle = look.ground;
    context.globalAlpha = 0.88;
    context.fillRect(left - look.size * 0.35, y - look.size * 1.2, width + look.size * 0.7,
      look.size * 1.35);
    context.restore();
  }
  if (look.halo) {
    context.strokeStyle = look.halo;
    context.lineWidth = look.size * 0.3;
    context.lineJoin = 'round';
    context.strokeText(text, x, y);
  }
  context.fillStyle = look.colour;
  context.fillText(text, x, y);
}

/** Lines through points [[x, y], …]; look: { colour, width, dash } in pixels of the context. */
export function trace(context, { colour, width, dash = [] }, ...lines) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.setLineDash(dash);
  context.beginPath();
  for (const [first, ...rest] of lines) {
    context.moveTo(...first);
    rest.forEach((point) => context.lineTo(...point));
  }
  context.stroke();
  context.setLineDash([]);
}

export function hatching(context, colour) {
  const ratio = pixelRatio();
  const size = Math.round(stroke(9) * ratio);
  const tile = document.createElement('canvas');
  tile.width = tile.height = size;
  const pen = tile.getContext('2d');
  pen.strokeStyle = colour;
  pen.lineWidth = stroke(2) * ratio;
  pen.beginPath();
  for (const shift of [-size, 0, size]) {
    pen.moveTo(shift, size);
    pen.lineTo(shift + size, 0);
  }
  pen.stroke();
  return context.createPattern(tile, 'repeat');
}

/** The dashed, hollow symbol of a predicted crossing: a square for priority 1, else a triangle. */
export function paintPredicted(context, x, y, size, priority) {
  const shape = new Path2D(priority === 1 ? 'M-.5 -.5H.5V.5H-.5Z' : 'M0 -.6L.62 .5H-.62Z');
  context.save();
  context.translate(x, y);
  context.scale(size, size);
  context.lineWidth = 0.13;
  context.strokeStyle = token(`--p${priority}-line`);
  context.fillStyle = token('--panel');
  context.setLineDash([0.2, 0.14]);
  context.fill(shape);
  context.stroke(shape);
  context.restore();
}
