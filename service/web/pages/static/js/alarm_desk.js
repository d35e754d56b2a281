// What people may do with alarms: who may, when it makes sense, what is asked, what is sent.
import { applyAlarm, isAside, needsAcknowledge } from './alarms.js';
import { call } from './api.js';
import { askReason, askShelve, notify } from './dialogs.js';

/** In the order of their buttons. `ask` gives the body of the request, or null for "not now". */
const ACTIONS = {
  acknowledge: {
    text: 'Acknowledge', role: 'operator', failure: 'Not acknowledged',
    applies: needsAcknowledge, ask: () => ({}),
  },
  unshelve: {
    text: 'Unshelve', role: 'operator', failure: 'Not unshelved',
    applies: (alarm) => alarm.state === 'SHLVD', ask: () => ({}),
  },
  'return-to-service': {
    text: 'Return to service', role: 'engineer', failure: 'Not returned to service',
    applies: (alarm) => alarm.state === 'OOSRV', ask: () => ({}),
  },
  reset: {
    text: 'Reset', role: 'operator', failure: 'Not reset',
    applies: (alarm) => alarm.state === 'LATCH', ask: () => ({}),
  },
  shelve: {
    text: 'Shelve…', role: 'operator', failure: 'Not shelved',
    applies: (alarm) => alarm.state === 'SHLVD' || !isAside(alarm),
    ask: (alarm) => askShelve(alarm.message),
  },
  comment: {
    text: 'Comment…', role: 'operator', failure: 'Comment not saved',
    applies: (alarm) => alarm.state !== 'NORM',
    ask: (alarm) => asComment(askReason({
      title: `Comment: ${alarm.message}`, text: 'Everyone who opens this alarm can read it.',
      label: 'Comment (goes to the journal)', action: 'Save comment',
    })),
  },
  'out-of-service': {
    text: 'Out of service…', role: 'engineer', failure: 'Not taken out of service',
    applies: (alarm) => alarm.state !== 'OOSRV',
    ask: (alarm) => asComment(askReason({
      title: `Out of service: ${alarm.message}`,
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

  /** Names of what makes sense for an alarm in its state, the nearest first. */
  actionsOf(alarm) {
    return Object.keys(ACTIONS).filter((name) => ACTIONS[name].applies(alarm));
  }

  text(name) {
    return ACTIONS[name].text;
  }

  /** Why nothing at all can be asked for now, or ''. */
  away() {
    return this.live.link.status === 'live' ? '' : 'The service does not answer.';
  }

  /** Why an action cannot be taken now, or ''. */
  refusal(name, alarm) {
    if (this.away()) return this.away();
    if (alarm && this.busy.has(alarm.id)) return 'Waiting for the service.';
    return this.roleRefusal(ACTIONS[name].role);
  }

  /** Ask for the input, send it, and show what the service confirms. */
  async take(name, alarm) {
    const body = await ACTIONS[name].ask(alarm);
    if (body === null) return;
    this.busy.add(alarm.id);
    this.refresh(alarm);
    try {
      const path = `/alarms/${encodeURIComponent(alarm.id)}/${name}`;
      this.confirm(await call(path, { method: 'POST', body }));
    } catch (error) {
      notify(`${ACTIONS[name].failure}: ${error.message}.`);
    } finally {
      this.busy.delete(alarm.id);
      this.refresh(alarm);
    }
  }

  /** Acknowledge several at once. */
  async acknowledgeAll(alarms) {
    alarms.forEach((alarm) => this.busy.add(alarm.id));
    try {
      const ids = alarms.map((alarm) => alarm.id);
      const answer = await call('/alarms/acknowledge', { method: 'POST', body: { ids } });
      answer.items.forEach((alarm) => this.confirm(alarm));
      if (answer.failed.length) {
        notify(`Not acknowledged: ${answer.failed.map((one) => one.detail).join('; ')}.`);
      }
    } catch (error) {
      notify(`Not acknowledged: ${error.message}.`);
    } finally {
      alarms.forEach((alarm) => this.busy.delete(alarm.id));
      if (alarms.length) this.refresh(alarms[0]);
    }
  }

  confirm(alarm) {
    const feed = this.live.feeds.get(alarm.asset);
    if (feed) applyAlarm(feed.store, alarm);
  }

  /** Have the lists look again: what may be pressed has changed. */
  refresh(alarm) {
    const store = this.live.feeds.get(alarm.asset)?.store;
    store?.set('alarms', store.get('alarms'));
  }
}
