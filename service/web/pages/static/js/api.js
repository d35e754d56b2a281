// The REST interface, with the session cookie of the browser.
const PREFIX = '/api/v1';
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

async function describe(response) {
  try {
    const problem = await response.json();
    const errors = problem.errors ?? [];
    const details = errors.map((error) => error.detail);
    return [[problem.detail ?? problem.title, ...details].filter(Boolean).join(': '), errors];
  } catch {
    return [`${response.status} ${response.statusText}`];
  }
}

/** Ask the service and `read` its answer where it is no refusal. Options as those of `call`. */
async function ask(path, options, read) {
  const {
    method = 'GET', body, file, query = {}, headers = {}, timeoutMs = 15000, signal,
  } = options;
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
  if (refusal.status === 401 && path !== SESSION) refusedKey();
  throw refusal;
}

/**
 * Call the service and give its JSON (null for an empty answer).
 *
 * options: method, body (an object), file (a Blob, with its type), query (values may be arrays),
 * headers, signal, timeoutMs.
 */
export async function call(path, options = {}) {
  const text = await ask(path, options, (response) => response.text());
  return text ? JSON.parse(text) : null;
}

/** A file that the service makes, as a Blob. */
export const fetchFile = (path, options = {}) =>
  ask(path, { timeoutMs: 120000, ...options }, (response) => response.blob());

/** Like `call`, but null where there is nothing (404). */
export async function callOptional(path, options) {
  try {
    return await call(path, options);
  } catch (error) {
    if (error.status === 404) return null;
    throw error;
  }
}

/** All pages of a listing with `items` and `next`; `look` is called with every page. */
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

/** Whether anybody is there at all; needs no key. */
export async function isAlive() {
  try {
    const signal = AbortSignal.timeout(2500);
    return (await fetch('/livez', { cache: 'no-store', signal })).ok;
  } catch {
    return false;
  }
}

export const assetPath = (assetId, rest = '') => `/assets/${encodeURIComponent(assetId)}${rest}`;
