// One alarm: its facts, its history, and the actions on it.
import { stateOf, symbol, whoOf } from './alarms.js';
import { call } from './api.js';
import { openDialog } from './dialogs.js';
import { h, put } from './dom.js';
import { channelName, dayTime, fixed, isNumber, milliseconds, percent, spanText, timeElement }
  from './format.js';
import { transitionText } from './journal.js';

const LINES = 20;

const at = (time) => (time ? timeElement(milliseconds(time), dayTime(milliseconds(time))) : null);
const figure = (value, unit) => (isNumber(value) ? `${fixed(value)} ${unit ?? '°C'}`.trim() : null);

function facts(alarm) {
  const who = whoOf(alarm);
  return [
    ['State', stateOf(alarm).text.toLowerCase() + (who ? ` by ${who}` : '')],
    ['Priority', `${alarm.priority} of 3`],
    ['Asset', alarm.asset],
    ['Kind', alarm.kind + (alarm.predicted ? ', predicted' : '')],
    ['Channel', alarm.channel && channelName(alarm.channel)],
    ['Value at last change', figure(alarm.value, alarm.unit)],
    ['Peak', alarm.peak && [figure(alarm.peak.value, alarm.unit), ', ', at(alarm.peak.time)]],
    ['Duration', isNumber(alarm.duration_s) ? spanText(alarm.duration_s) : null],
    ['Limit', figure(alarm.limit_value, alarm.unit)],
    ['Earliest in', isNumber(alarm.lead_time_s) ? spanText(alarm.lead_time_s) : null],
    ['Probability', isNumber(alarm.probability) ? percent(alarm.probability) : null],
    ['Raised', at(alarm.raised_at)],
    ['Returned', at(alarm.returned_at)],
    ['Acknowledged', at(alarm.acknowledged_at)],
    ['Shelved until', at(alarm.shelved_until)],
    ['Suppressed', alarm.suppressed_reason],
    ['Last comment', alarm.comment],
  ].filter(([, value]) => value);
}

/** The last lines of the journal about this alarm. */
async function showPast(list, alarm) {
  try {
    const { items } = await call('/alarms/journal', { query: { alarm: alarm.id, limit: LINES } });
    const mine = items.filter((line) => line.alarm_id === alarm.id);
    put(list, mine.map((line) => h('li', {}, at(line.time), ` ${transitionText(line)}`,
      line.who && ` by ${line.who}`, line.comment && h('q', {}, line.comment))));
    if (!mine.length) put(list, h('li', { class: 'mut' }, 'No entries.'));
  } catch (error) {
    put(list, h('li', { class: 'mut' }, `The journal cannot be read: ${error.message}.`));
  }
}

/** Open the dialog; an action closes it and is carried out. */
export async function showAlarm(desk, alarm) {
  const past = h('ol', { class: 'past' }, h('li', { class: 'mut' }, 'Loading …'));
  const buttons = desk.actionsOf(alarm).map((name) => {
    const reason = desk.refusal(name, alarm);
    return h('button', {
      class: 'btn', value: name, disabled: Boolean(reason), title: reason || null,
    }, desk.text(name));
  });
  const reasons = [...new Set(desk.actionsOf(alarm).map((name) => desk.refusal(name, alarm)))];
  const chosen = openDialog({
    title: [symbol(alarm, '1.5em'), ' ', alarm.message],
    body: [
      h('dl', { class: 'facts' }, facts(alarm).map(([name, value]) =>
        [h('dt', {}, name), h('dd', {}, value)])),
      h('h4', {}, 'Alarm history'), past,
      reasons.filter(Boolean).map((reason) => h('p', { class: 's mut' }, reason)),
    ],
    buttons: [...buttons, h('button', { class: 'btn pri', value: 'close' }, 'Close')],
    look: 'wide',
  });
  showPast(past, alarm);
  const { value } = await chosen;
  if (desk.actionsOf(alarm).includes(value)) await desk.take(value, alarm);
}
