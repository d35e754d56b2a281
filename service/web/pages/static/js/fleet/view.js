// All assets, the worst first: the same answers, smaller.
// view: {"place": 10, "title": "Fleet", "from": "viewer", "of": "all"}
import { AssetCard, cardVerdict, standingAlarm } from './card.js';
import { situation } from '../live/situation.js';
import { Panel, v } from '../parts/panel.js';
import { FleetBar, FleetChoice } from './bar.js';

const STATES = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['safe', 'safe', ['ok']],
];
const MOST_CARDS = 6; // with more assets, tiles
const MOST_COLUMNS = 6; // of tiles that grow to fill a wall

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    this.feeds = [...this.page.connection.feeds.values()];
    this.choice = new FleetChoice(STATES.map(([state]) => state), this.page.assets);
    this.every(1000);
    this.open();
  }

  /** One after the other, so that a large fleet does not ask for everything at once. */
  async open() {
    for (const feed of this.feeds) {
      if (this.ended) return;
      await this.page.connection.guarded(() => feed.open('card'));
    }
  }

  render({ page }) {
    const { choice, feeds } = this;
    choice.learn(page.assets);
    const dense = feeds.length > MOST_CARDS;
    const columns = Math.ceil(Math.sqrt(feeds.length));
    const cards = feeds.map((feed) => {
      const now = situation(feed.store.state, page.clock);
      return { feed, now, verdict: cardVerdict(now, standingAlarm(feed.store.get('alarms'))) };
    }).filter(({ feed }) => choice.fits(feed.store.get('asset') ?? { id: feed.assetId }));
    // An asset over a limit whose data are lost belongs to both groups.
    const of = (state) => cards.filter(({ verdict }) =>
      verdict.group === state || (state === 'lost' && verdict.lost === true));
    const shown = (choice.state ? of(choice.state) : cards).sort((a, b) =>
      a.verdict.rank - b.verdict.rank || a.feed.assetId.localeCompare(b.feed.assetId));
    return [
      v('h1', { class: 'vh' }, 'Fleet'),
      v(FleetBar, { page, states: STATES, choice, onchange: this.draw,
        counts: Object.fromEntries(STATES.map(([state]) => [state, of(state).length])) }),
      !shown.length && v('p', { class: 'mut pad', role: 'status' }, 'No asset fits what is chosen above.'),
      v('div', { class: dense ? 'cards dense' : 'cards',
        style: dense ? { '--columns': String(columns <= MOST_COLUMNS ? columns : 99) } : null },
      shown.map((card) => v(AssetCard, { ...card, clock: page.clock, dense, key: card.feed.assetId }))),
    ];
  }
}
