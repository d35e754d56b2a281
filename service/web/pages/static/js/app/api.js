// The REST interface, with the session cookie of the browser.
const PREFIX = '/api/v1';
const SAID_MAX = 6;
const SESSION = '/session'; // asking for it is how the page finds out who is logged in

let refusedKey = () => {};

/** Call `action` whenever the service refuses a request for want of a valid key. */
export function onRefusedKey(action) {
  refusedKey = action;
}

/**
 * A refused or failed request; `status` 0 means the service did not answer. `errors` has each thing
 * that is wrong, as { pointer, detail }.
 */
export class ApiError extends Error {
  constructor(status, message, errors = []) {
    super(message);
    this.status = status;
    this.errors = errors;
  }
}

/** What a problem says, each thing once and without places in a body that the user does not see. */
export function wordsOf({ detail, title, errors = [] }) {
  const said = [(detail ?? title ?? '').replace(/^\/\S*: /, '')];
  for (const error of errors) {
    if (error.detail && !said.some((text) => text.includes(error.detail))) said.push(error.detail);
  }
  const more = said.length - SAID_MAX;
  const [first, ...others] = said.slice(0, SAID_MAX);
  const rest = others.join('; ') + (more > 0 ? ` (and ${more} more)` : '');
  return [first, rest].filter(Boolean).join(detail ? '; ' : ': ');
}

async function describe(response) {
  try {
    const problem = await response.json();
    return [wordsOf(problem), problem.errors ?? []];
  } catch {
    return [`${response.status} ${response.statusText}`];
  }
}

/** Ask the service and `read` its answer where it is no refusal. Options as those of `call`. */
async function ask(path, options, read) {
  const { method = 'GET', body, file, query = {}, headers = {}, timeoutMs = 15000, signal } = options;
  const parameters = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    for (const one of [value].flat()) parameters.append(name, one);
  }
  const address = `${PREFIX}${path}${parameters.size ? `?${parameters}` : ''}`;
  const limits = [AbortSignal.timeout(timeoutMs), ...(signal ? [signal] : [])];
  let refusal;
  try {
    const response = await fetch(address, {
      method,
      credentials: 'same-origin',
      cache: 'no-store',
      headers: { ...(body ? { 'Content-Type': 'application/json' } : {}), ...headers },
      body: file ?? (body ? JSON.stringify(body) : undefined),
      signal: AbortSignal.any(limits),
    });
    // The service may also fall silent in the middle of its answer.
    if (response.ok) return await read(response);
    refusal = new ApiError(response.status, ...await describe(response));
  } catch (error) {
    if (signal?.aborted) throw error;
    throw new ApiError(0, 'the service does not answer');
  }
  if (refusal.status !== 401 || path === SESSION) throw refusal;
  refusedKey();
  throw new ApiError(401, 'your session has ended');
}

/**
 * Call the service and give its JSON (null for an empty answer). options: method, body (an object),
 * file (a Blob, with its type), query (values may be arrays), headers, signal, timeoutMs.
 * @type {Page.Call}
 */
export async function call(path, options) {
  const text = await ask(path, options ?? {}, (response) => response.text());
  return text ? JSON.parse(text) : null;
}

export const fetchFile = (path, options = {}) =>
  ask(path, { timeoutMs: 120000, ...options }, (response) => response.blob());

/** Like `call`, but null where the service answers with this status. @returns {Page.Call} */
const callUnless = (status) => async (path, options) => {
  try {
    return await call(path, options);
  } catch (error) {
    if (error.status === status) return null;
    throw error;
  }
};

export const callOptional = callUnless(404);
/** Who is logged in, or null. */
export const currentSession = () => callUnless(401)(SESSION);

/**
 * All pages of a listing with `items` and `next`; `look` is called with every page.
 * @type {Page.CallPages}
 */
export async function callPages(path, query, look = () => {}, signal = undefined) {
  const items = [];
  let cursor = null;
  do {
    const page = await call(path, { query: cursor ? { ...query, cursor } : query, signal });
    look(page);
    for (const item of page.items) items.push(item);
    cursor = page.next;
  } while (cursor);
  return items;
}

export async function isAlive() {
  try {
    const signal = AbortSignal.timeout(2500);
    return (await fetch('/livez', { cache: 'no-store', signal })).ok;
  } catch {
    return false;
  }
}

/** @type {Page.AssetPath} */
export const assetPath = (assetId, rest) => /** @type {any} */ (
  `/assets/${encodeURIComponent(assetId)}${rest ?? ''}`);

export function saveBlob(name, blob) {
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

export const saveText = (name, text, type) => saveBlob(name, new Blob([text], { type }));
