// What every chart is: a plot in a box, a pen on its canvas, a cursor that reads it.
import { token } from '../parts/dom.js';
import { ChartCursor } from './cursor.js';
import { font, fontSize, hatching, pixelRatio, roomAround, stroke, trace, write } from './paint.js';

/** A pen on the canvas of a plot: places are pixels of the canvas, widths and dashes those of CSS. */
export class Pen {
  constructor(plot) {
    const { left, top, width, height } = plot.bbox;
    this.plot = plot;
    this.context = plot.ctx;
    this.ratio = pixelRatio();
    this.size = fontSize() * this.ratio;
    this.left = left;
    this.top = top;
    this.width = width;
    this.height = height;
    this.right = left + width;
    this.bottom = top + height;
  }

  at(ms) { return this.x(ms / 1000); }

  x(value) { return this.plot.valToPos(value, 'x', true); }

  y(value) { return this.plot.valToPos(value, 'y', true); }

  within(action) {
    this.context.save();
    this.context.beginPath();
    this.context.rect(this.left, this.top, this.width, this.height);
    this.context.clip();
    action();
    this.context.restore();
  }

  line({ colour, width, dash = [] }, ...lines) {
    trace(this.context, { colour: token(colour), width: stroke(width) * this.ratio,
      dash: dash.map((length) => length * this.ratio) }, ...lines);
  }

  across(y, look) { this.line(look, [[this.left, y], [this.right, y]]); }

  upright(x, look) { this.line(look, [[x, this.top], [x, this.bottom]]); }

  text(text, x, y, { colour, halo = '--panel', ground = '', ...look }) {
    write(this.context, text, x, y, { size: this.size, ...look, colour: token(colour),
      halo: halo && token(halo), ground: ground && token(ground) });
  }

  widthOf(text, size = this.size, strong = false) {
    this.context.font = font(size, strong);
    return this.context.measureText(text).width;
  }

  title(text, halo = '--panel') {
    this.text(text, this.left + 8 * this.ratio, this.top + 3 * this.ratio, { base: 'top', colour: '--ink-2', halo });
  }

  nothing(text, look = {}) {
    this.text(text, this.left + this.width / 2, this.top + this.height / 2,
      { align: 'center', base: 'middle', colour: '--ink-2', halo: '', ...look });
  }

  /** Without good data between two places: hatched; rim: width of a dashed line around. */
  hatch(left, width, rim = 0) {
    const area = [left, this.top, width, this.height];
    for (const fill of [token('--bad-tint'), hatching(this.context, token('--bad-hatch'))]) {
      this.context.fillStyle = fill;
      this.context.fillRect(...area);
    }
    if (!rim) return;
    this.context.strokeStyle = token('--bad');
    this.context.lineWidth = stroke(rim) * this.ratio;
    this.context.setLineDash([4 * this.ratio, 4 * this.ratio]);
    this.context.strokeRect(...area);
    this.context.setLineDash([]);
  }

  ahead(nowMs) {
    const x = Math.max(this.left, this.at(nowMs));
    this.context.save();
    this.context.fillStyle = token('--panel-2');
    this.context.globalAlpha = 0.75;
    this.context.fillRect(x, this.top, Math.max(0, this.right - x), this.height);
    this.context.restore();
  }

  now(nowMs) {
    // On whole pixels, so that it is as sharp and as thick wherever it stands.
    const width = Math.max(1, Math.round(stroke(2) * this.ratio));
    const x = Math.round(this.at(nowMs)) + (width % 2) / 2;
    trace(this.context, { colour: token('--ink'), width }, [[x, this.top], [x, this.bottom]]);
  }
}

/**
 * A chart in a box, whose size it follows. A subclass has `options()` for uPlot, `paint(pen)`, and
 * `readAt(index)` where a cursor reads its values.
 */
export class Chart {
  constructor(box, { isRead = false } = {}) {
    this.box = box;
    this.isRead = isRead;
    this.plot = null;
  }

  /** Draw data; a chart of another `kind` is made again. */
  show(data, kind = '') {
    if (this.plot && kind === this.kind) {
      this.plot.setData(data);
      return;
    }
    this.destroy();
    this.kind = kind;
    this.reading = this.isRead ? new ChartCursor(this.box, (index) => this.readAt(index)) : null;
    const size = () => ({ width: this.box.clientWidth, height: this.box.clientHeight });
    const draw = (plot) => {
      plot.ctx.save();
      this.paint(new Pen(plot));
      plot.ctx.restore();
    };
    const { hooks, cursor, ...options } = this.options();
    this.plot = new uPlot({ ...size(), legend: { show: false }, padding: roomAround(), ...options,
      cursor: cursor || this.isRead ? { y: false, points: { show: false }, drag: { x: false, y: false }, ...cursor }
        : { show: false },
      hooks: { draw: [draw], setCursor: [() => this.reading?.show()], ...hooks } }, data, this.box);
    this.observer = new ResizeObserver(() => this.plot.setSize(size()));
    this.observer.observe(this.box);
    this.reading?.attach(this.plot);
  }

  destroy() {
    this.observer?.disconnect();
    this.plot?.destroy();
    this.reading?.destroy();
    this.plot = null;
  }

  /** @returns {any} */
  options() {
    return {};
  }

  paint(_) {}

  /** @returns {any} */
  readAt(_) { return null; }
}
