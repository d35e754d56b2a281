// Dialogs: they explain an action and ask for its input. Escape and Cancel change nothing.
import { wholeSpan } from './format.js';
import { NumberField, readNumber } from './number_field.js';
import { choice, draw, newId, nodesOf, options, Panel, v } from './panel.js';

const SHELVE_MINUTES = [15, 30, 60, 120, 240, 480];
const SHELVE_MOST_MIN = 480;
const SILENCE_MOST_MIN = 10080;

/**
 * Open a dialog; resolves with { value ('' for Escape), data (fields by name) } of its button.
 * parts: { title, body, look, confirm (text of the button next to Cancel) or buttons }.
 * @param {Page.Dialog} parts
 * @returns {Promise<any>}
 */
export function openDialog({ title, body, confirm, buttons, look = '' }) {
  const heading = newId('dialog-title');
  const dialog = document.createElement('dialog');
  dialog.className = look;
  dialog.setAttribute('aria-labelledby', heading);
  draw(dialog, v('form', { method: 'dialog' }, v('h3', { id: heading }, title), body,
    v('menu', {}, buttons ?? [cancel(), v('button', { class: 'btn pri', value: 'ok' }, confirm)])));
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener('close', () => {
      const data = Object.fromEntries(new FormData(dialog.querySelector('form')));
      draw(dialog);
      dialog.remove();
      resolve({ value: dialog.returnValue, data });
    });
  });
}

// No submit button: Enter in a field is for the button that does what the dialog asks for.
const cancel = () => v('button', {
  class: 'btn', type: 'button', onclick: ({ target }) => target.closest('dialog').close(''),
}, 'Cancel');
/** A text that a dialog asks for. */
export const reasonField = (label, id = 'reason', name = id, title = 'short reason') => [
  v('label', { for: id }, label),
  v('input', { id, name, required: true, maxlength: 500, pattern: '.*\\S.*', title })];

class Duration extends Panel {
  render({ id, label, most, spans = [] }) {
    const common = [...SHELVE_MINUTES.map((minutes) => [wholeSpan(minutes * 60), minutes]), ...spans];
    return [v('label', { for: id }, label),
      v('div', { class: 'row' }, v(NumberField, { id, name: 'minutes', least: 1, most, whole: true, unit: 'min',
        required: true, value: this.minutes, oninput: (minutes) => this.set({ minutes }) }),
      choice('Common durations', common.map(([text, minutes]) => [minutes, text]), undefined, (minutes) =>
        this.set({ minutes })))];
  }
}

export async function askReason({ title, text, action, label = 'Reason (goes to the journal)' }) {
  const { value, data } = await openDialog({ title, body: [v('p', {}, text), reasonField(label)], confirm: action });
  return value === 'ok' ? data.reason.trim() : null;
}

export async function askShelve(message) {
  const { value, data } = await openDialog({
    title: `Shelve: ${message}`,
    body: [
      v('p', {}, 'The alarm is off for this time. It returns automatically.'),
      v(Duration, { id: 'shelve-minutes', most: SHELVE_MOST_MIN,
        label: 'Duration in minutes (required, at most 8 h)' }),
      reasonField('Reason (goes to the journal)'),
    ],
    confirm: 'Shelve',
  });
  if (value !== 'ok') return null;
  return { duration_s: readNumber(data.minutes).value * 60, comment: data.reason.trim() };
}

/**
 * Whose alarms are silenced, for how long and why; resolves with { assets, minutes, comment },
 * or with null. assets: [[id, name]]; current: id of the one that is offered first; steps: spans of
 * its plan, [[text, minutes]].
 */
export async function askSilence(assets, current, steps) {
  const { value, data } = await openDialog({
    title: 'Silence',
    body: [
      v('p', {}, 'No e-mail or webhook is sent for these alarms in this time. They are raised and '
        + 'listed as usual. For alarms still active at the end one is sent then.'),
      v('label', { for: 'silence-asset' }, 'Alarms of'),
      v('select', { id: 'silence-asset', name: 'asset' }, options([['', 'all assets'], ...assets], current)),
      v(Duration, { id: 'silence-minutes', most: SILENCE_MOST_MIN, spans: steps, label: 'Duration in minutes '
        + '(required, at most 7 days; of all assets 1 day, longer asks for an engineer)' }),
      reasonField('Reason (everyone can read it)'),
    ],
    confirm: 'Silence',
  });
  return value !== 'ok' ? null : { assets: data.asset ? [data.asset] : [], minutes: readNumber(data.minutes).value,
    comment: data.reason.trim() };
}

/** A short word at the foot of the page about something that did not work. */
export function notify(text) {
  document.querySelector('.note')?.remove();
  document.body.append(nodesOf(v('div', { class: 'note', role: 'alert' }, text)));
  const note = document.body.lastChild;
  setTimeout(() => note.remove(), 8000);
}
