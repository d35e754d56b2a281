// One asset on the fleet's wall: a verdict, a figure, the reason, a small chart.
import { needsAcknowledge } from './alarms.js';
import { h, put, setText, unit } from './dom.js';
import { cardVerdict, standingAlarm } from './fleet_verdict.js';
import { channelName, fixed, isNumber, joined, shortAge } from './format.js';
import { icon } from './icons.js';
import { isDistrust } from './readings.js';
import { assetHash } from './route.js';
import { situation } from './situation.js';
import { createSparkline, drawSparkline } from './sparkline.js';
import { TrendChart } from './trend.js';

const PAST_MS = 2 * 3600e3;
const BRIDGE_WALL_MS = 1500;
const SPARKLINE_EVERY_MS = 5000;

export class AssetCard {
  /** dense: a tile of 12 rem by 7 rem with a sparkline, for walls with many assets. */
  constructor(feed, clock, dense) {
    this.feed = feed;
    this.clock = clock;
    this.dense = dense;
    this.point = h('span', {});
    this.title = h('b', {});
    this.lost = h('span', { class: 'second', title: 'no data', hidden: true },
      icon('bad', 'hollow', '1.1em'), h('span', { class: 'vh' }, 'no data'));
    this.name = h('h2', {}, this.title, this.point, this.lost);
    this.symbol = h('span', { class: 'sy' });
    this.word = h('span', { class: 'word' });
    this.figure = h('span', { class: 'fig' });
    this.why = h('p', { class: 'l' });
    this.plot = dense ? createSparkline() : h('div', { class: 'plot' });
    this.model = h('span', {});
    this.alarms = h('b', {});
    this.age = h('span', {});
    this.element = h('a', {
      class: 'card', href: assetHash('operator', feed.assetId), 'data-asset': feed.assetId,
    }, this.name, h('div', { class: 'big' }, this.symbol, this.word, this.figure), this.why,
    this.plot, !dense && h('div', { class: 'f' }, this.model, this.alarms, this.age));
  }

  /** Texts and chart; gives the verdict. */
  update() {
    const { state } = this.feed.store;
    const now = situation(state, this.clock);
    const verdict = cardVerdict(now, standingAlarm(state.alarms));
    this.element.className = `card ${verdict.look}${this.dense ? ' dense' : ''}`;
    setText(this.title, state.asset?.name ?? this.feed.assetId);
    this.element.title = this.title.textContent;
    this.lost.hidden = !verdict.lost || verdict.group === 'lost';
    const key = verdict.symbol.join();
    if (key !== this.key) put(this.symbol, icon(...verdict.symbol));
    this.key = key;
    setText(this.word, joined(verdict.word));
    put(this.why, [verdict.why].flat().map((part) => (typeof part === 'string' ? joined(part) : part)));
    const reading = (verdict.channel && now.readings.find((one) => one.sensor === verdict.channel))
      ?? now?.reading;
    put(this.figure, isNumber(reading?.value) && [fixed(reading.value), unit('°C')]);
    this.figure.classList.toggle('st', Boolean(reading) && (!now.live || !reading.usable));
    this.updateFoot(state, now, reading);
    if (now) this.draw(state, now, reading?.sensor);
    return verdict;
  }

  updateFoot(state, now, reading) {
    const { asset } = state;
    const figure = ({ value, usable }, name) =>
      h(usable || value === null ? 'span' : 's', {}, joined(`${fixed(value, 0)} ${name}`));
    put(this.point, asset?.bearing ?? asset?.network,
      now && [' · ', figure(now.speed, 'rpm'), ', ', figure(now.load, 'N')]);
    const model = asset?.active_model;
    setText(this.model, !model ? 'no model yet'
      : `model v${model.version}${model.trusted === false ? ', not trusted' : ''}`);
    this.model.classList.toggle('nt', model?.trusted === false);
    const waiting = [...state.alarms.values()].filter(needsAcknowledge);
    setText(this.alarms, waiting.length ? `${waiting.length} unacknowledged` : '');
    this.alarms.classList.toggle('bt', waiting.length > 0 && waiting.every(isDistrust));
    setText(this.age, !reading ? '' : `${channelName(reading.sensor).toLowerCase()}, ${
      reading.usable ? `data ${shortAge(reading.ageS / this.clock.rate)}` : 'data lost'}`);
  }

  draw(state, now, sensor) {
    const { history } = state;
    if (!history || !sensor || document.hidden) return;
    const fromMs = now.nowMs - PAST_MS;
    const endMs = now.endMs ?? now.nowMs + PAST_MS / 4;
    const { times, columns } = history.columns(fromMs, now.nowMs, BRIDGE_WALL_MS * this.clock.rate);
    if (this.dense) {
      this.drawDense(now, sensor, { fromMs, endMs, times, column: columns[sensor] ?? [] });
      return;
    }
    this.trend ??= new TrendChart(this.plot, null, { small: true });
    this.trend.update({
      nowMs: now.nowMs, fromMs, endMs, times,
      limits: { [sensor]: now.limits[sensor] }, fan: now.fan, ghost: null, lostMs: now.lostMs,
      sensors: [sensor], crossings: now.crossings.slice(0, 1),
      past: { [sensor]: { measured: columns[sensor] ?? [], twin: columns[`${sensor}.twin`] ?? [] } },
      current: { [sensor]: now.reading },
    });
  }

  drawDense(now, sensor, { fromMs, endMs, times, column }) {
    const due = performance.now() - (this.drawnMs ?? -Infinity) > SPARKLINE_EVERY_MS;
    if (!due) return;
    this.drawnMs = performance.now();
    const band = now.fan?.bands[sensor];
    drawSparkline(this.plot, {
      past: times.map((time, i) => [time, column[i]]),
      ahead: band ? now.fan.times.map((time, i) => [time, band.q50[i]]) : [],
      span: { fromMs, nowMs: now.nowMs, endMs }, limits: now.limits[sensor],
    });
  }

  destroy() {
    this.trend?.destroy();
  }
}
