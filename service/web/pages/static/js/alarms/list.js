// A list of alarms whose rows stay in place while their texts change, so that no press is lost.
import { dayOrTime, joined, timeElement } from '../parts/format.js';
import { button, Panel, tick, unless, v } from '../parts/panel.js';
import { isActive, isDistrust } from '../live/readings.js';
import {
  assetsOf, detailText, headline, isAside, needsAcknowledge, raisedMs, ranked, stateOf, symbol,
  whoOf,
} from './alarm.js';
import { showAlarm } from './dialog.js';
import { openDialog } from '../parts/dialogs.js';

/**
 * alarms: a Map by id; live(alarm): the present values of its asset's forecast and sensor; nameOf(alarm):
 * name of its asset, or ''; chosen: a Set of ids, where alarms can be chosen; onchoice(id, isChosen).
 */
export function AlarmList({ alarms, chosen, ...given }) {
  const rows = ranked(alarms).map((alarm) => alarmRow(alarm, given.live(alarm), { chosen, ...given }));
  return [v('ul', { class: `alist${chosen ? ' choice' : ''}` }, rows),
    !rows.length && v('p', { class: 'mut s pad' }, 'No alarms.')];
}

/** @param {any} parts */
function alarmRow(alarm, live, parts) {
  const { desk, chosen, onchoice, nameOf } = parts;
  const [first] = desk.actionsOf(alarm);
  const detail = detailText(alarm, live);
  const [name, who] = [nameOf?.(alarm), whoOf(alarm)];
  const many = assetsOf(alarm).length;
  const kind = isDistrust(alarm) ? 'pbad' : `p${alarm.priority}`;
  return v('li', { class: `al ${alarm.state} ${kind}${isAside(alarm) ? ' aside' : ''}`, key: alarm.id,
    'data-alarm': alarm.id, 'data-state': alarm.state },
  chosen && v('span', { class: 'tk' }, needsAcknowledge(alarm) && tick(`Select: ${headline(alarm)}`,
    chosen.has(alarm.id), (isChosen) => onchoice(alarm.id, isChosen), unless(desk.refusal('acknowledge', alarm)))),
  v('span', { class: alarm.state === 'UNACK' ? 'blink' : '' }, symbol(alarm, '1.7em')),
  v('div', { class: 'm' }, v('b', {}, joined(`${name ? `${name}: ` : ''}${headline(alarm)}`)),
    v('span', {}, alarm.predicted && isActive(alarm) ? `predicted ${detail}` : detail),
    many > 1 && button(`List of ${many} assets`, () => showAlarm(desk, alarm), { class: 'link s' })),
  v('div', { class: 'st' }, v('span', { class: 'stt' }, stateOf(alarm).text),
    v('span', { class: 'mut' }, timeElement(raisedMs(alarm), dayOrTime(raisedMs(alarm), live.nowMs)),
      who && ` · ${who}`)),
  v('div', { class: 'ac' },
    button(first === 'acknowledge' ? 'Ack' : desk.text(first), () => desk.take(first, alarm),
      { 'aria-label': `${desk.text(first)}: ${headline(alarm)}`, ...unless(desk.refusal(first, alarm)) }),
    button('⋯', () => showAlarm(desk, alarm),
      { class: 'btn sm more', 'aria-label': `More on: ${headline(alarm)}`, ...unless(desk.whyOffline()) })));
}

const UPDATE_MS = 500;

class Waiting extends Panel {
  constructor(attributes) {
    super(attributes);
    this.every(UPDATE_MS);
  }

  render({ alarms, ...given }) {
    const waiting = alarms().filter(needsAcknowledge);
    return [v('p', { class: 's mut', role: 'status' }, `${waiting.length} unacknowledged`),
      v('div', { class: 'alarmbox' },
        v(AlarmList, { ...given, alarms: new Map(waiting.map((alarm) => [alarm.id, alarm])) }))];
  }
}

export async function showWaiting(desk, given) {
  const { value } = await openDialog({
    title: 'Unacknowledged alarms', body: v(Waiting, { desk, ...given }), look: 'wide',
    buttons: [v('button', { class: 'btn', value: 'all' }, 'Alarms view'),
      v('button', { class: 'btn pri', value: 'close' }, 'Close')],
  });
  if (value === 'all') location.hash = '#alarms';
}
