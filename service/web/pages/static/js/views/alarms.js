// All alarms, their journal and how many there are.
import { AlarmList, refuse } from '../alarm_list.js';
import { isLimit, needsAcknowledge, summary } from '../alarms.js';
import { call } from '../api.js';
import { h, put, setText } from '../dom.js';
import { channelName, fixed } from '../format.js';
import { JournalPanel } from '../journal_panel.js';
import { isDistrust } from '../readings.js';
import { liveDetail } from '../situation.js';
import { fetchStyle } from '../styles.js';
import { ToldPanel } from '../told_panel.js';
import { WatchedPanel } from '../watched_panel.js';

const COUNT_EVERY_MS = 10000;
const FLOOD = 10;
const STALE_TARGET = 5;
// Which alarms the list shows: [name, whether an alarm belongs to it; asset: the one looked at].
const FILTERS = [
  ['all', () => true], ['limits', isLimit], ['data', isDistrust],
  ['this asset', (alarm, asset) => alarm.asset === asset],
];

export class AlarmsView {
  constructor(box, page) {
    this.page = page;
    this.several = page.assets.length > 1;
    this.chosen = new Set();
    [[, this.filter]] = FILTERS;
    this.filters = this.createFilters();
    this.count = h('span', { class: 's mut' });
    this.all = h('input', { type: 'checkbox', onchange: () => this.chooseAll() });
    this.bulk = h('button', { class: 'btn sm', type: 'button', onclick: () => this.acknowledge() });
    const list = h('div', { class: 'alarmbox' });
    this.list = new AlarmList(list, page.desk, {
      chosen: this.chosen, onChoice: () => this.update(),
      nameOf: (alarm) => (this.several ? page.nameOf(alarm.asset) : ''),
    });
    this.watched = new WatchedPanel(page);
    this.statistics = h('dl', { class: 'stats' });
    this.frequent = h('ol', { class: 'freq' });
    this.told = new ToldPanel(page);
    this.journal = new JournalPanel(page);
    put(box, h('h1', { class: 'vh' }, 'Alarms'),
      h('section', { class: 'panel p-alist' },
        h('header', {}, h('h2', {}, 'Alarms'), this.count, h('span', { class: 'sp' }),
          h('label', { class: 'chk' }, this.all, 'Select all unacknowledged'), this.bulk),
        h('div', { class: 'seg afilter', role: 'group', 'aria-label': 'Which alarms' },
          this.filters.map(({ button }) => button)), list,
        this.watched.element),
      h('section', { class: 'panel p-stat' },
        h('header', {}, h('h2', {}, 'Alarm performance')), this.statistics,
        h('h3', {}, 'Most frequent, last 24 h'), this.frequent),
      this.told.element, this.createSettings(), this.journal.element);
    const feeds = [...page.connection.feeds.values()];
    this.endings = feeds.map((feed) =>
      feed.store.on(['alarms', 'link', 'forecast'], () => this.update(), 250));
    this.timers = [setInterval(() => this.update(), 1000),
      setInterval(() => this.countAlarms(), COUNT_EVERY_MS)];
    this.update();
    this.countAlarms();
  }

  destroy() {
    this.timers.forEach(clearInterval);
    this.endings.forEach((end) => end());
    this.told.destroy();
    this.journal.destroy();
  }

  /** Settings of alarms: fetched when they are opened for the first time. */
  createSettings() {
    const inside = h('div', {});
    return h('details', { class: 'panel p-settings', ontoggle: async ({ target }) => {
      if (!target.open || this.settings) return;
      this.settings = true;
      try {
        const [{ AlarmSettings }] = await Promise.all([import('../alarm_settings.js'),
          fetchStyle('css/alarm_settings.css')]);
        this.settings = new AlarmSettings(inside, this.page);
      } catch {
        this.settings = null;
        put(inside, h('p', { role: 'alert' }, 'The settings cannot be fetched now. Close and open again.'));
      }
    } }, h('summary', {}, 'Alarm settings (rationalisation sheet)'), inside);
  }

  createFilters() {
    const offered = this.several ? FILTERS : FILTERS.filter(([name]) => name !== 'this asset');
    return offered.map(([name, belongs]) => {
      const count = h('span', { class: 'n' });
      const button = h('button', {
        type: 'button', onclick: () => { this.filter = belongs; this.update(); },
      }, name === 'this asset' ? this.page.nameOf(this.page.live.assetId) : name, ' ', count);
      return { button, count, belongs };
    });
  }

  /** Alarms of all assets that the filter lets through. */
  shown(belongs = this.filter) {
    const { assetId } = this.page.live;
    return this.page.connection.alarms().map(({ alarm }) => alarm)
      .filter((alarm) => belongs(alarm, assetId));
  }

  /** Those shown that wait for an acknowledgement. */
  waiting() {
    return this.shown().filter(needsAcknowledge);
  }

  update() {
    const { connection, clock, desk } = this.page;
    const alarms = new Map(connection.alarms().map(({ alarm }) => [alarm.id, alarm]));
    const live = new Map([...connection.feeds.values()].map((feed) =>
      [feed.assetId, liveDetail(feed.store.state, clock)]));
    const waiting = this.waiting();
    for (const id of this.chosen) if (!waiting.some((alarm) => alarm.id === id)) this.chosen.delete(id);
    this.list.update(new Map(this.shown().map((alarm) => [alarm.id, alarm])),
      (alarm) => live.get(alarm.asset));
    for (const { button, count, belongs } of this.filters) {
      button.setAttribute('aria-pressed', String(belongs === this.filter));
      setText(count, String(this.shown(belongs).length));
    }
    this.watched.leaveOut(alarms);
    this.told.update();
    setText(this.count, summary(alarms));
    setText(this.bulk, this.chosen.size ? `Acknowledge ${this.chosen.size} selected`
      : 'Acknowledge selected');
    const reason = desk.refusal('acknowledge');
    refuse(this.bulk, reason || (this.chosen.size ? '' : 'Select alarms first.'));
    refuse(this.all, reason || (waiting.length ? '' : 'Nothing to acknowledge.'));
    this.all.checked = waiting.length > 0 && this.chosen.size === waiting.length;
    this.all.indeterminate = this.chosen.size > 0 && this.chosen.size < waiting.length;
    const key = [...alarms.values()].map((alarm) =>
      [alarm.id, alarm.state, alarm.since, alarm.comment].join()).join();
    if (this.key !== undefined && key !== this.key) {
      this.journal.refresh();
      this.watched.refresh();
      this.countAlarms();
    }
    this.key = key;
  }

  chooseAll() {
    this.chosen.clear();
    if (this.all.checked) this.waiting().forEach((alarm) => this.chosen.add(alarm.id));
    this.update();
  }

  async acknowledge() {
    const chosen = this.waiting().filter((alarm) => this.chosen.has(alarm.id));
    this.bulk.disabled = true;
    await this.page.desk.acknowledgeAll(chosen);
    this.update();
  }

  async countAlarms() {
    await this.page.connection.guarded(async () => {
      const figures = await call('/alarms/statistics');
      const lines = [
        ['In the last 10 minutes', String(figures.last_10_min),
          figures.flood ? h('b', { class: 'chip badc' }, 'alarm flood') : `flood above ${FLOOD}`],
        ['Per 10 minutes, mean of 24 h', fixed(figures.per_10_min_average_24h, 2), 'target ≤ 1'],
        ['Standing alarms > 24 h', String(figures.stale_over_24h), `target < ${STALE_TARGET}`],
      ];
      put(this.statistics, lines.map(([name, figure, note]) => h('div', {},
        h('dt', {}, name), h('dd', {}, figure), h('dd', { class: 's mut' }, note))));
      put(this.frequent, figures.most_frequent.map(({ kind, channel, count }) => h('li', {},
        h('b', {}, String(count)), ` ${kind}`,
        channel && h('span', { class: 'mut' }, `, ${channelName(channel).toLowerCase()}`))));
      if (!figures.most_frequent.length) put(this.frequent, h('li', { class: 'mut' }, 'none'));
    });
  }
}
