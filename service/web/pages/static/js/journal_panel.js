// The journal with its filters: newest first, page by page.
import { call } from './api.js';
import { h, put, scrollable, setText } from './dom.js';
import { saveText } from './files.js';
import { journalCsv, journalHead, journalRow } from './journal.js';

const PAGE = 100;
const HOUR_MS = 3600e3;
const SPANS = [['all', 'all'], [1, 'last hour'], [8, 'last 8 h'], [24, 'last 24 h'],
  [168, 'last 7 days']];
const CLASSES = [['', 'alarms and events'], ['alarm', 'alarms'], ['event', 'events']];

export class JournalPanel {
  constructor(page) {
    this.page = page;
    this.several = page.assets.length > 1;
    this.lines = [];
    const again = () => this.load();
    const select = (label, options, change) => {
      const element = h('select', { 'aria-label': label, onchange: change },
        options.map(([value, text]) => h('option', { value }, text)));
      return element;
    };
    this.span = select('Time range', SPANS, again);
    this.kind = select('Alarms or events', CLASSES, () => this.show());
    this.asset = select('Asset of the journal',
      [['', 'all assets'], ...offered(page).map((id) => [id, page.nameOf(id)])], again);
    this.search = h('input', {
      type: 'search', placeholder: 'Search text', 'aria-label': 'Search text',
      oninput: () => this.show(),
    });
    this.count = h('span', { class: 's mut', role: 'status' });
    this.save = h('button', { class: 'btn sm', type: 'button', onclick: () => this.export() },
      'Save as CSV');
    this.older = h('button', { class: 'btn sm', type: 'button', onclick: () => this.loadOlder() },
      'Show older');
    this.body = h('tbody', {});
    this.element = h('section', { class: 'panel p-journal' },
      h('header', {}, h('h2', {}, 'Journal'), this.count, h('span', { class: 'sp' }),
        h('span', { class: 'row filters' }, this.search, this.kind,
          this.several && this.asset, this.span, this.save)),
      scrollable('scroll', 'Journal',
        h('table', { class: 'jt' }, h('thead', {}, journalHead(this.several)), this.body),
        this.older));
    this.older.hidden = true;
    setText(this.count, 'Loading …');
    this.load();
  }

  destroy() {
    clearTimeout(this.timer);
    this.ended = true;
  }

  /** Something has happened: look again, once it is in the journal, unless pages are open. */
  refresh() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.lines.length <= PAGE && this.load(), 500);
  }

  query() {
    const query = { limit: PAGE };
    if (this.asset.value) query.asset = this.asset.value;
    const now = this.page.clock.now();
    if (this.span.value !== 'all' && now !== null) {
      query.start = new Date(now - this.span.value * HOUR_MS).toISOString();
    }
    return query;
  }

  async load() {
    const asked = this.query();
    this.asked = asked;
    await this.page.connection.guarded(async () => {
      const { items, next } = await call('/alarms/journal', { query: asked });
      if (this.asked !== asked || this.ended) return;
      this.lines = items;
      this.next = next;
      this.show();
    });
  }

  async loadOlder() {
    this.older.disabled = true;
    const { asked } = this;
    await this.page.connection.guarded(async () => {
      const { items, next } = await call('/alarms/journal',
        { query: { ...asked, cursor: this.next } });
      if (this.asked !== asked || this.ended) return;
      this.lines = [...this.lines, ...items];
      this.next = next;
      this.show();
    });
    this.older.disabled = false;
  }

  chosen() {
    const word = this.search.value.trim().toLowerCase();
    const kind = this.kind.value;
    return this.lines.filter((line) => (!kind || (line.class ?? 'alarm') === kind)
      && (!word || Object.values(line).join(' ').toLowerCase().includes(word)));
  }

  show() {
    const lines = this.chosen();
    put(this.body, lines.map((line) => journalRow(line, this.several && this.page.nameOf(line.asset))));
    if (!lines.length) {
      put(this.body, h('tr', {}, h('td', { colspan: 8, class: 'mut pad' },
        this.lines.length ? 'No entry matches the filters.' : 'No entries yet.')));
    }
    this.older.hidden = !this.next;
    this.save.disabled = !lines.length;
    setText(this.count, `${lines.length} entries${this.next ? ', older entries not loaded' : ''}`);
  }

  export() {
    saveText('alarm-journal.csv', journalCsv(this.chosen()), 'text/csv;charset=utf-8');
  }
}

/** Assets to choose among: of many the one looked at last, and those with alarms. */
function offered({ connection, assets, live }) {
  if (!connection.many) return assets.map(({ id }) => id);
  return [...new Set([live.assetId, ...connection.alarms().map(({ alarm }) => alarm.asset)])].sort();
}
