// Alarms after ISA-18.2: the state is said by colour, by shape and by text.
import { call } from './api.js';
import { bold, h, put, setText } from './dom.js';
import { fixed, isNumber, joined, milliseconds, percent, spanText, timeElement } from './format.js';
import { icon } from './icons.js';
import { isActive, isDistrust } from './readings.js';

const STATES = {
  UNACK: ['UNACKNOWLEDGED', 'filled'],
  ACKED: ['ACKNOWLEDGED', 'filled'],
  RTNUN: ['RETURNED, UNACK', 'hollow'],
};
const ORDER = { UNACK: 0, ACKED: 1, RTNUN: 2 };

export const needsAcknowledge = (alarm) => alarm.state === 'UNACK' || alarm.state === 'RTNUN';
export const isShown = (alarm) => alarm.state in STATES;

const rank = (alarm) =>
  ORDER[alarm.state] * 100 + (alarm.predicted ? 10 : 0) + (isDistrust(alarm) ? 0 : alarm.priority);
const newest = (alarm) => -milliseconds(alarm.raised_at) / 1e15;

/** Alarms to show, the worst first. */
const ranked = (alarms) => [...alarms.values()].filter(isShown)
  .sort((a, b) => rank(a) + newest(a) - rank(b) - newest(b));

/** The alarm of the banner: active, and about the machine rather than about its sensors. */
export const worst = (alarms) =>
  ranked(alarms).find((alarm) => isActive(alarm) && !isDistrust(alarm)) ?? null;

export function summary(alarms) {
  const all = [...alarms.values()];
  return `${all.filter(isActive).length} active, ${all.filter(needsAcknowledge).length} to acknowledge`;
}

/**
 * What stands behind an alarm now: lead time and probability of a predicted one, the value of a
 * measured one. `live` says what forecast and sensor say this moment, newer than the alarm's own.
 */
export function detailText(alarm, live) {
  if (alarm.predicted && alarm.state === 'RTNUN') return 'no longer predicted';
  if (!alarm.predicted) {
    if (isDistrust(alarm)) return alarm.kind;
    const value = live.value(alarm.channel) ?? alarm.value;
    return isNumber(value) ? joined(`${fixed(value)} °C`) : alarm.kind;
  }
  const { probability, median, earliest } = live.crossing(alarm.channel, alarm.limit_level)
    ?? { probability: alarm.probability, median: alarm.lead_time_s };
  const parts = [];
  if (isNumber(median)) parts.push(`in ${spanText(median)}`);
  else if (isNumber(earliest)) parts.push(`earliest in ${spanText(earliest)}`);
  if (isNumber(probability)) parts.push(percent(probability));
  return joined(parts.join(' · '));
}

export function symbol(alarm, size, inverse = false) {
  if (isDistrust(alarm)) {
    return icon('bad', alarm.state === 'RTNUN' ? 'hollow' : 'filled', size);
  }
  if (alarm.predicted) return icon(alarm.priority, 'dashed', size);
  return icon(alarm.priority, inverse ? 'inverse' : STATES[alarm.state][1], size);
}

/** Acknowledge; the list changes only when the service has confirmed. */
export async function acknowledge(store, alarm) {
  const changed = await call(`/alarms/${encodeURIComponent(alarm.id)}/acknowledge`,
    { method: 'POST', body: {} });
  applyAlarm(store, changed);
}

/** Take in an alarm as the service tells it; one that is over and acknowledged leaves the list. */
export function applyAlarm(store, alarm) {
  const alarms = new Map(store.get('alarms'));
  if (isShown(alarm)) alarms.set(alarm.id, alarm);
  else alarms.delete(alarm.id);
  store.set('alarms', alarms);
}

/** A list whose rows stay in place while their texts change, so that no press is lost. */
export class AlarmList {
  constructor(box, { onAcknowledge, mayAcknowledge }) {
    this.list = h('ul', { class: 'alist' });
    this.empty = h('p', { class: 'mut s pad' }, 'No alarms.');
    this.onAcknowledge = onAcknowledge;
    this.mayAcknowledge = mayAcknowledge;
    this.rows = new Map();
    put(box, this.list, this.empty);
  }

  update(alarms, live, away) {
    const shown = ranked(alarms);
    this.empty.hidden = shown.length > 0;
    const rows = new Map();
    for (const alarm of shown) {
      const row = this.rows.get(alarm.id) ?? this.createRow();
      rows.set(alarm.id, row);
      this.updateRow(row, alarm, live);
      row.button.disabled = away || row.busy === true;
    }
    const order = [...rows.values()].map((row) => row.element);
    const same = order.length === this.list.children.length
      && order.every((element, i) => this.list.children[i] === element);
    if (!same) this.list.replaceChildren(...order);
    this.rows = rows;
  }

  createRow() {
    const row = { alarm: null, key: null };
    row.symbol = h('span', {});
    row.message = bold();
    row.detail = h('span', {});
    row.state = h('span', { class: 'stt' });
    row.since = h('span', { class: 'mut' });
    row.button = h('button', {
      class: 'btn sm', type: 'button', onclick: () => this.onAcknowledge(row.alarm, row.button),
    }, 'Ack');
    row.element = h('li', {}, row.symbol, h('div', { class: 'm' }, row.message, row.detail),
      h('div', { class: 'st' }, row.state, row.since), h('div', { class: 'ac' }, row.button));
    return row;
  }

  updateRow(row, alarm, live) {
    row.alarm = alarm;
    const detail = detailText(alarm, live);
    setText(row.message, joined(alarm.message));
    const predicted = alarm.predicted && alarm.state !== 'RTNUN';
    setText(row.detail, predicted ? `predicted ${detail}` : detail);
    row.button.hidden = !needsAcknowledge(alarm) || !this.mayAcknowledge();
    row.button.setAttribute('aria-label', `Acknowledge: ${alarm.message}`);
    const key = [alarm.state, alarm.priority, alarm.raised_at, alarm.acknowledged_by].join();
    if (key === row.key) return;
    row.key = key;
    const kind = isDistrust(alarm) ? 'pbad' : `p${alarm.priority}`;
    row.element.className = `al ${alarm.state} ${kind}`;
    row.element.dataset.alarm = alarm.id;
    row.element.dataset.state = alarm.state;
    put(row.symbol, symbol(alarm, '1.7em')).className = alarm.state === 'UNACK' ? 'blink' : '';
    setText(row.state, STATES[alarm.state][0]);
    const who = alarm.state === 'ACKED' && alarm.acknowledged_by;
    put(row.since, timeElement(milliseconds(alarm.raised_at)), who ? ` · ${who}` : '');
  }
}
