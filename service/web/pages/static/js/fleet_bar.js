// The bar above the fleet: counts that are filters, the group, a search, and how many alarms came.
// What is chosen stands in the address, so that a link keeps it.
import { call } from './api.js';
import { h, setText } from './dom.js';
import { icon } from './icons.js';
import { keepQuery, readQuery } from './route.js';

const COUNT_EVERY_MS = 10000;
const FLOOD = 10;

/** The group of an asset as the fleet's pages show it; '' where it has none. */
export const groupOf = (asset) => asset?.group ?? '';

/** Whether an asset has a text in its id, name, group, family or bearing, in capital or small letters. */
export function hasText(asset, text) {
  const word = text.trim().toLowerCase();
  return !word || [asset.id, asset.name, groupOf(asset), asset.family, asset.bearing].filter(Boolean).join(' ')
    .toLowerCase().includes(word);
}

export class FleetBar {
  /**
   * states: [[name, text, [kind and look of its symbol]], …]; assets: whose groups are offered;
   * onChange(): another choice was made.
   */
  constructor(page, states, assets, onChange) {
    this.page = page;
    this.onChange = onChange;
    const query = readQuery();
    this.state = states.some(([name]) => name === query.get('state')) ? query.get('state') : '';
    this.chips = states.map(([state, text, symbol]) => this.createChip(state, text, symbol));
    this.search = h('input', {
      type: 'search', placeholder: 'Search', 'aria-label': 'Search assets', value: query.get('q'),
      maxlength: 200, oninput: () => this.changed(),
    });
    this.groups = this.createGroups(assets, query.get('group') ?? '');
    this.recent = h('b', {}, '–');
    this.flood = h('span', { class: 'chip badc', hidden: true }, 'alarm flood');
    this.element = h('div', { class: 'fsum' },
      h('div', { class: 'fchips', role: 'group', 'aria-label': 'Show only' },
        this.chips.map((one) => one.element)), this.groups, this.search,
      h('span', { class: 'sp' }),
      h('span', { class: 's mut' }, 'Alarms in the last 10 min: ', this.recent,
        ` (flood above ${FLOOD}) `, this.flood));
    this.countAlarms();
    this.timer = setInterval(() => this.countAlarms(), COUNT_EVERY_MS);
  }

  destroy() {
    clearInterval(this.timer);
  }

  get group() {
    return this.groups?.value ?? '';
  }

  get text() {
    return this.search.value.trim();
  }

  /** Whether an asset is of the chosen group and has the text. */
  fits(asset) {
    return (!this.group || groupOf(asset) === this.group) && hasText(asset, this.text);
  }

  /** How many assets are in a state; pressed, only these are shown. */
  createChip(state, text, symbol) {
    const figure = h('b', {});
    const element = h('button', {
      type: 'button', 'aria-pressed': 'false', 'data-group': state,
      onclick: () => {
        this.state = this.state === state ? '' : state;
        this.changed();
      },
    }, icon(symbol[0], symbol[1], '1.3em'), ' ', figure, text);
    return { state, figure, element };
  }

  /** The choice among the groups; null where there are none. */
  createGroups(assets, chosen) {
    const groups = [...new Set(assets.map(groupOf).filter(Boolean))];
    if (!groups.length) return null;
    return h('select', { 'aria-label': 'Group', onchange: () => this.changed() },
      h('option', { value: '' }, 'all groups'),
      groups.sort().map((group) => h('option', { value: group, selected: group === chosen }, group)));
  }

  changed() {
    keepQuery({ group: this.group, state: this.state, q: this.text });
    this.onChange();
  }

  /** counts: how many assets are in a state, by its name. */
  show(counts) {
    for (const { state, figure, element } of this.chips) {
      setText(figure, (counts[state] ?? 0).toLocaleString('en'));
      element.classList.toggle('mut', !counts[state]);
      element.setAttribute('aria-pressed', String(state === this.state));
    }
  }

  async countAlarms() {
    await this.page.connection.guarded(async () => {
      const { last_10_min: recent, flood } = await call('/alarms/statistics');
      setText(this.recent, String(recent));
      this.flood.hidden = !flood;
    });
  }
}
