// Nightly identification of the fleet: how far the running night is, and what the last ones cost.
import { call } from './api.js';
import { h, put, scrollable, setText } from './dom.js';
import { dayTimeSecond, fixed, milliseconds, spanText, timeElement } from './format.js';
import { plural } from './provisioning.js';

const MOST_NIGHTS = 3;
const HEAD = ['Night', 'State', 'Done', 'Refused', 'Failed', 'Skipped', 'Left', 'Processor time', 'Per machine'];
const STATES = {
  running: 'running', ended: 'ended', stopped: 'stopped before the end', lost: 'lost: no sign of life',
};

export class NightsPanel {
  constructor() {
    this.now = h('p', { class: 'pad', role: 'status' });
    this.bar = h('progress', { max: 1, value: 0, 'aria-label': 'Progress of the night' });
    this.body = h('tbody', {});
    this.problems = h('ul', { class: 's problem' });
    this.element = h('section', { class: 'panel p-nights', hidden: true },
      h('header', {}, h('h2', {}, 'Nightly identification')), this.now, this.bar,
      scrollable('scroll', 'Nights', h('table', { class: 'at' },
        h('thead', {}, h('tr', {}, HEAD.map((text) => h('th', { scope: 'col' }, text)))), this.body)),
      this.problems);
  }

  /** Ask for the last nights; a site where nobody identifies a fleet has none, and no panel. */
  async load() {
    const { items } = await call('/fleet/nights', { query: { limit: MOST_NIGHTS } });
    this.element.hidden = !items.length;
    if (items.length) this.show(items);
  }

  show(items) {
    const [last] = items;
    const looked = last.asked - last.left;
    const running = last.state === 'running';
    this.bar.hidden = !running;
    this.bar.value = last.asked ? looked / last.asked : 1;
    setText(this.now, running
      ? `The night of ${last.night} is running (${last.assets}): ${looked} of ${plural(last.asked, 'asset')}, `
        + `on ${plural(last.workers, 'worker')}.`
      : last.left ? `The night of ${last.night} has ${plural(last.left, 'asset')} left. `
        + 'The next “bearing-twin fleet identify” goes on with them.' : '');
    put(this.body, items.map(row));
    put(this.problems, Object.entries(last.problems).map(([asset, why]) => h('li', {}, `${asset}: ${why}`)));
  }
}

function row(night) {
  const each = night.processor_seconds_per_machine;
  const begun = milliseconds(night.began_at);
  const cells = {
    State: `${STATES[night.state]}${night.workers_lost ? `, ${plural(night.workers_lost, 'worker')} lost` : ''}`,
    Done: `${night.done} of ${night.asked}`, Refused: night.refused, Failed: night.failed,
    Skipped: night.without_new_data
      ? `${night.skipped} (${night.without_new_data} without new data)` : night.skipped,
    Left: night.left, 'Processor time': spanText(night.processor_seconds),
    'Per machine': each === null ? '–' : `${fixed(each, 2)} s`,
  };
  return h('tr', { 'data-night': night.night },
    h('td', {}, h('b', {}, night.night), h('span', { class: 'id mut' }, night.assets, ', since ',
      timeElement(begun, dayTimeSecond(begun)))),
    Object.entries(cells).map(([name, value]) =>
      h('td', {}, h('span', { class: 'lb' }, `${name}: `), String(value))));
}
