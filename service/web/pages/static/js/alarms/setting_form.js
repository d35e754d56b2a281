// One alarm's settings in a dialog, and what a change of settings would do.
import { openDialog, reasonField } from '../parts/dialogs.js';
import { NumberField, readNumber } from '../parts/number_field.js';
import { options, table, v } from '../parts/panel.js';

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

const HAS_UNIT = ['setpoint', 'deadband'];

/** @param {any[]} one */
function control([field, , kind], value, ofUnit) {
  const given = { id: `setting-${field}`, name: field };
  if (kind === 'yes' || kind === 'status') {
    const words = kind === 'yes' ? ['yes', 'no'] : STATUSES;
    return v('select', given, options(words.map((one) => [one, one]), shown(value)));
  }
  if (kind === 'long') return v('textarea', { ...given, rows: 2, maxlength: LONGEST, defaultValue: value });
  if (kind === 'number' || kind === 'whole') {
    const unit = HAS_UNIT.includes(field) ? ofUnit : field.endsWith('_s') ? 's' : '';
    return v(NumberField, { ...given, whole: kind === 'whole', unit, value });
  }
  return v('input', { ...given, type: kind, defaultValue: value ?? '', maxlength: LONGEST });
}

function valueOf(kind, text) {
  if (kind === 'yes') return text === 'yes';
  if (text.trim() === '') return null;
  return kind === 'number' || kind === 'whole' ? readNumber(text).value : text.trim().replace(/\s+/g, ' ');
}

export async function askSettings(row) {
  const offered = FIELDS.filter(([field]) => !HAS_UNIT.includes(field) || row[field] !== null);
  const { value, data } = await openDialog({
    title: row.description,
    look: 'wide',
    body: [
      v('p', { class: 's mut' }, 'An empty field brings back the value of the configuration. '
        + `Time to respond: ${row.time_basis}.`),
      v('div', { class: 'settings' }, offered.map((one) => {
        const [field, label, kind] = one;
        const unit = HAS_UNIT.includes(field) && row.unit ? `, ${row.unit}` : '';
        return v('div', { class: kind === 'long' ? 'whole' : null },
          v('label', { for: `setting-${field}` }, `${label}${unit}`), control(one, row[field], row.unit ?? ''));
      })),
      reasonField('Reason (goes to the history)', 'setting-comment', 'comment'),
    ],
    confirm: 'Check the change',
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
export const differenceTable = (differences) => table('Differences', [
  ['Alarm', (one) => [one.asset, one.kind, one.tag, one.level].filter(Boolean).join(', ')],
  ['Field', (one) => one.field.replaceAll('_', ' ')],
  ['Now', (one) => shown(one.before), 'why'], ['Then', (one) => shown(one.after), 'why'],
], differences, { look: 'st' });

/** Alarms that are there now and that a change ends or makes less urgent. */
export const silencesNote = (silences) => silences.length > 0 && v('p', { class: 'problem' },
  `This ends, or makes less urgent, alarms that are active now: ${silences.map((one) =>
    `${one.asset}: ${one.message} (priority ${one.priority})`).join('; ')}.`);

export const confirmChange = async ({ differences, silences }) => (await openDialog({
  title: 'Change these settings?', look: 'wide', body: [silencesNote(silences), differenceTable(differences)],
  confirm: 'Change',
})).value === 'ok';
