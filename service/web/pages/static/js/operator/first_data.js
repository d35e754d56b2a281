// The first hour of an asset: which sources have sent nothing yet, and how to send something.
import { v } from '../parts/panel.js';
import { channelName } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { missingChannels } from '../live/verdict.js';
import { bySource, channelNames } from '../live/readings.js';

const PUSH = 'push';

export function isWaiting({ asset, tags, link }) {
  const names = channelNames(asset);
  return link.status === 'live' && names.length > 0 && Object.keys(tags).length > 0
    && !names.some((name) => typeof tags[name]?.goodValue === 'number');
}

export function FirstData({ state, clock, assetId }) {
  const { asset, sources } = state;
  const names = channelNames(asset);
  const absent = missingChannels(state.verdict?.missing ?? []).filter((name) => !names.includes(name));
  const rows = bySource(asset);
  return v('section', { class: 'panel p-first' }, v('header', {}, v('h2', {}, 'Waiting for first data')),
    v('ul', { class: 'first' },
      v('li', {}, icon('ok'), v('span', {}, 'Key accepted, service reached')),
      rows.map(([source, channels]) => sourceRow(source, sources.find((one) => one.name === source), channels)),
      absent.map((name) => v('li', {}, icon('bad', 'hollow'),
        v('span', {}, `${channelName(name)} (${name}): no channel is configured`)))),
    rows.some(([source]) => source === PUSH) && example(asset, assetId, names, clock));
}

function example(asset, assetId, names, clock) {
  const pushed = asset.channels.find(({ name, source }) => source === PUSH && names.includes(name));
  const sample = { channel: pushed.name, time: new Date(clock.now() ?? Date.now()).toISOString(), value: 23.4 };
  const path = `/api/v1/assets/${encodeURIComponent(assetId)}/measurements`;
  return [v('p', {}, 'Post a value (key of role gateway: ',
    v('code', {}, 'bearing-twin keys create --role gateway'), '):'),
  v('pre', { tabindex: 0 }, `curl -H "X-API-Key: $KEY" -H "Content-Type: application/json" \\\n`
    + `  -d '${JSON.stringify({ samples: [sample] })}' \\\n  ${location.origin}${path}`)];
}

const sourceRow = (source, driver, channels) => v('li', {}, icon('bad', 'hollow'),
  v('div', {}, v('b', {}, source === PUSH ? `push: ${driver?.detail ?? 'no values posted yet'}`
    : driver?.up === false ? `${source}: ${driver.detail || 'does not answer'}`
      : `${source}: answers, no usable value yet`),
  v('span', { class: 'names' }, channels.map((name) => v('span', { class: 'chip' }, name)))));
