// Who is told of alarms: the sound of this browser, e-mail and webhooks, and silences.
import { refuse } from './alarm_list.js';
import { assetPath, call, callOptional } from './api.js';
import { askSilence, notify } from './dialogs.js';
import { bold, h, put, setText } from './dom.js';
import { dayTime, joined, milliseconds, timeElement } from './format.js';

const REFRESH_MS = 5000;
const TEST_MS = 60000;
const SOUNDS = [[0, 'No sound'], [1, 'Priority 1'], [2, 'Priorities 1 and 2'], [3, 'All priorities']];

export class ToldPanel {
  constructor(page) {
    this.page = page;
    this.sound = h('select', {
      id: 'alarm-sound', onchange: () => this.chooseSound(),
    }, SOUNDS.map(([value, text]) =>
      h('option', { value, selected: value === page.sound.lowest }, text)));
    this.soundNote = h('span', { class: 's mut', role: 'status' });
    this.add = h('button', { class: 'btn sm', type: 'button', onclick: () => this.silence() },
      'Silence…');
    this.silences = h('ul', { class: 'told', 'aria-label': 'Silences' });
    this.list = h('ul', { class: 'told', 'aria-label': 'Notifications' });
    this.note = h('p', { class: 'mut s pad', role: 'status' });
    this.element = h('section', { class: 'panel p-told' },
      h('header', {}, h('h2', {}, 'Who is told'), h('span', { class: 'sp' }),
        h('label', { class: 'chk', for: 'alarm-sound' }, 'Sound in this browser'), this.sound,
        this.add),
      this.soundNote, this.silences, this.list, this.note);
    this.testing = new Set();
    this.timer = setInterval(() => this.load(), REFRESH_MS);
    this.load();
    this.update();
  }

  destroy() {
    clearInterval(this.timer);
  }

  /** What may be pressed, and whether the sound works. */
  update() {
    const { desk, refusal, sound } = this.page;
    refuse(this.add, desk.away() || refusal('operator'));
    setText(this.soundNote, sound.waits ? 'The browser makes no sound before you click on the page.' : '');
    this.soundNote.hidden = !this.soundNote.textContent;
  }

  chooseSound() {
    this.page.sound.choose(Number(this.sound.value));
    this.update();
  }

  async load() {
    await this.page.connection.guarded(async () => {
      const [told, silent] = await Promise.all([call('/notifications'), call('/silences')]);
      this.show(told.items, silent.items);
    });
  }

  show(notifications, silences) {
    const at = document.activeElement?.dataset?.of;
    put(this.list, notifications.map((one) => this.notificationRow(one)));
    put(this.silences, silences.map((one) => this.silenceRow(one)));
    this.silences.hidden = !silences.length;
    this.list.hidden = !notifications.length;
    setText(this.note, notifications.length ? ''
      : 'Nobody is told by e-mail or webhook. The configuration names whom, under [[notifications]].');
    this.note.hidden = !this.note.textContent;
    if (at) this.element.querySelector(`[data-of="${CSS.escape(at)}"]`)?.focus();
  }

  notificationRow(one) {
    const { desk, refusal } = this.page;
    const button = h('button', {
      class: 'btn sm', type: 'button', 'data-of': `test ${one.id}`,
      'aria-label': `Send a test to ${one.id}`, onclick: () => this.test(one.id),
    }, this.testing.has(one.id) ? 'Testing …' : 'Test');
    refuse(button, desk.away() || refusal('engineer')
      || (this.testing.has(one.id) ? 'The test is under way.' : ''));
    const of = [...one.assets.map((id) => this.page.nameOf(id)), ...one.families];
    return h('li', { 'data-notification': one.id },
      h('div', {}, bold(one.id), h('span', { class: 's mut' },
        joined(`${one.kind === 'email' ? 'e-mail' : 'webhook'} to ${one.receivers.join(', ')}; `
          + (one.only_escalations ? 'only escalations' : `priority ${one.priorities.join(', ')}`)
          + (of.length ? `; ${of.join(', ')}` : '')))),
      h('div', { class: `s${one.failing_since ? ' problem' : ''}` }, stateOf(one)), button);
  }

  silenceRow(one) {
    const { desk, refusal } = this.page;
    const whose = one.assets.map((id) => this.page.nameOf(id)).join(', ') || 'all assets';
    const button = h('button', {
      class: 'btn sm', type: 'button', 'data-of': `end ${one.id}`,
      'aria-label': `End the silence of ${whose}`, onclick: () => this.end(one.id),
    }, 'End');
    refuse(button, desk.away() || refusal('operator'));
    const ends = milliseconds(one.ends_at);
    const begins = milliseconds(one.begins_at);
    return h('li', { 'data-silence': one.id },
      h('div', {}, bold(`${one.in_force ? 'Silence' : 'Planned silence'}: ${whose}`),
        h('span', { class: 's mut' }, `${one.comment} (${one.who})`)),
      h('div', { class: 's' }, one.in_force ? '' : ['from ', timeElement(begins, dayTime(begins)), ' '],
        'until ', timeElement(ends, dayTime(ends)), one.weekly ? `, ${weekly(one.weekly)}` : ''),
      button);
  }

  async test(id) {
    this.testing.add(id);
    await this.load();
    try {
      const path = `/notifications/${encodeURIComponent(id)}:test`;
      const { told, detail } = await call(path, { method: 'POST', timeoutMs: TEST_MS });
      notify(told ? `Test of ${id} sent${detail ? `, but ${detail}` : ''}.`
        : `Test of ${id} failed: ${detail}.`);
    } catch (error) {
      notify(`Test of ${id} failed: ${error.message}.`);
    } finally {
      this.testing.delete(id);
      this.load();
    }
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

  async end(id) {
    await this.change('Not ended', `/silences/${encodeURIComponent(id)}`, { method: 'DELETE' });
  }

  async change(failure, path, options) {
    try {
      await call(path, options);
    } catch (error) {
      notify(`${failure}: ${error.message}.`);
    }
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

function weekly({ days, begins, ends, time_zone: zone }) {
  return `${days.length ? days.join(', ') : 'daily'} ${begins} to ${ends} (${zone})`;
}

/** How a notification is, in words. */
function stateOf(one) {
  const parts = [];
  if (one.failing_since) {
    const since = milliseconds(one.failing_since);
    parts.push('Fails since ', timeElement(since, dayTime(since)), `: ${one.error}. `);
  } else if (one.told_at) {
    const at = milliseconds(one.told_at);
    parts.push('Told last ', timeElement(at, dayTime(at)), one.error ? `, but ${one.error}. ` : '. ');
  } else parts.push('Nothing told since the start. ');
  if (one.waiting > one.held) parts.push(`${one.waiting - one.held} waiting. `);
  if (one.held) parts.push(`${one.held} held back. `);
  if (one.quiet) parts.push('Quiet hours now.');
  return parts;
}
