// All assets, the worst first: the same answers, smaller.
import { AssetCard } from '../card.js';
import { h, put } from '../dom.js';
import { FleetBar } from '../fleet_bar.js';

const STATES = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['safe', 'safe', ['ok']],
];
const MOST_CARDS = 6; // with more assets, tiles
const MOST_COLUMNS = 6; // of tiles that grow to fill a wall

export class FleetView {
  constructor(box, page) {
    this.page = page;
    const feeds = [...page.connection.feeds.values()];
    const dense = feeds.length > MOST_CARDS;
    this.cards = feeds.map((feed) => new AssetCard(feed, page.clock, dense));
    this.bar = new FleetBar(page, STATES, page.assets, () => this.update());
    this.nothing = h('p', { class: 'mut pad', role: 'status', hidden: true },
      'No asset fits what is chosen above.');
    this.grid = h('div', { class: dense ? 'cards dense' : 'cards' },
      this.cards.map((card) => card.element));
    const columns = Math.ceil(Math.sqrt(feeds.length));
    if (dense) this.grid.style.setProperty('--columns', columns <= MOST_COLUMNS ? columns : 99);
    put(box, h('h1', { class: 'vh' }, 'Fleet'), this.bar.element, this.nothing, this.grid);
    this.update();
    this.open();
    this.timer = setInterval(() => this.update(), 1000);
  }

  destroy() {
    clearInterval(this.timer);
    this.bar.destroy();
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

  update() {
    const { bar } = this;
    const verdicts = new Map(this.cards.map((card) => [card, card.update()]));
    const rank = (card) => verdicts.get(card).rank;
    const fitting = this.cards.filter(({ feed }) =>
      bar.fits(feed.store.get('asset') ?? { id: feed.assetId }));
    const order = fitting.filter((card) => !bar.state || this.isIn(verdicts.get(card), bar.state))
      .sort((a, b) => rank(a) - rank(b) || a.feed.assetId.localeCompare(b.feed.assetId));
    const { children } = this.grid;
    if (order.length !== children.length || order.some((card, i) => children[i] !== card.element)) {
      const focused = document.activeElement;
      this.grid.replaceChildren(...order.map((card) => card.element));
      if (this.grid.contains(focused)) focused.focus();
    }
    this.nothing.hidden = order.length > 0;
    bar.show(Object.fromEntries(STATES.map(([state]) =>
      [state, fitting.filter((card) => this.isIn(verdicts.get(card), state)).length])));
  }

  /** An asset over a limit whose data are lost belongs to both groups. */
  isIn(verdict, state) {
    return verdict.group === state || (state === 'lost' && verdict.lost === true);
  }
}
