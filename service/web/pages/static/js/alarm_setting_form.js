// One alarm's settings in a dialog, and what a change of settings would do.
import { h, scrollable } from './dom.js';
import { openDialog } from './dialogs.js';

// [field, label, kind]; kinds: number, whole, yes, text, long, status, date.
const FIELDS = [
  ['setpoint', 'Setpoint', 'number'], ['deadband', 'Deadband', 'number'],
  ['on_delay_s', 'On-delay, s', 'number'], ['off_delay_s', 'Off-delay, s', 'number'],
  ['priority', 'Priority, 1 (high) to 3', 'whole'], ['re_alarm_s', 'Re-alarm, s', 'number'],
  ['latched', 'Latched', 'yes'], ['enabled', 'Enabled', 'yes'],
  ['allowable_response_time_s', 'Allowable response time, s', 'number'], ['class', 'Class', 'text'],
  ['probable_causes', 'Probable causes', 'long'],
  ['consequence_of_inaction', 'Consequence of inaction', 'long'],
  ['operator_action', 'Operator action', 'long'],
  ['severity_of_consequence', 'Severity of consequence', 'text'],
  ['identification_method', 'Identification method', 'text'],
  ['status', 'Status', 'status'], ['rationalised_by', 'Rationalised by', 'text'],
  ['rationalised_at', 'Rationalised at', 'date'], ['remarks', 'Remarks', 'long'],
];
const STATUSES = ['default', 'proposed', 'approved'];
const LONGEST = 1000;

export const NAMES = ['asset', 'tag', 'kind', 'level'];
export const named = (row) => Object.fromEntries(NAMES.map((name) => [name, row[name]]));
export const shown = (value) => {
  if (value === true) return 'yes';
  if (value === false) return 'no';
  return value === null || value === '' ? '–' : String(value);
};

const cancel = () => h('button', {
  class: 'btn', type: 'button', onclick: ({ target }) => target.closest('dialog').close(''),
}, 'Cancel');

function control([field, , kind], value) {
  const id = `setting-${field}`;
  if (kind === 'yes') {
    return h('select', { id, name: field },
      ['yes', 'no'].map((one) => h('option', { selected: shown(value) === one }, one)));
  }
  if (kind === 'status') {
    return h('select', { id, name: field },
      STATUSES.map((one) => h('option', { selected: value === one }, one)));
  }
  if (kind === 'long') return h('textarea', { id, name: field, rows: 2, maxlength: LONGEST }, value);
  const type = kind === 'whole' ? 'number' : kind;
  const more = type === 'number' ? { step: kind === 'whole' ? 1 : 'any', inputmode: 'decimal' }
    : { maxlength: LONGEST };
  return h('input', { id, name: field, type, value: value ?? '', ...more });
}

function valueOf(kind, text) {
  if (kind === 'yes') return text === 'yes';
  if (text.trim() === '') return null;
  return kind === 'number' || kind === 'whole' ? Number(text) : text.trim().replace(/\s+/g, ' ');
}

/** Ask how an alarm is to be; resolves with the body of the change, or null. */
export async function askSettings(row) {
  const offered = FIELDS.filter(([field]) =>
    !['setpoint', 'deadband'].includes(field) || row[field] !== null);
  const { value, data } = await openDialog({
    title: row.description,
    look: 'wide',
    body: [
      h('p', { class: 's mut' }, 'An empty field brings back the value of the configuration. '
        + `Time to respond: ${row.time_basis}.`),
      h('div', { class: 'settings' }, offered.map((one) => {
        const [field, label, kind] = one;
        const unit = ['setpoint', 'deadband'].includes(field) && row.unit ? `, ${row.unit}` : '';
        return h('div', { class: kind === 'long' ? 'whole' : null },
          h('label', { for: `setting-${field}` }, `${label}${unit}`), control(one, row[field]));
      })),
      h('label', { for: 'setting-comment' }, 'Reason (goes to the history)'),
      h('input', { id: 'setting-comment', name: 'comment', required: true, maxlength: 500,
        pattern: '.*\\S.*', title: 'short reason' }),
    ],
    buttons: [cancel(), h('button', { class: 'btn pri', value: 'ok' }, 'Check the change')],
  });
  if (value !== 'ok') return null;
  const changes = {};
  for (const [field, , kind] of offered) {
    const wanted = valueOf(kind, data[field]);
    if (shown(wanted) !== shown(row[field])) changes[field] = wanted;
  }
  return { ...named(row), ...changes, comment: data.comment.trim() };
}

/** What a change would do, as a table; the same for one alarm and for a sheet. */
export function differenceTable(differences) {
  return scrollable('scroll', 'Differences', h('table', { class: 'st' },
    h('thead', {}, h('tr', {}, ['Alarm', 'Field', 'Now', 'Then'].map((text) =>
      h('th', { scope: 'col' }, text)))),
    h('tbody', {}, differences.map((one) => h('tr', {},
      h('td', {}, [one.asset, one.kind, one.tag, one.level].filter(Boolean).join(', ')),
      h('td', {}, one.field.replaceAll('_', ' ')), h('td', { class: 'why' }, shown(one.before)),
      h('td', { class: 'why' }, shown(one.after)))))));
}

/** Alarms that are there now and that a change ends or makes less urgent. */
export const silencesNote = (silences) => silences.length > 0 && h('p', { class: 'problem' },
  `This ends, or makes less urgent, alarms that are active now: ${silences.map((one) =>
    `${one.asset}: ${one.message} (priority ${one.priority})`).join('; ')}.`);

/** Show what would change; resolves with whether it shall. */
export async function confirmChange({ differences, silences }) {
  const { value } = await openDialog({
    title: 'Change these settings?',
    look: 'wide',
    body: [silencesNote(silences), differenceTable(differences)],
    buttons: [cancel(), h('button', { class: 'btn pri', value: 'ok' }, 'Change')],
  });
  return value === 'ok';
}
