// What people may do with alarms: who may, when it makes sense, what is asked, what is sent.
import { isAside, needsAcknowledge } from './alarm.js';
import { call } from '../app/api.js';
import { askReason, askShelve, notify } from '../parts/dialogs.js';

/**
 * In the order of their buttons. `ask` gives the body of the request, or null for "not now". An operator
 * may do what names no `role`.
 * @type {{ [name: string]: { text: string, failure: string, applies: Function, role?: string, ask?: Function } }}
 */
const ACTIONS = {
  acknowledge: { text: 'Acknowledge', failure: 'Not acknowledged', applies: needsAcknowledge },
  unshelve: { text: 'Unshelve', failure: 'Not unshelved', applies: ({ state }) => state === 'SHLVD' },
  'return-to-service': {
    text: 'Return to service', failure: 'Not returned to service', role: 'engineer',
    applies: ({ state }) => state === 'OOSRV',
  },
  reset: { text: 'Reset', failure: 'Not reset', applies: ({ state }) => state === 'LATCH' },
  shelve: {
    text: 'Shelve…', failure: 'Not shelved', applies: (alarm) => alarm.state === 'SHLVD' || !isAside(alarm),
    ask: ({ message }) => askShelve(message),
  },
  comment: {
    text: 'Comment…', failure: 'Comment not saved', applies: ({ state }) => state !== 'NORM',
    ask: ({ message }) => asComment(askReason({
      title: `Comment: ${message}`, text: 'Everyone who opens this alarm can read it.',
      label: 'Comment (goes to the journal)', action: 'Save comment',
    })),
  },
  'out-of-service': {
    text: 'Out of service…', failure: 'Not taken out of service', role: 'engineer',
    applies: ({ state }) => state !== 'OOSRV',
    ask: ({ message }) => asComment(askReason({
      title: `Out of service: ${message}`,
      text: 'The alarm is off until an engineer returns it to service.', action: 'Take out of service',
    })),
  },
};

async function asComment(asked) {
  const text = await asked;
  return text === null ? null : { comment: text };
}

export class AlarmDesk {
  /** live: the connection; refusal(role): why this user may not, or ''. */
  constructor(live, refusal) {
    this.live = live;
    this.roleRefusal = refusal;
    this.busy = new Set(); // alarms whose answer is under way
  }

  actionsOf(alarm) {
    return Object.keys(ACTIONS).filter((name) => ACTIONS[name].applies(alarm));
  }

  text(name) {
    return ACTIONS[name].text;
  }

  whyOffline() {
    return this.live.link.status === 'live' ? '' : 'The service does not answer.';
  }

  refusal(name, alarm) {
    if (this.whyOffline()) return this.whyOffline();
    if (alarm && this.busy.has(alarm.id)) return 'Waiting for the service.';
    return this.roleRefusal(ACTIONS[name].role ?? 'operator');
  }

  async take(name, alarm) {
    const { ask = () => ({}), failure } = ACTIONS[name];
    const body = await ask(alarm);
    if (body === null) return;
    await this.send([alarm], failure, async () =>
      this.live.takeAlarm(await call(`/alarms/${encodeURIComponent(alarm.id)}/${name}`, { method: 'POST', body })));
  }

  acknowledgeAll(alarms) {
    const failure = 'Not acknowledged';
    return this.send(alarms, failure, async () => {
      const ids = alarms.map(({ id }) => id);
      const { items, failed } = await call('/alarms/acknowledge', { method: 'POST', body: { ids } });
      items.forEach((alarm) => this.live.takeAlarm(alarm));
      if (failed.length) notify(`${failure}: ${failed.map(({ detail }) => detail).join('; ')}.`);
    });
  }

  /** Nothing else can be done with these alarms until the service has answered. */
  async send(alarms, failure, action) {
    alarms.forEach(({ id }) => this.busy.add(id));
    this.refresh(alarms[0]);
    try {
      await action();
    } catch (error) {
      notify(`${failure}: ${error.message}.`);
    } finally {
      alarms.forEach(({ id }) => this.busy.delete(id));
      this.refresh(alarms[0]);
    }
  }

  /** Have the lists look again: what may be pressed has changed. */
  refresh(alarm) {
    for (const { store } of this.live.feeds.values()) {
      if (alarm && store.get('alarms').has(alarm.id)) store.set('alarms', store.get('alarms'));
    }
  }
}
