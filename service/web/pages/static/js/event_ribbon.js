// Alarms, model activations and operator events under the charts of the history, on their time axis.
import { call } from './api.js';
import { h, put } from './dom.js';
import { dayTimeSecond, milliseconds } from './format.js';
import { transitionText } from './journal.js';

const MOST_LINES = 1000; // of the journal within a range

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
    put(this.element, this.marks.map((line) => {
      const share = (milliseconds(line.time) - fromMs) / (toMs - fromMs);
      if (!(share >= 0 && share <= 1)) return null;
      const look = line.class === 'event' ? 'event' : `p${line.priority}`;
      return h('li', { class: look, style: { left: `${share * 100}%` } },
        h('a', { href: this.href, title: textOf(line) }, h('span', { class: 'vh' }, textOf(line))));
    }));
  }
}
