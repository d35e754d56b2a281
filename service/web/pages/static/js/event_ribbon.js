// Alarms, model activations and operator events under the charts of the history, on their time axis.
import { call } from './api.js';
import { h, put } from './dom.js';
import { dayTimeSecond, milliseconds } from './format.js';
import { transitionText } from './journal.js';

const MOST_LINES = 1000; // of the journal within a range
const LINK_PX = 24; // wide enough for a finger; what lies closer together shares a link
const MOST_TEXTS = 5; // of a link, in words

const isMark = (line) => line.class === 'event' || line.to === 'UNACK';
const textOf = (line) => [dayTimeSecond(milliseconds(line.time)), line.class === 'event'
  ? line.message || line.kind : `${line.message || line.kind} ${transitionText(line)}`, line.comment]
  .filter(Boolean).join(', ');

export class EventRibbon {
  /** href: where the journal is shown. */
  constructor(href) {
    this.href = href;
    this.marks = [];
    this.element = h('ol', { class: 'ribbon', 'aria-label': 'Alarms and events' });
  }

  /** Fetch the marks of a range: alarms that were raised, and events. */
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
    const links = new Map();
    for (const line of this.marks) {
      const x = area.width * (milliseconds(line.time) - fromMs) / (toMs - fromMs);
      if (!(x >= 0 && x <= area.width)) continue;
      const slot = Math.floor(x / LINK_PX);
      if (!links.has(slot)) links.set(slot, []);
      links.get(slot).push({ line, left: x - slot * LINK_PX });
    }
    put(this.element, [...links].map(([slot, marks]) => {
      const texts = marks.slice(0, MOST_TEXTS).map(({ line }) => textOf(line));
      if (marks.length > MOST_TEXTS) texts.push(`${marks.length - MOST_TEXTS} more`);
      return h('li', { style: { left: `${slot * LINK_PX}px` } },
        h('a', { href: this.href, title: texts.join('\n') },
          h('span', { class: 'vh' }, texts.join('; ')),
          marks.map(({ line, left }) => h('i', {
            class: line.class === 'event' ? 'event' : `p${line.priority}`,
            style: { left: `${left}px` } }))));
    }));
  }
}
