// Alarms, model activations and operator events under the charts of the history, on their time axis.
import { call } from '../app/api.js';
import { h } from '../parts/dom.js';
import { dayTimeSecond, milliseconds } from '../parts/format.js';
import { draw, v } from '../parts/panel.js';
import { transitionText } from '../alarms/journal.js';

const MOST_LINES = 1000; // of the journal within a range
const LINK_PX = 24; // wide enough for a finger; what lies closer together shares a link
const MOST_TEXTS = 5; // of a link, in words

const isMark = (line) => line.class === 'event' || line.to === 'UNACK';
const textOf = (line) => [dayTimeSecond(milliseconds(line.time)), line.class === 'event'
  ? line.message || line.kind : `${line.message || line.kind} ${transitionText(line)}`, line.comment]
  .filter(Boolean).join(', ');

export class EventRibbon {
  constructor(href) {
    this.href = href;
    this.marks = [];
    this.element = h('ol', { class: 'ribbon', 'aria-label': 'Alarms and events' });
  }

  async load(asset, { fromMs, toMs }, signal) {
    const query = { asset, start: new Date(fromMs).toISOString(),
      end: new Date(toMs).toISOString(), limit: MOST_LINES };
    const { items } = await call('/alarms/journal', { query, signal });
    this.marks = items.filter(isMark);
  }

  /** Draw them; area: { left, width } of the plots above, in pixels. */
  show({ fromMs, toMs }, area) {
    this.element.hidden = !area;
    if (!area) return;
    this.element.style.marginLeft = `${area.left}px`;
    this.element.style.width = `${area.width}px`;
    const place = (line) => area.width * (milliseconds(line.time) - fromMs) / (toMs - fromMs);
    const marks = this.marks.map((line) => ({ line, x: place(line) })).filter(({ x }) => x >= 0 && x <= area.width);
    const links = Map.groupBy(marks, ({ x }) => Math.floor(x / LINK_PX));
    draw(this.element, [...links].map(([slot, marks]) => {
      const texts = marks.slice(0, MOST_TEXTS).map(({ line }) => textOf(line));
      if (marks.length > MOST_TEXTS) texts.push(`${marks.length - MOST_TEXTS} more`);
      return v('li', { style: { left: `${slot * LINK_PX}px` } },
        v('a', { href: this.href, title: texts.join('\n') },
          v('span', { class: 'vh' }, texts.join('; ')),
          marks.map(({ line, x }) => v('i', { class: line.class === 'event' ? 'event' : `p${line.priority}`,
            style: { left: `${x - slot * LINK_PX}px` } }))));
    }));
  }
}
