// One dialog for everything that changes the model: says what happens, asks why.
import { h } from './dom.js';

/** Ask for a reason; resolves with it, or with null when the user thinks better of it. */
export function askReason({ title, text, action }) {
  const reason = h('input', { id: 'reason', name: 'reason', required: true, maxlength: 500 });
  const dialog = h('dialog', { 'aria-labelledby': 'dialog-title' },
    h('form', { method: 'dialog' },
      h('h3', { id: 'dialog-title' }, title),
      h('p', {}, text),
      h('label', { for: 'reason' }, 'Reason (goes to the journal)'), reason,
      h('menu', {},
        h('button', { class: 'btn', value: 'cancel', formnovalidate: true }, 'Cancel'),
        h('button', { class: 'btn pri', value: 'ok' }, action))));
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener('close', () => {
      dialog.remove();
      resolve(dialog.returnValue === 'ok' ? reason.value : null);
    });
  });
}

/** A short word at the foot of the page about something that did not work. */
export function notify(text) {
  document.querySelector('.note')?.remove();
  const note = h('div', { class: 'note', role: 'alert' }, text);
  document.body.append(note);
  setTimeout(() => note.remove(), 8000);
}
