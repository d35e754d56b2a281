// A list of alarms whose rows stay in place while their texts change, so that no press is lost.
import { showAlarm } from './alarm_dialog.js';
import {
  detailText, isAside, needsAcknowledge, raisedMs, ranked, stateOf, symbol, whoOf,
} from './alarms.js';
import { bold, h, put, setText } from './dom.js';
import { dayOrTime, joined, timeElement } from './format.js';
import { isActive, isDistrust } from './readings.js';

export class AlarmList {
  /**
   * desk: what may be done; options: { chosen: a Set of ids, which gives every row that can be
   * acknowledged a box to tick, onChoice(): called when it was ticked, nameOf(alarm): name of its
   * asset where that is to be shown, else '' }.
   */
  constructor(box, desk, options = {}) {
    this.desk = desk;
    this.options = options;
    this.list = h('ul', { class: `alist${options.chosen ? ' choice' : ''}` });
    this.empty = h('p', { class: 'mut s pad' }, 'No alarms.');
    this.rows = new Map();
    put(box, this.list, this.empty);
  }

  /** alarms: a Map by id; live(alarm): the present values of its asset's forecast and sensor. */
  update(alarms, live) {
    const shown = ranked(alarms);
    this.empty.hidden = shown.length > 0;
    const rows = new Map();
    for (const alarm of shown) {
      const row = this.rows.get(alarm.id) ?? this.createRow();
      rows.set(alarm.id, row);
      this.updateRow(row, alarm, live(alarm));
    }
    const order = [...rows.values()].map((row) => row.element);
    const same = order.length === this.list.children.length
      && order.every((element, i) => this.list.children[i] === element);
    if (!same) this.list.replaceChildren(...order);
    this.rows = rows;
  }

  createRow() {
    const row = { alarm: null, key: null, action: null };
    row.symbol = h('span', {});
    row.message = bold();
    row.detail = h('span', {});
    row.state = h('span', { class: 'stt' });
    row.since = h('span', { class: 'mut' });
    row.button = h('button', {
      class: 'btn sm', type: 'button', onclick: () => this.desk.take(row.action, row.alarm),
    });
    row.more = h('button', {
      class: 'btn sm more', type: 'button', onclick: () => showAlarm(this.desk, row.alarm),
    }, '⋯');
    row.tick = this.options.chosen && h('input', {
      type: 'checkbox', onchange: () => this.choose(row),
    });
    row.element = h('li', {}, row.tick && h('span', { class: 'tk' }, row.tick), row.symbol,
      h('div', { class: 'm' }, row.message, row.detail),
      h('div', { class: 'st' }, row.state, row.since),
      h('div', { class: 'ac' }, row.button, row.more));
    return row;
  }

  choose(row) {
    const { chosen, onChoice } = this.options;
    if (row.tick.checked) chosen.add(row.alarm.id);
    else chosen.delete(row.alarm.id);
    onChoice();
  }

  updateRow(row, alarm, live) {
    row.alarm = alarm;
    const detail = detailText(alarm, live);
    const name = this.options.nameOf?.(alarm);
    setText(row.message, joined(`${name ? `${name}: ` : ''}${alarm.message}`));
    setText(row.detail, alarm.predicted && isActive(alarm) ? `predicted ${detail}` : detail);
    this.updateControls(row, alarm);
    const { text } = stateOf(alarm);
    const sinceText = dayOrTime(raisedMs(alarm), live.nowMs);
    const key = [alarm.state, alarm.priority, sinceText, whoOf(alarm)].join();
    if (key === row.key) return;
    row.key = key;
    const kind = isDistrust(alarm) ? 'pbad' : `p${alarm.priority}`;
    row.element.className = `al ${alarm.state} ${kind}${isAside(alarm) ? ' aside' : ''}`;
    row.element.dataset.alarm = alarm.id;
    row.element.dataset.state = alarm.state;
    put(row.symbol, symbol(alarm, '1.7em')).className = alarm.state === 'UNACK' ? 'blink' : '';
    setText(row.state, text);
    const who = whoOf(alarm);
    put(row.since, timeElement(raisedMs(alarm), sinceText), who ? ` · ${who}` : '');
  }

  updateControls(row, alarm) {
    const [first] = this.desk.actionsOf(alarm);
    row.action = first;
    setText(row.button, first === 'acknowledge' ? 'Ack' : this.desk.text(first));
    row.button.setAttribute('aria-label', `${this.desk.text(first)}: ${alarm.message}`);
    row.more.setAttribute('aria-label', `More on: ${alarm.message}`);
    refuse(row.button, this.desk.refusal(first, alarm));
    refuse(row.more, this.desk.away());
    if (!row.tick) return;
    row.tick.hidden = !needsAcknowledge(alarm);
    row.tick.checked = this.options.chosen.has(alarm.id);
    row.tick.setAttribute('aria-label', `Select: ${alarm.message}`);
    refuse(row.tick, this.desk.refusal('acknowledge', alarm));
  }
}

/** Disable a control while there is a reason to, and show the reason. */
export function refuse(control, reason) {
  control.disabled = Boolean(reason);
  control.title = reason;
}
