// One asset on the fleet's wall: a verdict, a figure, the reason, a small chart.
import { needsAcknowledge } from './alarms.js';
import { bold, h, put, setText, unit } from './dom.js';
import { ageText, channelName, fixed, joined, percent, shortAge, spanText } from './format.js';
import { icon } from './icons.js';
import { isDistrust } from './readings.js';
import { assetHash } from './route.js';
import { situation } from './situation.js';
import { TrendChart } from './trend.js';

const PAST_MS = 2 * 3600e3;
const BRIDGE_WALL_MS = 1500;

const degrees = (value) => `${fixed(value, value % 1 ? 1 : 0)} °C`;
const opening = { rank: 7, group: 'wait', look: 'idle', symbol: ['none'], word: 'Opening …', why: '' };

/** The verdict of a card: { rank, group, look, symbol, word, why, struck }; worst rank first. */
export function cardVerdict(now) {
  if (!now) return opening;
  const { now: answer, toLimit, next, noForecast } = now;
  const { reading } = answer;
  if (answer.word === 'unknown' || !now.live) {
    const age = reading?.ageS ?? null;
    return {
      rank: 2, group: 'lost', look: 'bad', symbol: ['bad', 'hollow'], word: 'Unknown', struck: true,
      why: age === null ? 'no temperature yet' : ['no data for ', bold(ageText(age))],
    };
  }
  if (answer.word === 'over') {
    const { limits } = reading;
    const ahead = toLimit.asked && answer.level === 'warning' && !noForecast
      && `alarm ${degrees(limits.alarm)}: ${percent(toLimit.alarm.probability)}`;
    return {
      rank: answer.priority - 1, group: 'over', look: `p${answer.priority} solid`,
      symbol: [answer.priority, 'filled'], word: `Over ${degrees(limits[answer.level])}`,
      why: ahead || `${fixed(reading.value - limits[answer.level])} K over`,
    };
  }
  if (answer.word === 'rest') {
    return { rank: 6, group: 'rest', look: 'idle', symbol: ['none'], word: 'At rest',
      why: now.steps.length > 1 ? nextText(now) : 'no run under way' };
  }
  if (toLimit.word === 'some') {
    const { asked, limits, level, priority } = toLimit;
    const limit = degrees(limits[level]);
    return {
      rank: priority === 1 ? 3 : 3.5, group: 'ahead', look: `p${priority}`,
      symbol: [priority, 'dashed'],
      word: asked.median === null ? `${percent(asked.probability)} over ${limit}`
        : `${spanText(asked.median)} to ${limit}`,
      why: next.held ? 'present point, held' : nextText(now),
    };
  }
  return {
    rank: answer.word === 'safe' ? 5 : 4, group: 'safe', look: '', symbol: ['ok'],
    word: answer.word === 'safe' ? 'Safe' : 'Safe now',
    why: noForecast ? `no forecast: ${noForecast}`
      : `peak ahead ${fixed(toLimit.peak?.median)} °C, no limit`,
  };
}

const nextText = ({ next }) => (next.peak && next.step
  ? `next step ${fixed(next.step.speed_rpm, 0)} rpm: ${percent(next.peak.warning)}` : '');

export class AssetCard {
  constructor(feed, clock) {
    this.feed = feed;
    this.clock = clock;
    this.point = h('span', {});
    this.name = h('h3', {}, feed.assetId, this.point);
    this.symbol = h('span', { class: 'sy' });
    this.word = h('span', { class: 'word' });
    this.figure = h('span', { class: 'fig' });
    this.why = h('p', { class: 'l' });
    this.plot = h('div', { class: 'plot' });
    this.model = h('span', {});
    this.alarms = h('b', {});
    this.age = h('span', {});
    this.element = h('a', { class: 'card', href: assetHash('operator', feed.assetId) },
      this.name, h('div', { class: 'big' }, this.symbol, this.word, this.figure), this.why,
      this.plot, h('div', { class: 'f' }, this.model, this.alarms, this.age));
  }

  /** Texts and chart; gives the verdict. */
  update() {
    const { state } = this.feed.store;
    const now = situation(state, this.clock);
    const verdict = cardVerdict(now);
    this.element.className = `card ${verdict.look}`;
    const key = verdict.symbol.join();
    if (key !== this.key) put(this.symbol, icon(...verdict.symbol));
    this.key = key;
    setText(this.word, joined(verdict.word));
    put(this.why, typeof verdict.why === 'string' ? joined(verdict.why) : verdict.why);
    const reading = now?.now.reading;
    put(this.figure, reading?.value != null && [fixed(reading.value), unit('°C')]);
    this.figure.classList.toggle('st', verdict.struck === true);
    this.updateFoot(state, now, reading);
    if (now) this.draw(state, now, reading?.sensor);
    return verdict;
  }

  updateFoot(state, now, reading) {
    const { asset } = state;
    const point = now && [`${fixed(now.speed.value, 0)} rpm`, `${fixed(now.load.value, 0)} N`];
    setText(this.point, [asset?.bearing ?? asset?.network, point?.join(', ')]
      .filter(Boolean).join(' · '));
    const model = asset?.active_model;
    setText(this.model, !model ? 'no model yet'
      : `model v${model.version}${model.trusted === false ? ', not trusted' : ''}`);
    this.model.classList.toggle('nt', model?.trusted === false);
    const waiting = [...state.alarms.values()].filter(needsAcknowledge);
    setText(this.alarms, waiting.length ? `${waiting.length} to acknowledge` : '');
    this.alarms.classList.toggle('bt', waiting.length > 0 && waiting.every(isDistrust));
    setText(this.age, !reading ? '' : `${channelName(reading.sensor).toLowerCase()}, ${
      reading.usable ? `data ${shortAge(reading.ageS / this.clock.rate)}` : 'data lost'}`);
  }

  draw(state, now, sensor) {
    const { history } = state;
    if (!history || !sensor || document.hidden) return;
    this.trend ??= new TrendChart(this.plot, null, { small: true });
    const fromMs = now.nowMs - PAST_MS;
    const { times, columns } = history.columns(fromMs, now.nowMs, BRIDGE_WALL_MS * this.clock.rate);
    this.trend.update({
      nowMs: now.nowMs, fromMs, endMs: now.endMs ?? now.nowMs + PAST_MS / 4, times,
      limits: { [sensor]: now.limits[sensor] }, fan: now.fan, ghost: null, lostMs: now.lostMs,
      sensors: [sensor], crossings: now.crossings.slice(0, 1),
      past: { [sensor]: { measured: columns[sensor] ?? [], twin: columns[`${sensor}.twin`] ?? [] } },
      current: { [sensor]: now.now.reading },
    });
  }

  destroy() {
    this.trend?.destroy();
  }
}
