// The cursor of a chart, by pointer and by keyboard: the values there, and differences to a mark.
import { h } from '../parts/dom.js';
import { fixed, spanText } from '../parts/format.js';
import { draw, v } from '../parts/panel.js';
import { pixelRatio } from './paint.js';

const FAR = 10; // points that an arrow key moves together with Shift
const BOX_GAP = 14;

/**
 * A chart that can be read: arrow keys, Home and End move the cursor, Shift-click or Enter sets a
 * mark, Escape removes both. The values stand in a box next to the cursor, which a screen reader
 * reads out.
 */
export class ChartCursor {
  /**
   * readAt(index) gives { ms, head: [text, quiet text], rows: [{ name, value, unit, digits, more }] }
   * of a place on the axis of time, or null.
   */
  constructor(box, readAt) {
    this.box = box;
    this.readAt = readAt;
    this.mark = null;
    this.element = h('div', { class: 'tip', 'aria-live': 'polite' });
    box.append(this.element);
    box.tabIndex = 0;
    box.setAttribute('role', 'group');
    box.setAttribute('aria-roledescription', 'chart');
    box.setAttribute('aria-keyshortcuts', 'ArrowLeft ArrowRight Home End Enter Escape');
    this.listeners = new AbortController();
    const { signal } = this.listeners;
    box.addEventListener('keydown', (event) => this.press(event), { signal });
    box.addEventListener('click', (event) => event.shiftKey && this.setMark(), { signal });
    box.addEventListener('blur', () => this.hide(), { signal });
  }

  destroy() {
    this.listeners.abort();
    this.element.remove();
  }

  attach(plot) {
    this.plot = plot;
  }

  press(event) {
    const keys = { ArrowLeft: -1, ArrowRight: 1, Home: -Infinity, End: Infinity };
    if (event.key === 'Escape') {
      this.mark = null;
      this.hide();
      this.plot.redraw(false);
    } else if (event.key === 'Enter') {
      this.setMark();
    } else if (event.key in keys) {
      this.move(keys[event.key] * (event.shiftKey ? FAR : 1));
    } else {
      return;
    }
    event.preventDefault();
  }

  move(by) {
    const [times] = this.plot.data;
    const { min, max } = this.plot.scales.x;
    const seen = times.map((_, i) => i)
      .filter((i) => times[i] >= min && times[i] <= max && this.readAt(i)?.rows.length);
    if (!seen.length) return;
    const { idx: index, left } = this.plot.cursor;
    const present = left >= 0 ? seen.findLastIndex((i) => i <= index) : seen.length - 1;
    const place = left >= 0 ? present + by : present;
    const next = seen[Math.max(0, Math.min(seen.length - 1, place))];
    this.plot.setCursor({ left: this.plot.valToPos(times[next], 'x'), top: 1 });
  }

  setMark() {
    const { idx: index, left } = this.plot.cursor;
    if (left < 0 || index === null) return;
    this.mark = this.readAt(index);
    this.show();
    this.plot.redraw(false);
  }

  hide() {
    this.element.style.display = 'none';
    if (this.plot.cursor.left >= 0) this.plot.setCursor({ left: -10, top: -10 });
  }

  show() {
    const { idx: index, left } = this.plot.cursor;
    const reading = left >= 0 && index !== null && index !== undefined ? this.readAt(index) : null;
    if (!reading) {
      this.element.style.display = 'none';
      return;
    }
    const [title, aside] = reading.head;
    const line = (first, quiet, tag = 'span') =>
      v('div', {}, v(tag, {}, first), quiet && v('span', { class: 'mut' }, `  ${quiet}`));
    draw(this.element, line(title, aside, 'b'), reading.rows.map((row) =>
      line(`${row.name} ${fixed(row.value, row.digits)} ${row.unit}`,
        [row.more, this.difference(row)].filter(Boolean).join('  '))),
    this.mark && line(this.distance(reading), null));
    this.element.style.display = 'block';
    const most = this.box.clientWidth - this.element.offsetWidth - 4;
    const at = left + this.plot.bbox.left / pixelRatio() + BOX_GAP;
    this.element.style.left = `${Math.max(0, Math.min(at, most))}px`;
  }

  difference({ name, value, unit, digits }) {
    const marked = this.mark?.rows.find((row) => row.name === name);
    if (!marked) return '';
    const change = value - marked.value;
    return `Δ ${change > 0 ? '+' : ''}${fixed(change, digits)} ${unit === '°C' ? 'K' : unit}`;
  }

  distance({ ms }) {
    const seconds = (ms - this.mark.ms) / 1000;
    const side = seconds < 0 ? 'before' : 'after';
    const exact = Math.abs(seconds) < 100 ? `${fixed(Math.abs(seconds), 0)} s` : null;
    return `${exact ?? spanText(Math.abs(seconds))} ${side} the mark`;
  }

  paintMark(pen) {
    const x = this.mark && pen.at(this.mark.ms);
    if (x >= pen.left && x <= pen.right) pen.upright(x, { colour: '--ink-2', width: 1.5, dash: [2, 4] });
  }
}
