// All alarms, their journal and how many there are.
// view: {"place": 80, "title": "Alarms", "from": "viewer", "of": "all", "style": false}
import { call } from '../app/api.js';
import { fetchStyle } from '../app/styles.js';
import { isDistrust } from '../live/readings.js';
import { fixed, isNumber, joined, lowerName, valueText } from '../parts/format.js';
import { button, choice, gap, Panel, quiet, section, tick, unless, v } from '../parts/panel.js';
import { assetsOf, isLimit, needsAcknowledge, summary } from './alarm.js';
import { JournalPanel } from './journal_panel.js';
import { AlarmList } from './list.js';
import { NotificationsPanel } from './notifications_panel.js';
import { icon } from '../parts/icons.js';

/** shown: the alarms that stand in the list above, a Map by id */
class WatchedPanel extends Panel {
  alarms = [];

  async refresh() {
    if (!this.isOpen) return;
    if (!this.alarms.length) this.set({ note: 'Loading …' });
    await this.tried('Cannot be read', async () => {
      const { items } = await call('/alarms', { query: { state: 'NORM' } });
      this.set({ alarms: items, note: items.length ? '' : 'No alarm is normal now.' });
    }, (note) => this.set({ alarms: [], note }));
  }

  render({ shown }) {
    const toggle = ({ target }) => {
      this.isOpen = target.open;
      this.refresh();
    };
    return v('details', { class: 'watched', ontoggle: toggle }, v('summary', {}, 'Normal (inactive) alarms'),
      v('p', { class: 's mut pad' }, 'Shelve one before work that would raise it, or take it out of service.'),
      this.note && v('p', { class: 'mut s pad', role: 'status' }, this.note),
      v('ul', { class: 'alist' }, this.alarms.filter(({ id }) => !shown.has(id)).map((alarm) => this.row(alarm))));
  }

  row(alarm) {
    const { assets, desk, nameOfAlarm } = this.page;
    const of = assets.length > 1 && nameOfAlarm(alarm);
    const name = of ? `${of}: ` : '';
    const value = isNumber(alarm.value) && !alarm.predicted
      ? `${alarm.kind}, ${valueText(alarm.value, alarm.unit)} at last change` : alarm.kind;
    const take = async (action) => {
      await desk.take(action, alarm);
      await this.refresh();
    };
    return v('li', { class: 'al NORM', 'data-alarm': alarm.id, 'data-state': 'NORM', key: alarm.id },
      v('span', {}, icon('none', 'filled', '1.5em')),
      v('div', { class: 'm' }, v('b', {}, joined(`${name}${alarm.message}`)),
        v('span', {}, joined(`priority ${alarm.priority}, ${value}`))),
      v('div', { class: 'ac' }, desk.actionsOf(alarm).map((action) => button(desk.text(action), () => take(action),
        { 'aria-label': `${desk.text(action)}: ${alarm.message}`, ...unless(desk.refusal(action, alarm)) }))));
  }
}

const COUNT_EVERY_MS = 10000;
const FLOOD = 10;
const STALE_TARGET = 5;
// Which alarms the list shows: [name, whether an alarm belongs to it; asset: the one looked at].
const FILTERS = [
  ['all', () => true], ['limits', isLimit], ['data', isDistrust],
  ['this asset', (alarm, asset) => assetsOf(alarm).includes(asset)],
];

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    this.chosen = new Set();
    [[, this.filter]] = FILTERS;
    for (const feed of this.page.connection.feeds.values()) {
      this.follow(feed.store, ['alarms', 'link', 'forecast'], 250);
    }
    this.every(1000);
    this.poll(COUNT_EVERY_MS, () => this.countAlarms());
  }

  async countAlarms() {
    await this.page.connection.guarded(async () => this.set({ figures: await call('/alarms/statistics') }));
  }

  componentDidUpdate() {
    if (this.countedChanges !== undefined && this.countedChanges !== this.changes) {
      this.watched?.refresh();
      this.countAlarms();
    }
    this.countedChanges = this.changes;
  }

  render() {
    const { page, chosen } = this;
    const { connection, desk } = page;
    const several = page.assets.length > 1;
    const alarms = connection.alarms();
    const byId = (some) => new Map(some.map((alarm) => [alarm.id, alarm]));
    const of = (belongs) => alarms.filter((alarm) => belongs(alarm, page.live.assetId));
    const shown = of(this.filter);
    const waiting = shown.filter(needsAcknowledge);
    for (const id of chosen) if (!waiting.some((alarm) => alarm.id === id)) chosen.delete(id);
    this.changes = alarms.map((alarm) => [alarm.id, alarm.state, alarm.since, alarm.comment].join()).join();
    const reason = this.isSending ? 'Waiting for the service.' : desk.refusal('acknowledge');
    const choose = (ids, isChosen) => {
      ids.forEach((id) => (isChosen ? chosen.add(id) : chosen.delete(id)));
      this.draw();
    };
    return [
      v('h1', { class: 'vh' }, 'Alarms'),
      section('p-alist', 'Alarms', [quiet(summary(byId(alarms))), gap(),
        v('label', { class: 'chk' }, tick(null, waiting.length > 0 && chosen.size === waiting.length,
          (isChosen) => choose(waiting.map(({ id }) => id), isChosen),
          { indeterminate: chosen.size > 0 && chosen.size < waiting.length,
            ...unless(reason || (waiting.length ? '' : 'Nothing to acknowledge.')) }), 'Select all unacknowledged'),
        button(chosen.size ? `Acknowledge ${chosen.size} selected` : 'Acknowledge selected',
          () => this.acknowledge(waiting.filter(({ id }) => chosen.has(id))),
          unless(reason || (chosen.size ? '' : 'Select alarms first.')))],
      choice('Which alarms', FILTERS.filter(([name]) => several || name !== 'this asset').map(([name, belongs]) =>
        [belongs, [name === 'this asset' ? page.nameOf(page.live.assetId) : name, ' ',
          v('span', { class: 'n' }, of(belongs).length)]]), this.filter, (filter) => this.set({ filter }), ' afilter'),
        v('div', { class: 'alarmbox' }, v(AlarmList, { desk, chosen, alarms: byId(shown),
          live: page.detailOf, onchoice: (id, isChosen) => choose([id], isChosen),
          nameOf: (alarm) => (several ? page.nameOfAlarm(alarm) : '') })),
        v(WatchedPanel, { page, shown: byId(alarms), ref: (panel) => { this.watched = panel; } })),
      section('p-stat', 'Alarm performance', null, this.statistics()),
      v(NotificationsPanel, { page, link: connection.link.status, waits: page.sound.waits }),
      v('details', { class: 'panel p-settings', ontoggle: ({ target }) => target.open && this.openSettings() },
        v('summary', {}, 'Alarm settings (rationalisation sheet)'), v('div', {}, this.settings ?? this.refusal)),
      v(JournalPanel, { page, changes: this.changes }),
    ];
  }

  statistics() {
    const { figures } = this;
    const lines = figures ? [
      ['In the last 10 minutes', figures.last_10_min,
        figures.flood ? v('b', { class: 'chip flood' }, 'alarm flood') : `flood above ${FLOOD}`],
      ['Per 10 minutes, mean of 24 h', fixed(figures.per_10_min_average_24h, 2), 'target ≤ 1'],
      ['Stale alarms > 24 h', figures.stale_over_24h, `target < ${STALE_TARGET}`],
    ] : [];
    return [
      v('dl', { class: 'stats' }, lines.map(([name, figure, note]) => v('div', {},
        v('dt', {}, name), v('dd', {}, figure), v('dd', { class: 's mut' }, note)))),
      v('h3', {}, 'Most frequent, last 24 h'),
      v('ol', { class: 'freq' }, figures?.most_frequent.map(({ kind, channel, count }) => v('li', {},
        v('b', {}, count), ` ${kind}`,
        channel && v('span', { class: 'mut' }, `, ${lowerName(channel)}`))),
      figures && !figures.most_frequent.length && v('li', { class: 'mut' }, 'none')),
    ];
  }

  async openSettings() {
    if (this.settings) return;
    try {
      const [{ AlarmSettings }] = await Promise.all([import('./settings.js'), fetchStyle('css/alarm_settings.css')]);
      this.set({ settings: v(AlarmSettings, { page: this.page }) });
    } catch {
      this.set({ refusal: v('p', { role: 'alert' }, 'The settings cannot be fetched now. Close and open again.') });
    }
  }

  async acknowledge(alarms) {
    this.set({ isSending: true });
    await this.page.desk.acknowledgeAll(alarms);
    this.set({ isSending: false });
  }
}
