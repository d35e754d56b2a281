// The first hour of an asset: which sources have sent nothing yet, and how to send something.
import { h, put } from './dom.js';
import { channelName } from './format.js';
import { icon } from './icons.js';
import { missingChannels } from './live_verdict.js';
import { GOOD } from './readings.js';
import { channelNames } from './sensors.js';

const PUSH = 'push';

export class FirstData {
  constructor({ live }) {
    this.assetId = live.assetId;
    this.element = h('section', { class: 'panel p-first', hidden: true });
  }

  /** Shown until the first value of any channel has come; `clock` dates the example. */
  update(state, clock) {
    const { asset, tags, sources, link } = state;
    const names = channelNames(asset);
    const spoken = (name) => typeof tags[name]?.goodValue === 'number';
    const waiting = link.status === 'live' && names.length > 0 && Object.keys(tags).length > 0
      && !names.some(spoken);
    this.element.hidden = !waiting;
    if (!waiting) return;
    const absent = missingChannels(state.verdict?.missing ?? []).filter((name) => !names.includes(name));
    const rows = bySource(asset).map(([source, channels]) => {
      const driver = sources.find((one) => one.name === source);
      return [source, driver?.up !== false, driver?.detail ?? '',
        channels.map((name) => [name, (tags[name]?.quality ?? 0) >= GOOD])];
    });
    const key = JSON.stringify([rows, absent]);
    if (key === this.key) return;
    this.key = key;
    put(this.element, h('header', {}, h('h2', {}, 'Waiting for first data')),
      h('ul', { class: 'first' },
        h('li', {}, icon('ok'), h('span', {}, 'Key accepted, service reached')),
        rows.map((row) => sourceRow(...row)),
        absent.map((name) => h('li', {}, icon('bad', 'hollow'),
          h('span', {}, `${channelName(name)} (${name}): no channel is configured`)))),
      rows.some(([source]) => source === PUSH) && this.example(asset, names, clock));
  }

  /** A line that posts one value, to be completed with a key. */
  example(asset, names, clock) {
    const pushed = asset.channels.find(({ name, source }) => source === PUSH && names.includes(name));
    const sample = { channel: pushed.name, time: new Date(clock.now() ?? Date.now()).toISOString(), value: 23.4 };
    const path = `/api/v1/assets/${encodeURIComponent(this.assetId)}/measurements`;
    return [h('p', {}, 'Post a value (key of role gateway: ',
      h('code', {}, 'bearing-twin keys create --role gateway'), '):'),
    h('pre', { tabindex: 0 }, `curl -H "X-API-Key: $KEY" -H "Content-Type: application/json" \\\n`
      + `  -d '${JSON.stringify({ samples: [sample] })}' \\\n  ${location.origin}${path}`)];
  }
}

/** [[source, names of its channels], …] in the order of the configuration. */
function bySource(asset) {
  const of = new Map();
  for (const { name, source } of asset.channels.filter(({ name }) => !name.endsWith('.twin'))) {
    of.set(source, [...(of.get(source) ?? []), name]);
  }
  return [...of];
}

const sourceRow = (source, up, detail, channels) => h('li', {},
  icon('bad', 'hollow'),
  h('div', {}, h('b', {}, source === PUSH ? 'push: no values posted yet'
    : up ? `${source}: answers, no usable value yet` : `${source}: ${detail || 'does not answer'}`),
  h('span', { class: 'names' }, channels.map(([name]) => h('span', { class: 'chip' }, name)))));
