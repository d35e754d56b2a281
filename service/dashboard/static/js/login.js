// The key of the service becomes a session cookie of this browser; the key itself is not kept.
import { call } from './api.js';
import { h, put } from './dom.js';
import { logo } from './icons.js';

const logIn = (key) => call('/session', { method: 'POST', body: { key } });

/** Who is logged in: { role, … }, or null. */
export async function currentSession() {
  try {
    return await call('/session');
  } catch (error) {
    if (error.status === 401) return null;
    throw error;
  }
}

export const logOut = () => call('/session', { method: 'DELETE' });

/** Log in once with `#key=…` of the address and take it out of the address bar and the history. */
export async function logInFromAddress() {
  const key = new URLSearchParams(location.hash.slice(1)).get('key');
  if (!key) return;
  history.replaceState(null, '', `${location.pathname}${location.search}`);
  try {
    await logIn(key);
  } catch (error) {
    if (error.status === 0) throw error;
  }
}

/** Show the form, with the reason why it is there again; resolves once a key was accepted. */
export function showLogin(main, reason = '') {
  const key = h('input', {
    id: 'key', name: 'key', type: 'password', autocomplete: 'current-password', required: true,
    spellcheck: 'false',
  });
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
      h('label', { for: 'key' }, 'Access key'), key, problem, button,
      h('p', { class: 's mut' }, 'A key is made on the machine of the service with ',
        h('code', {}, 'bearing-twin keys create --role operator'), '.')));
    key.focus();
  });
}
