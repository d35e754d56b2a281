// Canvas helpers of the charts, and the axes that all of them share.
import { rem, token } from './dom.js';
import { hourMinute } from './format.js';

export const pixelRatio = () => window.devicePixelRatio || 1;
export const fontSize = () => rem() * 0.8125;
export const font = (pixels, strong) =>
  `${strong ? 700 : 400} ${Math.round(pixels)}px B612, "Segoe UI", sans-serif`;

const AXIS_WIDTH = 54 / 16;
const DESK_REM = 14;
const MOST_FIGURES = 8; // on an axis of values, however high it is

/** Width of a line in CSS pixels that grows with the type: a wall is looked at from afar. */
export const stroke = (pixels) => pixels * Math.max(1, rem() / DESK_REM);

/** Room around a plot, so that the first and the last figure of an axis are whole. */
export const roomAround = () => [fontSize() * 0.65, 8, fontSize() * 0.65, 0];

/** The shared axis of time; without figures where another chart below shows them. */
export function timeAxis(show) {
  return {
    stroke: token('--ink-2'), font: font(fontSize()), size: show ? rem() * 1.9 : 0,
    space: stroke(90), grid: { stroke: token('--grid'), width: stroke(1) }, ticks: { show: false },
    values: (plot, splits) => splits.map((second) => {
      if (!show) return '';
      const room = plot.valToPos(plot.scales.x.max, 'x') - plot.valToPos(second, 'x');
      return room < 24 ? '' : hourMinute(second * 1000);
    }),
  };
}

/** An axis of values with a figure every `least` pixels of a desk's type at most. */
export const valueAxis = ({ least = 34, ...options } = {}) => ({
  stroke: token('--ink-3'), font: font(fontSize()), size: AXIS_WIDTH * rem(),
  grid: { stroke: token('--grid'), width: stroke(1) }, ticks: { show: false },
  space: (plot, axis, low, high, length) => Math.max(stroke(least), length / MOST_FIGURES),
  ...options,
});

/** A uPlot in a box, that follows the size of the box. */
export function mount(box, options, data) {
  const size = () => ({ width: box.clientWidth, height: box.clientHeight });
  const plot = new uPlot({
    ...size(), legend: { show: false }, padding: [0, 8, 0, 0],
    ...options,
  }, data, box);
  const observer = new ResizeObserver(() => plot.setSize(size()));
  observer.observe(box);
  const destroy = () => {
    observer.disconnect();
    plot.destroy();
  };
  return { plot, destroy };
}

export const cursor = (key) => ({
  y: false, points: { show: false }, drag: { x: false, y: false }, sync: { key },
});

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

/** The future has a lighter ground. */
export function paintAhead(plot, nowS) {
  const { ctx: context, bbox } = plot;
  const x = Math.max(bbox.left, plot.valToPos(nowS, 'x', true));
  context.save();
  context.fillStyle = token('--panel-2');
  context.globalAlpha = 0.75;
  context.fillRect(x, bbox.top, Math.max(0, bbox.left + bbox.width - x), bbox.height);
  context.restore();
}

/** The line between past and future. */
export function paintNow(plot, nowS) {
  const { ctx: context, bbox } = plot;
  const ratio = pixelRatio();
  // On whole pixels, so that it is as sharp and as thick wherever it stands.
  const width = Math.max(1, Math.round(stroke(2) * ratio));
  const x = Math.round(plot.valToPos(nowS, 'x', true)) + (width % 2) / 2;
  context.setLineDash([]);
  context.strokeStyle = token('--ink');
  context.lineWidth = width;
  context.beginPath();
  context.moveTo(x, bbox.top);
  context.lineTo(x, bbox.top + bbox.height);
  context.stroke();
}

/** A pattern of slanted lines: data that must not be trusted. */
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
  context.save();
  context.translate(x, y);
  context.lineWidth = size * 0.13;
  context.strokeStyle = token(`--p${priority}-line`);
  context.fillStyle = token('--panel');
  context.setLineDash([size * 0.2, size * 0.14]);
  context.beginPath();
  if (priority === 1) {
    context.rect(-size / 2, -size / 2, size, size);
  } else {
    context.moveTo(0, -size * 0.6);
    context.lineTo(size * 0.62, size * 0.5);
    context.lineTo(-size * 0.62, size * 0.5);
    context.closePath();
  }
  context.fill();
  context.stroke();
  context.restore();
}
