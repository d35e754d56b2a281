// Dialogs: they explain an action and ask for its input. Escape and Cancel change nothing.
import { h } from './dom.js';
import { wholeSpan } from './format.js';

const SHELVE_MINUTES = [15, 30, 60, 120, 240, 480];
const SHELVE_MOST_MIN = 480;
const SILENCE_MOST_MIN = 10080;
let count = 0;

/**
 * Open a dialog; resolves with { value, data } of the button that closed it, value '' for Escape.
 *
 * parts: { title, body, buttons, look }; `data` holds the fields of the form by name.
 */
export function openDialog({ title, body, buttons, look = '' }) {
  count += 1;
  const heading = `dialog-title-${count}`;
  const form = h('form', { method: 'dialog' }, h('h3', { id: heading }, title), body,
    h('menu', {}, buttons));
  const dialog = h('dialog', { 'aria-labelledby': heading, class: look || null }, form);
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener('close', () => {
      const data = Object.fromEntries(new FormData(form));
      dialog.remove();
      resolve({ value: dialog.returnValue, data });
    });
  });
}

// No submit button: Enter in a field is for the button that does what the dialog asks for.
const cancel = () => h('button', {
  class: 'btn', type: 'button', onclick: ({ target }) => target.closest('dialog').close(''),
}, 'Cancel');
const confirm = (text) => h('button', { class: 'btn pri', value: 'ok' }, text);
const reasonField = (label) => [
  h('label', { for: 'reason' }, label),
  h('input', { id: 'reason', name: 'reason', required: true, maxlength: 500, pattern: '.*\\S.*',
    title: 'short reason' }),
];

/** Ask for a reason; resolves with it, or with null when the user thinks better of it. */
export async function askReason({ title, text, action, label = 'Reason (goes to the journal)' }) {
  const { value, data } = await openDialog({
    title, body: [h('p', {}, text), reasonField(label)], buttons: [cancel(), confirm(action)],
  });
  return value === 'ok' ? data.reason.trim() : null;
}

/** For how long and why; resolves with the body of the request, or with null. */
export async function askShelve(message) {
  const minutes = h('input', {
    id: 'shelve-minutes', name: 'minutes', type: 'number', min: 1, max: SHELVE_MOST_MIN, step: 1,
    required: true, inputmode: 'numeric',
  });
  const quick = SHELVE_MINUTES.map((one) => h('button', {
    type: 'button', onclick: () => { minutes.value = one; },
  }, wholeSpan(one * 60)));
  const { value, data } = await openDialog({
    title: `Shelve: ${message}`,
    body: [
      h('p', {}, 'The alarm is off for this time. It returns automatically.'),
      h('label', { for: 'shelve-minutes' }, 'Duration in minutes (required, at most 8 h)'),
      h('div', { class: 'row' }, minutes,
        h('span', { class: 'seg', role: 'group', 'aria-label': 'Common durations' }, quick)),
      reasonField('Reason (goes to the journal)'),
    ],
    buttons: [cancel(), confirm('Shelve')],
  });
  if (value !== 'ok') return null;
  return { duration_s: Number(data.minutes) * 60, comment: data.reason.trim() };
}

/**
 * Whose alarms nobody is told of, for how long and why; resolves with { assets, minutes, comment },
 * or with null. assets: [[id, name]]; current: id of the one that is offered first; steps: spans of
 * its plan, [[text, minutes]].
 */
export async function askSilence(assets, current, steps) {
  const minutes = h('input', {
    id: 'silence-minutes', name: 'minutes', type: 'number', min: 1, max: SILENCE_MOST_MIN, step: 1,
    required: true, inputmode: 'numeric',
  });
  const spans = [...SHELVE_MINUTES.map((one) => [wholeSpan(one * 60), one]), ...steps];
  const quick = spans.map(([text, one]) => h('button', {
    type: 'button', onclick: () => { minutes.value = one; },
  }, text));
  const { value, data } = await openDialog({
    title: 'Silence',
    body: [
      h('p', {}, 'Nobody gets e-mail or webhooks of these alarms for this time. They are raised and '
        + 'listed as ever; what still stands at the end is told then.'),
      h('label', { for: 'silence-asset' }, 'Alarms of'),
      h('select', { id: 'silence-asset', name: 'asset' },
        h('option', { value: '' }, 'all assets'),
        assets.map(([id, name]) => h('option', { value: id, selected: id === current }, name))),
      h('label', { for: 'silence-minutes' }, 'Duration in minutes (required, at most 7 days)'),
      h('div', { class: 'row' }, minutes,
        h('span', { class: 'seg', role: 'group', 'aria-label': 'Common durations' }, quick)),
      reasonField('Reason (everyone can read it)'),
    ],
    buttons: [cancel(), confirm('Silence')],
  });
  if (value !== 'ok') return null;
  return {
    assets: data.asset ? [data.asset] : [], minutes: Number(data.minutes), comment: data.reason.trim(),
  };
}

/** A short word at the foot of the page about something that did not work. */
export function notify(text) {
  document.querySelector('.note')?.remove();
  const note = h('div', { class: 'note', role: 'alert' }, text);
  document.body.append(note);
  setTimeout(() => note.remove(), 8000);
}
