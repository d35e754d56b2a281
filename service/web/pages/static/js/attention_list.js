// Assets in the order in which they need attention, each one click from its own page.
import { h, put, unit } from './dom.js';
import { groupOf } from './fleet_bar.js';
import { ageText, fixed, isNumber, joined, milliseconds, percent, spanText } from './format.js';
import { icon } from './icons.js';
import { isDistrust } from './readings.js';
import { assetHash } from './route.js';

const WORDS = {
  over: 'over a limit', ahead: 'limit ahead', lost: 'no data', unknown: 'unknown',
  safe: 'safe', waiting: 'waiting for data', unread: 'not read yet',
};
const NOW = { 'not safe': 'Not safe', recovering: 'Recovering', unknown: 'Unknown', safe: 'Safe now' };

function symbolOf({ state, alarm, limit }) {
  const priority = limit?.level === 'alarm' ? 1 : 2;
  if (state === 'over') return [Math.min(alarm?.priority ?? 3, priority), 'filled'];
  if (alarm && isDistrust(alarm)) return ['bad', 'filled'];
  if (alarm) return [alarm.priority, alarm.predicted ? 'dashed' : 'hollow'];
  if (state === 'ahead') return [priority, 'dashed'];
  return { lost: ['bad', 'hollow'], safe: ['ok'] }[state] ?? ['none'];
}

/** The one figure of a row: time to the limit ahead, else the temperature, else the age of it. */
function figureOf(asset, nowMs) {
  if (asset.state === 'ahead' && isNumber(asset.seconds_to_limit)) {
    return [spanText(asset.seconds_to_limit), h('small', {}, joined(` ${percent(asset.probability)}`))];
  }
  const value = isNumber(asset.value_c) && [fixed(asset.value_c), unit('°C')];
  if (asset.state !== 'lost') return value || '';
  const ageS = asset.value_at && nowMs !== null ? (nowMs - milliseconds(asset.value_at)) / 1000 : null;
  return [value && h('s', {}, value), ageS !== null && h('small', {}, ` ${ageText(Math.max(0, ageS))} old`)];
}

const lookOf = ({ state, limit, alarm }) => {
  if (state === 'over') return `p${Math.min(alarm?.priority ?? 3, limit?.level === 'alarm' ? 1 : 2)}`;
  return state === 'lost' ? 'bad' : '';
};

export class AttentionList {
  constructor() {
    this.element = h('ol', { class: 'attn' });
    this.key = '';
  }

  /** items: of `GET /fleet`; nowMs: process time, for the age of what is lost. */
  show(items, nowMs) {
    const key = JSON.stringify(items) + Math.floor((nowMs ?? 0) / 5000);
    if (key === this.key) return;
    this.key = key;
    const at = document.activeElement?.closest('.attn a')?.dataset.asset;
    put(this.element, items.map((asset) => this.row(asset, nowMs)));
    if (at) this.element.querySelector(`[data-asset="${CSS.escape(at)}"]`)?.focus();
  }

  row(asset, nowMs) {
    const { id, name, now, state, alarm, reason, unacknowledged: waits } = asset;
    // An alarm about lost data says itself that they are lost.
    const word = state === 'lost' && alarm ? '' : now === 'unknown' && state !== 'over' ? WORDS[state]
      : NOW[now];
    const why = word ? `${word[0].toUpperCase()}${word.slice(1)}: ${reason}` : reason;
    return h('li', {}, h('a', {
      class: lookOf(asset), href: assetHash('operator', id), 'data-asset': id,
    },
    h('span', { class: alarm ? 'sy blink' : 'sy' }, icon(...symbolOf(asset), '1.5em')),
    h('span', { class: 'm' }, h('b', {}, name), h('span', { class: 's mut' }, groupOf(asset))),
    h('b', { class: 'r' }, figureOf(asset, nowMs)),
    h('span', { class: 'why' }, joined(why),
      waits > 0 && ` · ${waits} unacknowledged`)));
  }
}
