// Assets in the order in which they need attention, each one click from its own page.
import { h, put, unit } from './dom.js';
import { groupOf } from './fleet_bar.js';
import { ageText, fixed, isNumber, joined, milliseconds, percent, spanText } from './format.js';
import { icon } from './icons.js';
import { isDistrust } from './readings.js';
import { assetHash } from './route.js';

const WORDS = {
  lost: 'No data', unknown: 'Unknown', waiting: 'Waiting', unread: 'Unknown', safe: 'Unknown',
};
const NOW = { 'not safe': 'Not safe', recovering: 'Recovering', unknown: 'Unknown', safe: 'Safe now' };

/** Priority of what is measured over a limit now: a prediction never looks like a measurement. */
const overPriority = ({ limit, alarm }) => Math.min(limit?.level === 'alarm' ? 1 : 2,
  alarm && !alarm.predicted && !isDistrust(alarm) ? alarm.priority : 3);

function symbolOf(asset) {
  const { state, alarm, limit } = asset;
  if (state === 'over') return [overPriority(asset), 'filled'];
  if (alarm && isDistrust(alarm)) return ['bad', 'filled'];
  if (alarm) return [alarm.priority, alarm.predicted ? 'dashed' : 'hollow'];
  if (state === 'ahead') return [limit?.level === 'alarm' ? 1 : 2, 'dashed'];
  return { lost: ['bad', 'hollow'], safe: ['ok'] }[state] ?? ['none'];
}

/** The word before the reason; none where the reason says it itself. */
function wordOf({ state, alarm, now }) {
  if (state === 'over') return NOW[now];
  if (alarm?.predicted) return 'PREDICTED';
  if (state === 'lost' && alarm) return '';
  return now === 'unknown' ? WORDS[state] : NOW[now];
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

const lookOf = (asset) => ({ over: `p${overPriority(asset)}`, lost: 'bad' }[asset.state] ?? '');

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
    const { id, name, alarm, reason, unacknowledged: waits } = asset;
    const word = wordOf(asset);
    const why = word ? `${word}: ${reason}` : reason;
    return h('li', {}, h('a', {
      class: lookOf(asset), href: assetHash('operator', id), 'data-asset': id,
    },
    h('span', { class: alarm ? 'sy blink' : 'sy' }, icon(...symbolOf(asset), '1.5em')),
    h('span', { class: 'm' }, h('b', {}, name), h('span', { class: 's mut' }, groupOf(asset))),
    h('b', { class: 'r' }, figureOf(asset, nowMs)),
    h('span', { class: 'why' }, joined(why),
      waits > 1 && ` · + ${waits - 1} more`)));
  }
}
