// Assets that are made, changed and removed from the page: requests, and what they mean in words.
import { assetPath, call, callPages } from '../app/api.js';

const IMPORT_MS = 120000;
const WHOLE = /^-?\d+$/;
const DECIMAL = /^-?(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d{1,2})?$/;
const ROW = /^row \d+(?: \(.*?\))?: /;

export async function loadProvisioning() {
  let templates = [];
  const items = await callPages('/provisioning', {}, (page) => { templates = page.templates; });
  return { templates, items };
}

/** Make an asset; one that there is already is left as it is (ApiError 412). */
export const addAsset = (id, table) =>
  call(assetPath(id), { method: 'PUT', body: table, headers: { 'If-None-Match': '*' } });
export const loadConfiguration = (id) => call(assetPath(id, '/configuration'));
/** Change what differs between two tables, and leave what another user has changed meanwhile. */
export const patchAsset = (id, before, after) =>
  call(assetPath(id), { method: 'PATCH', body: mergePatch(before, after) });

export const removeAssets = (ids) =>
  call('/assets:remove', { method: 'POST', body: { ids }, timeoutMs: IMPORT_MS });

/** Judge (`dry_run`) or take a CSV file of assets. */
export const importCsv = (file, query) => call('/assets:import', {
  method: 'POST', query, file: new Blob([file], { type: 'text/csv' }), timeoutMs: IMPORT_MS,
});

/** A value for the hole of a template: a number where the text is one, as in a CSV file. */
export function holeValue(text) {
  const number = Number(text);
  const inexact = WHOLE.test(text) && !Number.isSafeInteger(number);
  return DECIMAL.test(text) && !inexact ? number : text;
}

const isTable = (value) => value !== null && typeof value === 'object' && !Array.isArray(value);

export function mergePatch(before, after) {
  const patch = {};
  for (const key of Object.keys(before)) if (!(key in after)) patch[key] = null;
  for (const [key, value] of Object.entries(after)) {
    if (isTable(value) && isTable(before[key])) {
      const part = mergePatch(before[key], value);
      if (Object.keys(part).length) patch[key] = part;
    } else if (JSON.stringify(value) !== JSON.stringify(before[key])) patch[key] = value;
  }
  return patch;
}

/** One thing that is wrong, as { field, reason }; the field is '' where it is about the whole. */
export function wrongField({ pointer, detail }) {
  const parts = (pointer ?? '').split('/').slice(1).map((part) =>
    part.replaceAll('~1', '/').replaceAll('~0', '~'));
  const field = (parts[0] === 'assets' ? parts.slice(2) : parts).join('.');
  const line = detail.replace(ROW, '');
  return { field, reason: field && line.startsWith(`${field}: `) ? line.slice(field.length + 2) : line };
}

const isWaiting = ({ health, state }) => (health ? !health.twin_running : state === 'waiting');

/**
 * Every asset once, by id: { id, name, group, template, origin, state, why }.
 *
 * assets: as `GET /assets` or `GET /fleet` lists them; items: those of `GET /provisioning`.
 */
export function assetRows(assets, items) {
  const provisioned = new Map(items.map((item) => [item.id, item]));
  const followed = new Map(assets.map((asset) => [asset.id, asset]));
  const ids = [...new Set([...followed.keys(), ...provisioned.keys()])];
  return ids.map((id) => {
    const asset = followed.get(id);
    const item = provisioned.get(id);
    const why = item?.not_running ?? '';
    return {
      id, why,
      name: asset?.name ?? item?.table?.name ?? id,
      group: asset?.group ?? item?.table?.group ?? '',
      template: item ? item.template ?? '' : null, // the file alone knows that of its own
      origin: item ? 'provisioned' : 'file',
      state: !asset || why ? 'not running' : isWaiting(asset) ? 'waiting for data' : 'running',
    };
  }).sort((a, b) => a.id.localeCompare(b.id, undefined, { numeric: true }));
}

export const plural = (count, one, many = `${one}s`) => `${count} ${count === 1 ? one : many}`;
