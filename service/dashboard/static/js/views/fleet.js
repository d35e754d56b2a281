// All assets, the worst first: the same three answers, smaller.
import { call } from '../api.js';
import { AssetCard } from '../card.js';
import { h, put, setText } from '../dom.js';
import { icon } from '../icons.js';

const GROUPS = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['safe', 'safe', ['ok']],
  ['rest', 'at rest', ['none']],
];
const COUNT_EVERY_MS = 10000;
const FLOOD = 10;

export class FleetView {
  constructor(box, page) {
    this.page = page;
    this.cards = [...page.connection.feeds.values()].map((feed) => new AssetCard(feed, page.clock));
    this.counts = GROUPS.map(([, text, symbol]) => {
      const figure = h('b', {});
      const element = h('span', {}, icon(symbol[0], symbol[1], '1.3em'), ' ', figure, text);
      return { figure, element };
    });
    this.recent = h('b', {}, '–');
    this.flood = h('span', { class: 'chip badc', hidden: true }, 'alarm flood');
    this.grid = h('div', { class: 'cards' }, this.cards.map((card) => card.element));
    put(box, h('h1', { class: 'vh' }, 'Fleet'),
      h('div', { class: 'fsum' }, this.counts.map((one) => one.element), h('span', { class: 'sp' }),
        h('span', { class: 's mut' }, 'Alarms in the last 10 min: ', this.recent,
          ` (flood above ${FLOOD}) `, this.flood)), this.grid);
    this.update();
    this.open();
    this.countAlarms();
    this.timers = [setInterval(() => this.update(), 1000),
      setInterval(() => this.countAlarms(), COUNT_EVERY_MS)];
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
    const order = [...this.cards].sort((a, b) => rank(a) - rank(b)
      || a.feed.assetId.localeCompare(b.feed.assetId));
    if (order.some((card, i) => this.grid.children[i] !== card.element)) {
      const focused = document.activeElement;
      this.grid.replaceChildren(...order.map((card) => card.element));
      if (this.grid.contains(focused)) focused.focus();
    }
    GROUPS.forEach(([group], i) => {
      const count = [...verdicts.values()].filter((verdict) => verdict.group === group).length;
      setText(this.counts[i].figure, String(count));
      this.counts[i].element.classList.toggle('mut', count === 0);
    });
  }
}
