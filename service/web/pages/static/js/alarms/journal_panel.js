// The journal with its filters: newest first, page by page.
import { call, saveText } from '../app/api.js';
import { assetsOf } from './alarm.js';
import { button, gap, hasText, Panel, quiet, search, section, select, table, v } from '../parts/panel.js';
import { journalColumns, journalCsv } from './journal.js';

const PAGE = 100;
const HOUR_MS = 3600e3;
const SPANS = [['all', 'all'], ['1', 'last hour'], ['8', 'last 8 h'], ['24', 'last 24 h'],
  ['168', 'last 7 days']];
const CLASSES = [['', 'alarms and events'], ['alarm', 'alarms'], ['event', 'events']];

/** changes: a text that differs when something has happened. */
export class JournalPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { lines: [], span: 'all', kind: '', asset: '', word: '', isLoading: true });
    this.load();
  }

  /** Something has happened: look again, once it is in the journal, unless pages are open. */
  componentDidUpdate({ changes }) {
    if (changes === this.props.changes) return;
    clearTimeout(this.timer);
    this.timer = this.after(500, () => this.lines.length <= PAGE && this.load());
  }

  query() {
    const now = this.page.clock.now();
    const { span, asset } = this;
    return { limit: PAGE, ...(asset && { asset }), ...(span !== 'all' && now !== null
      && { start: new Date(now - span * HOUR_MS).toISOString() }) };
  }

  async load(older = false) {
    const asked = older ? this.asked : this.query();
    this.asked = asked;
    this.set({ isLoading: true });
    await this.page.connection.guarded(async () => {
      const { items, next } = await call('/alarms/journal',
        { query: older ? { ...asked, cursor: this.next } : asked });
      if (this.asked === asked) this.set({ lines: older ? [...this.lines, ...items] : items, next, isKnown: true });
    });
    this.set({ isLoading: false });
  }

  render() {
    const { page, next } = this;
    const several = page.assets.length > 1;
    const lines = this.lines.filter((line) => (!this.kind || (line.class ?? 'alarm') === this.kind)
      && hasText(Object.values(line), this.word));
    const nameOf = ({ asset, assets }) => (asset ? page.nameOf(asset) : `${assets.length} assets`);
    const chosen = (label, pairs, name, changed) => select(label, pairs, this[name], (value) => {
      this.set({ [name]: value });
      changed?.();
    });
    return section('p-journal', 'Journal', [
      quiet(this.isKnown ? `${lines.length} entries${next ? ', older entries not loaded' : ''}` : 'Loading …',
        'status'),
      gap(), v('span', { class: 'row filters' }, search('Search text', (word) => this.set({ word })),
        chosen('Alarms or events', CLASSES, 'kind'),
        several && chosen('Asset of the journal', [['', 'all assets'],
          ...offered(page).map((id) => [id, page.nameOf(id)])], 'asset', () => this.load()),
        chosen('Time range', SPANS, 'span', () => this.load()),
        button('Save as CSV', () => saveText('alarm-journal.csv', journalCsv(lines), 'text/csv;charset=utf-8'),
          { disabled: !lines.length }))],
    table('Journal', journalColumns(several ? nameOf : null), lines, { look: 'jt',
      attributesOf: (line) => ({ 'data-class': line.class ?? 'alarm' }), empty: this.isKnown
      && (this.lines.length ? 'No entry matches the filters.' : 'No entries yet.') },
    next && button('Show older', () => this.load(true), { disabled: this.isLoading })));
  }
}

/** Assets to choose among: of many the one looked at last, and those with alarms. */
function offered({ connection, assets, live }) {
  if (!connection.many) return assets.map(({ id }) => id);
  return [...new Set([live.assetId, ...connection.alarms().flatMap(assetsOf)])].sort();
}
