// One alarm: its facts, its history, and the actions on it.
import { call } from '../app/api.js';
import { openDialog } from '../parts/dialogs.js';
import { channelName, isNumber, moment, percent, spanText, valueText } from '../parts/format.js';
import { Panel, unless, v } from '../parts/panel.js';
import { assetHash } from '../app/route.js';
import { assetsOf, stateOf, symbol, whoOf } from './alarm.js';
import { transitionText } from './journal.js';

const LINES = 20;
const figure = (value, unit) => (isNumber(value) ? valueText(value, unit) : null);

const assetLinks = (alarm) => v('div', { class: 'assets scroll' }, assetsOf(alarm).map((id) => [
  v('a', { href: assetHash('operator', id), onclick: ({ target }) => target.closest('dialog').close('') }, id), ' ']));

function facts(alarm) {
  const who = whoOf(alarm);
  return [
    ['State', stateOf(alarm).text.toLowerCase() + (who ? ` by ${who}` : '')],
    ['Priority', `${alarm.priority} of 3`],
    [assetsOf(alarm).length > 1 ? 'Assets' : 'Asset', assetLinks(alarm)],
    ['Kind', alarm.kind + (alarm.predicted ? ', predicted' : '')],
    ['Channel', alarm.channel && channelName(alarm.channel)],
    ['Value at last change', figure(alarm.value, alarm.unit)],
    ['Peak', alarm.peak && [figure(alarm.peak.value, alarm.unit), ', ', moment(alarm.peak.time)]],
    ['Duration', isNumber(alarm.duration_s) ? spanText(alarm.duration_s) : null],
    ['Limit', figure(alarm.limit_value, alarm.unit)],
    ['Earliest in', isNumber(alarm.lead_time_s) ? spanText(alarm.lead_time_s) : null],
    ['Probability', isNumber(alarm.probability) ? percent(alarm.probability) : null],
    ['Raised', moment(alarm.raised_at)],
    ['Returned', moment(alarm.returned_at)],
    ['Acknowledged', moment(alarm.acknowledged_at)],
    ['Shelved until', moment(alarm.shelved_until)],
    ['Suppressed', alarm.suppressed_reason],
    ['Last comment', alarm.comment],
  ].filter(([, value]) => value);
}

class AlarmPast extends Panel {
  constructor(attributes) {
    super(attributes);
    this.lines = 'Loading …';
    this.load(attributes.id);
  }

  async load(id) {
    await this.tried('The journal cannot be read', async () => {
      const { items } = await call('/alarms/journal', { query: { alarm: id, limit: LINES } });
      const lines = items.filter((line) => line.alarm_id === id).map((line) => v('li', {}, moment(line.time),
        ` ${transitionText(line)}`, line.who && ` by ${line.who}`, line.comment && v('q', {}, line.comment)));
      this.set({ lines: lines.length ? lines : 'No entries.' });
    }, (lines) => this.set({ lines }));
  }

  render() {
    return v('ol', { class: 'past' },
      typeof this.lines === 'string' ? v('li', { class: 'mut' }, this.lines) : this.lines);
  }
}

export async function showAlarm(desk, alarm) {
  const names = desk.actionsOf(alarm);
  const reasons = [...new Set(names.map((name) => desk.refusal(name, alarm)))].filter(Boolean);
  const { value } = await openDialog({
    title: [symbol(alarm, '1.5em'), ' ', alarm.message],
    body: [
      v('dl', { class: 'facts' }, facts(alarm).map(([name, fact]) => [v('dt', {}, name), v('dd', {}, fact)])),
      v('h4', {}, 'Alarm history'), v(AlarmPast, { id: alarm.id }),
      reasons.map((reason) => v('p', { class: 's mut' }, reason)),
    ],
    buttons: [names.map((name) => v('button', { class: 'btn', value: name, ...unless(desk.refusal(name, alarm)) },
      desk.text(name))), v('button', { class: 'btn pri', value: 'close' }, 'Close')],
    look: 'wide',
  });
  if (desk.actionsOf(alarm).includes(value)) await desk.take(value, alarm);
}
