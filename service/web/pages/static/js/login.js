// The key of the service becomes a session cookie of this browser; the key itself is not kept.
import { call } from './api.js';
import { h, put } from './dom.js';
import { logo } from './icons.js';

const PREFIX_LENGTH = 'bt_00000000'.length;

// The cookie is hidden from scripts; without this mark there is no session to be asked for.
const MARK = 'session';

async function logIn(key) {
  await call('/session', { method: 'POST', body: { key } });
  localStorage.setItem(MARK, 'open');
}

/** Who is logged in: { role, … }, or null. */
export async function currentSession() {
  try {
    return await call('/session');
  } catch (error) {
    if (error.status === 401) return null;
    throw error;
  }
}

export async function logOut() {
  await call('/session', { method: 'DELETE' });
  localStorage.removeItem(MARK);
}

let linkedKey = null; // kept while the service does not answer

function takeKey() {
  const key = new URLSearchParams(location.hash.slice(1)).get('key') ?? '';
  if (key) history.replaceState(null, '', `${location.pathname}${location.search}`);
  return key;
}

/**
 * Take `#key=…` out of the address bar and the history, and log in with it once; resolves with the
 * key where somebody has to be asked before.
 *
 * A link on another site must not log anybody in unasked, nor end the session that there is: its
 * user would act in another's name.
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
 * Show the form, with the reason why it is there again and a key that came with a link; resolves
 * once a key was accepted.
 */
export function showLogin(main, reason = '', offered = '') {
  const key = h('input', {
    id: 'key', name: 'key', type: 'password', autocomplete: 'current-password', required: true,
    spellcheck: 'false', value: offered,
  });
  const asked = offered ? [h('p', { class: 's' },
    'This link contains the key ', h('code', {}, offered.slice(0, PREFIX_LENGTH)),
    '. Log in with it only if you know where the link comes from.')] : [];
  const problem = h('p', { class: 'problem', role: 'alert' }, reason);
  const button = h('button', { class: 'btn pri', type: 'submit' }, 'Log in');
  return new Promise((resolve) => {
    const submit = async (event) => {
      event.preventDefault();
      button.disabled = true;
      problem.textContent = '';
      try {
        await logIn(key.value.trim());
        resolve();
      } catch (error) {
        const wrong = error.status === 401 || error.status === 403 || error.status === 422;
        problem.textContent = wrong ? 'This key is not known or no longer valid. Ask your administrator.'
          : `Cannot log in: ${error.message}.`;
        key.select();
      } finally {
        button.disabled = false;
      }
    };
    put(main, h('form', { class: 'panel login', onsubmit: submit },
      h('div', { class: 'brand' }, logo(), h('h1', {}, 'Bearing Twin')),
      ...asked, h('label', { for: 'key' }, 'Access key'), key, problem, button,
      h('p', { class: 's mut' }, 'An administrator creates keys on the server with ',
        h('code', {}, 'bearing-twin keys create --role operator'), '.')));
    key.focus();
  });
}
