// The key of the service becomes a session cookie of this browser; the key itself is not kept.
import { call, currentSession } from './api.js';
import { logo } from '../parts/icons.js';
import { draw, form, Panel, place, v } from '../parts/panel.js';

const PREFIX_LENGTH = 'bt_00000000'.length;

// The cookie is hidden from scripts; without this mark there is no session to be asked for.
const MARK = 'session';

async function logIn(key) {
  await call('/session', { method: 'POST', body: { key } });
  localStorage.setItem(MARK, 'open');
}

export async function logOut() {
  await call('/session', { method: 'DELETE' }).catch((error) => {
    if (error.status !== 401) throw error; // it has ended already
  });
  localStorage.removeItem(MARK);
}

let linkedKey = null; // kept while the service does not answer

function takeKey() {
  const key = new URLSearchParams(location.hash.slice(1)).get('key') ?? '';
  if (key) history.replaceState(null, '', `${location.pathname}${location.search}`);
  return key;
}

/**
 * Take `#key=…` out of address bar and history, and log in with it once; resolves with the key where
 * a user is asked before: a link on another site must not make a user act in another's name.
 */
export async function logInFromAddress() {
  linkedKey ??= takeKey();
  const key = linkedKey;
  // The form is shown only where there is no session.
  if (!key || document.documentElement.dataset.opened !== 'by-hand') return key;
  if (localStorage.getItem(MARK) && await currentSession()) return '';
  try {
    await logIn(key);
  } catch (error) {
    if (error.status === 0) throw error;
  }
  return '';
}

/**
 * Ask for a key above a page that stays as it is until then; resolves with the session, null where the
 * service does not say whose it is.
 */
export async function logInAbove(reason) {
  const dialog = document.createElement('dialog');
  dialog.setAttribute('aria-label', 'Log in');
  document.body.append(dialog);
  // Escape would close it, or what lies below; nothing here can be done without a session.
  dialog.setAttribute('closedby', 'none');
  dialog.addEventListener('keydown', (event) => event.key === 'Escape' && event.preventDefault());
  dialog.addEventListener('close', () => dialog.isConnected && dialog.showModal());
  dialog.showModal();
  await new Promise((done) => { place(dialog, Login, { reason, offered: '', done }); });
  draw(dialog);
  dialog.remove();
  return currentSession().catch(() => null);
}

/** reason: why the form is there again; offered: a key that came with a link; done(): a key was accepted. */
export class Login extends Panel {
  componentDidMount() {
    this.key.focus();
  }

  render({ reason, offered }) {
    return form({ class: 'panel login' }, () => this.submit(),
      v('div', { class: 'brand' }, logo(), v('h1', {}, 'Bearing Twin')),
      offered && v('p', { class: 's' }, 'This link contains the key ', v('code', {}, offered.slice(0, PREFIX_LENGTH)),
        '. Log in with it only if you know where the link comes from.'),
      v('label', { for: 'key' }, 'Access key'), v('input', {
        id: 'key', name: 'key', type: 'password', autocomplete: 'current-password', required: true,
        spellcheck: false, defaultValue: offered, ref: (key) => { this.key = key; },
      }), v('p', { class: 'problem', role: 'alert' }, this.problem ?? reason),
      v('button', { class: 'btn pri', disabled: this.isSending }, 'Log in'),
      v('p', { class: 's mut' }, 'An administrator creates keys on the server with ',
        v('code', {}, 'bearing-twin keys create --role operator'), '.'));
  }

  async submit() {
    this.set({ isSending: true, problem: '' });
    try {
      await logIn(this.key.value.trim());
      this.props.done();
    } catch (error) {
      const wrong = error.status === 401 || error.status === 403 || error.status === 422;
      this.problem = wrong ? 'This key is not known or no longer valid. Ask your administrator.'
        : `Cannot log in: ${error.message}.`;
      this.key.select();
    }
    this.set({ isSending: false });
  }
}
