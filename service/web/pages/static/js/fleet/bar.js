// The bar above the fleet: counts that are filters, the group, a search, and how many alarms came.
// What is chosen stands in the address, so that a link keeps it.
import { call } from '../app/api.js';
import { icon } from '../parts/icons.js';
import { gap, hasText, Panel, search, select, v } from '../parts/panel.js';
import { keepQuery, readQuery } from '../app/route.js';

const COUNT_EVERY_MS = 10000;
const FLOOD = 10;

/** The group of an asset as the fleet's pages show it; '' where it has none. */
export const groupOf = (asset) => asset?.group ?? '';

/** What is chosen: a group, a state and a text, each '' for all; states: their names. */
export class FleetChoice {
  constructor(states, assets) {
    const query = readQuery();
    this.state = states.includes(query.get('state')) ? query.get('state') : '';
    this.wantedGroup = query.get('group') ?? '';
    this.typed = query.get('q') ?? '';
    this.learn(assets);
  }

  /** Learn which groups there are. */
  learn(assets) {
    this.groups = new Set(assets.map(groupOf).filter(Boolean).sort());
  }

  /** A group that is gone, such as that of an old link, hides no asset. */
  get group() {
    return this.groups.has(this.wantedGroup) ? this.wantedGroup : '';
  }

  get text() {
    return this.typed.trim();
  }

  fits(asset) {
    return (!this.group || groupOf(asset) === this.group)
      && hasText([asset.id, asset.name, groupOf(asset), asset.family, asset.bearing], this.text);
  }
}

/**
 * states: [[name, text, [kind and look of its symbol]], …]; choice: a FleetChoice; counts: how many
 * assets are in a state, by its name; onchange(): another choice was made.
 */
export class FleetBar extends Panel {
  constructor(attributes) {
    super(attributes);
    this.poll(COUNT_EVERY_MS, () => this.countAlarms());
  }

  async countAlarms() {
    await this.page.connection.guarded(async () => this.set({ figures: await call('/alarms/statistics') }));
  }

  choose(change) {
    const { choice, onchange } = this.props;
    Object.assign(choice, change);
    keepQuery({ group: choice.wantedGroup, state: choice.state, q: choice.text });
    onchange();
    this.draw();
  }

  render({ states, choice, counts }) {
    const { groups } = choice;
    return v('div', { class: 'fsum' },
      v('div', { class: 'fchips', role: 'group', 'aria-label': 'Show only' }, states.map(([state, text, symbol]) =>
        v('button', { type: 'button', 'aria-pressed': state === choice.state, 'data-group': state,
          class: counts[state] ? '' : 'mut',
          onclick: () => this.choose({ state: choice.state === state ? '' : state }) },
        icon(symbol[0], symbol[1], '1.3em'), ' ', v('b', {}, (counts[state] ?? 0).toLocaleString('en')), text))),
      groups.size > 0 && select('Group',
        [['', 'all groups'], ...[...groups].map((group) => [group, group])], choice.group,
        (wantedGroup) => this.choose({ wantedGroup })),
      search('Search assets', (typed) => this.choose({ typed }),
        { placeholder: 'Search', value: choice.typed, maxlength: 200 }), gap(),
      v('span', { class: 's mut' }, 'Alarms in the last 10 min: ', v('b', {}, this.figures?.last_10_min ?? '–'),
        ` (flood above ${FLOOD}) `, this.figures?.flood && v('span', { class: 'chip flood' }, 'alarm flood')));
  }
}
