// The worst active alarm; the bar keeps its place when there is none, so that nothing jumps.
import { refuse } from './alarm_list.js';
import {
  byUrgency, detailText, isAside, needsAcknowledge, raisedMs, symbol, worst,
} from './alarms.js';
import { h, put, setText } from './dom.js';
import { dayOrTime, joined, timeElement } from './format.js';
import { icon } from './icons.js';
import { isDistrust } from './readings.js';

/** Why there is no telling whether an alarm is there, or ''. */
function ignorance(states) {
  if (states.some(({ link }) => link.status === 'away')) return 'the service does not answer';
  const waiting = states.some(({ link, alarmsKnown }) => link.status !== 'live' || !alarmsKnown);
  return waiting ? 'loading' : '';
}

export class Banner {
  /** openWaiting(): show all alarms that wait for an acknowledgement. */
  constructor(box, desk, openWaiting) {
    this.box = box;
    this.desk = desk;
    this.symbol = h('span', {});
    this.message = h('span', { class: 'msg', role: 'status', 'aria-live': 'assertive' });
    this.detail = h('span', { class: 'msg' });
    this.since = h('span', { class: 'sub nw' });
    this.more = h('button', { class: 'sub nw more', type: 'button', onclick: openWaiting });
    this.aside = h('a', { class: 'sub nw', href: '#alarms' });
    const button = (name, text) => h('button', {
      class: 'btn', type: 'button', onclick: () => desk.take(name, this.alarm),
    }, text);
    this.acknowledge = button('acknowledge', 'Acknowledge');
    this.shelve = button('shelve', 'Shelve…');
    this.look = null;
    put(box, this.symbol, h('div', { class: 'grow' }, this.message, this.detail, this.since),
      this.more, this.aside, this.acknowledge, this.shelve);
  }

  /**
   * feeds: the assets whose alarms are meant; nameOf(alarm): name to show with the alarm, or '';
   * live(alarm): the present values of its asset's forecast and sensor; blind: a limit has no data;
   * states: { link, alarmsKnown } of all of which the alarms are meant.
   */
  update(feeds, { nameOf, live, blind, states = feeds.map(({ store }) => store.state) }) {
    const all = feeds.flatMap((feed) => [...feed.store.get('alarms').values()]);
    const alarm = feeds.map((feed) => worst(feed.store.get('alarms'))).filter(Boolean)
      .sort(byUrgency)[0] ?? null;
    this.alarm = alarm;
    this.updateRest(all, alarm);
    for (const [button, name] of [[this.acknowledge, 'acknowledge'], [this.shelve, 'shelve']]) {
      button.hidden = !alarm || (name === 'acknowledge' && !needsAcknowledge(alarm));
      if (alarm) refuse(button, this.desk.refusal(name, alarm));
    }
    const unknown = ignorance(states);
    const look = alarm ? [alarm.id, alarm.state, alarm.priority].join()
      : ['quiet', unknown, blind].join();
    if (look !== this.look) this.changeLook(alarm, unknown, blind);
    this.look = look;
    if (!alarm) {
      setText(this.message, unknown ? `Alarms unknown: ${unknown}`
        : blind ? 'Limit alarms not available: no data' : 'No active alarms');
      setText(this.detail, '');
      put(this.since);
      this.sinceKey = null;
      return;
    }
    const now = live(alarm);
    const name = nameOf(alarm);
    setText(this.message, joined(`${unknown ? 'LAST KNOWN ' : ''}${name ? `${name}: ` : ''}`
      + `${alarm.predicted ? 'PREDICTED ' : ''}${alarm.message}`));
    setText(this.detail, unknown ? '' : `${alarm.predicted ? ', ' : '  '}${detailText(alarm, now)}`);
    this.updateSince(alarm, dayOrTime(raisedMs(alarm), now.nowMs), look);
  }

  updateSince(alarm, text, look) {
    if (this.sinceKey === look + text) return;
    this.sinceKey = look + text;
    const state = alarm.state === 'UNACK' ? 'unacknowledged' : 'acknowledged';
    put(this.since, `  ·  ${state} since `, timeElement(raisedMs(alarm), text));
  }

  /** The other alarms that wait. */
  updateRest(all, alarm) {
    const others = all.filter((one) => needsAcknowledge(one) && one.id !== alarm?.id).length;
    setText(this.more, alarm ? `+ ${others} more` : `${others} unacknowledged`);
    this.more.hidden = !others;
    const aside = all.filter(isAside).length;
    setText(this.aside, `${aside} suppressed`);
    this.aside.hidden = !aside || Boolean(alarm);
  }

  changeLook(alarm, unknown, blind) {
    delete this.box.dataset.p;
    if (!alarm) {
      this.box.className = `banner quiet${unknown ? ' unknown' : ''}`;
      const calm = icon(blind ? 'none' : 'ok');
      put(this.symbol, unknown ? icon('bad', 'current') : calm).className = '';
      return;
    }
    this.box.className = `banner${alarm.predicted ? ` pred pr${alarm.priority}` : ''}`;
    if (!alarm.predicted) this.box.dataset.p = isDistrust(alarm) ? 'bad' : alarm.priority;
    put(this.symbol, symbol(alarm, '2.3rem', true));
    this.symbol.className = alarm.state === 'UNACK' ? 'blink' : '';
  }
}
