// Notifications of alarms: the sound of this browser, e-mail and webhooks, and silences.
import { assetPath, call, callOptional } from '../app/api.js';
import { askSilence, notify } from '../parts/dialogs.js';
import { joined, moment } from '../parts/format.js';
import { button, gap, options, Panel, quiet, section, unless, v } from '../parts/panel.js';

const REFRESH_MS = 5000;
const TEST_MS = 60000;
const SOUNDS = [[0, 'No sound'], [1, 'Priority 1'], [2, 'Priorities 1 and 2'], [3, 'All priorities']];

export class NotificationsPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { notifications: [], silences: [], testing: new Set() });
    this.poll(REFRESH_MS, () => this.load());
  }

  async load() {
    await this.page.connection.guarded(async () => {
      const [notifications, silences] = await Promise.all([call('/notifications'), call('/silences')]);
      this.set({ notifications: notifications.items, silences: silences.items, isKnown: true });
    });
  }

  render() {
    const { sound } = this.page;
    const choose = ({ target }) => {
      sound.choose(Number(target.value));
      this.draw();
    };
    const list = (label, items, row) => items.length > 0
      && v('ul', { class: 'notices', 'aria-label': label }, items.map((one) => row(one)));
    return section('p-notifications', 'Notifications', [gap(),
      v('label', { class: 'chk', for: 'alarm-sound' }, 'Sound in this browser'),
      v('select', { id: 'alarm-sound', onchange: choose }, options(SOUNDS, sound.lowest)),
      button('Silence…', () => this.silence(), this.refused('operator'))],
    quiet(sound.waits && 'The browser makes no sound before you click on the page.', 'status'),
    list('Silences', this.silences, (one) => this.silenceRow(one)),
    list('Notifications', this.notifications, (one) => this.notificationRow(one)),
    this.isKnown && !this.notifications.length && v('p', { class: 'mut s pad', role: 'status' },
      'No notification is configured. Recipients are in the configuration, under [[notifications]].'));
  }

  refused(role, reason = '') {
    return unless(this.page.desk.whyOffline() || this.page.refusal(role) || reason);
  }

  notificationRow(one) {
    const isTested = this.testing.has(one.id);
    const of = [...one.assets.map((id) => this.page.nameOf(id)), ...one.families];
    return v('li', { 'data-notification': one.id, key: one.id },
      v('div', {}, v('b', {}, one.id),
        quiet(joined(`${one.kind === 'email' ? 'e-mail' : 'webhook'} to ${one.receivers.join(', ')}; `
          + (one.only_escalations ? 'only escalations' : `priority ${one.priorities.join(', ')}`)
          + (of.length ? `; ${of.join(', ')}` : '')))),
      v('div', { class: `s${one.failing_since ? ' problem' : ''}` }, stateOfNotification(one)),
      button(isTested ? 'Testing …' : 'Test', () => this.test(one.id), {
        'aria-label': isTested ? undefined : `Send a test to ${one.id}`,
        ...this.refused('engineer', isTested ? 'Testing' : ''),
      }));
  }

  silenceRow(one) {
    const whose = one.assets.map((id) => this.page.nameOf(id)).join(', ') || 'all assets';
    return v('li', { 'data-silence': one.id, key: one.id },
      v('div', {}, v('b', {}, `${one.in_force ? 'Silence' : 'Planned silence'}: ${whose}`),
        quiet(`${one.comment} (${one.who})`)),
      v('div', { class: 's' }, one.in_force ? '' : ['from ', moment(one.begins_at), ' '],
        'until ', moment(one.ends_at), one.weekly && `, ${weekly(one.weekly)}`),
      button('End', () => this.change('Not ended', `/silences/${encodeURIComponent(one.id)}`, { method: 'DELETE' }),
        { 'aria-label': `End the silence of ${whose}`, ...this.refused('operator') }));
  }

  async test(id) {
    this.testing.add(id);
    this.draw();
    const path = `/notifications/${encodeURIComponent(id)}:test`;
    const sent = await this.tried(`Test of ${id} failed`, () => call(path, { method: 'POST', timeoutMs: TEST_MS }),
      notify);
    if (sent) {
      notify(sent.told ? `Test of ${id} sent${sent.detail ? `, but ${sent.detail}` : ''}.`
        : `Test of ${id} failed: ${sent.detail}.`);
    }
    this.testing.delete(id);
    await this.load();
  }

  async silence() {
    const { assets, clock, live } = this.page;
    const names = assets.map(({ id, name }) => [id, name ?? id]);
    const asked = await askSilence(names, live?.assetId, await stepsOf(live?.assetId));
    if (!asked) return;
    const { minutes, ...body } = asked;
    const ends = new Date(clock.now() + minutes * 60000).toISOString();
    await this.change('Not silenced', '/silences', { method: 'POST', body: { ...body, ends_at: ends } });
  }

  async change(failure, path, request) {
    await this.tried(failure, () => call(path, request), notify);
    await this.load();
  }
}

/** Until the present step of an asset's plan ends, and until the plan does: [[text, minutes]]. */
async function stepsOf(id) {
  if (!id) return [];
  const asset = await callOptional(assetPath(id)).catch(() => null);
  const plan = asset?.controller?.plan ?? [];
  const minutes = plan.map((step) => step.duration_s / 60);
  const rounded = (some) => Math.max(1, Math.ceil(some.reduce((sum, one) => sum + one, 0)));
  return [['this step', minutes.slice(0, 1)], ['whole plan', minutes]]
    .filter(([, some]) => some.length).map(([text, some]) => [text, rounded(some)]);
}

const weekly = ({ days, begins, ends, time_zone: zone }) =>
  `${days.length ? days.join(', ') : 'daily'} ${begins} to ${ends} (${zone})`;

function stateOfNotification(one) {
  return [
    one.failing_since ? ['Fails since ', moment(one.failing_since), `: ${one.error}. `]
      : one.told_at ? ['Last sent ', moment(one.told_at), one.error ? `, but ${one.error}. ` : '. ']
        : 'Nothing sent since the start. ',
    one.waiting > one.held && `${one.waiting - one.held} waiting. `,
    one.given_up > 0 && `Refused for good: ${one.given_up} (see the journal). `,
    one.held > 0 && `${one.held} held back. `, one.quiet && 'Quiet hours now.',
  ];
}
