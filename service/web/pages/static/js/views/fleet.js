// All assets, the worst first: the same answers, smaller.
import { call } from '../api.js';
import { AssetCard } from '../card.js';
import { h, put, setText } from '../dom.js';
import { icon } from '../icons.js';

const GROUPS = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['safe', 'safe', ['ok']],
];
const COUNT_EVERY_MS = 10000;
const FLOOD = 10;
const MOST_CARDS = 6; // with more assets, tiles
const MOST_COLUMNS = 6; // of tiles that grow to fill a wall

export class FleetView {
  constructor(box, page) {
    this.page = page;
    const feeds = [...page.connection.feeds.values()];
    const dense = feeds.length > MOST_CARDS;
    this.cards = feeds.map((feed) => new AssetCard(feed, page.clock, dense));
    this.chosen = null; // the group of verdicts that alone is shown, null for all
    this.counts = GROUPS.map(([group, text, symbol]) => this.createChip(group, text, symbol));
    this.groupFilter = this.createGroupFilter(feeds);
    this.recent = h('b', {}, '–');
    this.flood = h('span', { class: 'chip badc', hidden: true }, 'alarm flood');
    this.nothing = h('p', { class: 'mut pad', role: 'status', hidden: true },
      'No asset is in this state.');
    this.grid = h('div', { class: dense ? 'cards dense' : 'cards' },
      this.cards.map((card) => card.element));
    const columns = Math.ceil(Math.sqrt(feeds.length));
    if (dense) this.grid.style.setProperty('--columns', columns <= MOST_COLUMNS ? columns : 99);
    put(box, h('h1', { class: 'vh' }, 'Fleet'),
      h('div', { class: 'fsum' },
        h('div', { class: 'fchips', role: 'group', 'aria-label': 'Show only' },
          this.counts.map((one) => one.element)), this.groupFilter, h('span', { class: 'sp' }),
        h('span', { class: 's mut' }, 'Alarms in the last 10 min: ', this.recent,
          ` (flood above ${FLOOD}) `, this.flood)), this.nothing, this.grid);
    this.update();
    this.open();
    this.countAlarms();
    this.timers = [setInterval(() => this.update(), 1000),
      setInterval(() => this.countAlarms(), COUNT_EVERY_MS)];
  }

  /** How many assets are in a state; pressed, only these are shown. */
  createChip(group, text, symbol) {
    const figure = h('b', {});
    const element = h('button', {
      type: 'button', 'aria-pressed': 'false', 'data-group': group,
      onclick: () => {
        this.chosen = this.chosen === group ? null : group;
        this.update();
      },
    }, icon(symbol[0], symbol[1], '1.3em'), ' ', figure, text);
    return { figure, element };
  }

  /** The choice among the groups of the configuration; null where there are none. */
  createGroupFilter(feeds) {
    const groups = [...new Set(feeds.map(({ store }) => store.get('asset')?.group).filter(Boolean))];
    if (!groups.length) return null;
    return h('select', { 'aria-label': 'Group', onchange: () => this.update() },
      h('option', { value: '' }, 'all groups'),
      groups.sort().map((group) => h('option', { value: group }, group)));
  }

  destroy() {
    this.timers.forEach(clearInterval);
    this.cards.forEach((card) => card.destroy());
    this.ended = true;
  }

  /** One after the other, so that a large fleet does not ask for everything at once. */
  async open() {
    for (const { feed } of this.cards) {
      if (this.ended) return;
      await this.page.connection.guarded(() => feed.open('card'));
    }
  }

  async countAlarms() {
    await this.page.connection.guarded(async () => {
      const { last_10_min: recent, flood } = await call('/alarms/statistics');
      setText(this.recent, String(recent));
      this.flood.hidden = !flood;
    });
  }

  update() {
    const verdicts = new Map(this.cards.map((card) => [card, card.update()]));
    const rank = (card) => verdicts.get(card).rank;
    const wanted = this.groupFilter?.value;
    const inGroup = this.cards.filter(({ feed }) => !wanted || feed.store.get('asset')?.group === wanted);
    const order = inGroup.filter((card) => !this.chosen || this.isIn(verdicts.get(card), this.chosen))
      .sort((a, b) => rank(a) - rank(b) || a.feed.assetId.localeCompare(b.feed.assetId));
    const { children } = this.grid;
    if (order.length !== children.length || order.some((card, i) => children[i] !== card.element)) {
      const focused = document.activeElement;
      this.grid.replaceChildren(...order.map((card) => card.element));
      if (this.grid.contains(focused)) focused.focus();
    }
    this.nothing.hidden = order.length > 0;
    GROUPS.forEach(([group], i) => {
      const count = inGroup.filter((card) => this.isIn(verdicts.get(card), group)).length;
      setText(this.counts[i].figure, String(count));
      this.counts[i].element.classList.toggle('mut', count === 0);
      this.counts[i].element.setAttribute('aria-pressed', String(group === this.chosen));
    });
  }

  /** An asset over a limit whose data are lost belongs to both groups. */
  isIn(verdict, group) {
    return verdict.group === group || (group === 'lost' && verdict.lost === true);
  }
}
