// One asset on the fleet's wall: a verdict, a figure, the reason, a small chart.
import { byUrgency, isStanding, needsAcknowledge } from '../alarms/alarm.js';
import {
  ageText, fixed, isNumber, joined, lowerName, percent, pointFigure, shortAge, spanText,
} from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { Hosted, Panel, v } from '../parts/panel.js';
import { isDistrust, readChannel } from '../live/readings.js';
import { assetHash } from '../app/route.js';
import { TrendChart } from '../charts/trend.js';
import { lacksModelOnly } from '../live/verdict.js';

const degrees = (value) => `${fixed(value, value % 1 ? 1 : 0)} °C`;
const opening = { rank: 8, group: 'wait', look: 'idle', symbol: ['none'], word: 'Opening …', why: '' };

export const standingAlarm = (alarms) =>
  [...alarms.values()].filter(isStanding)
    .sort((a, b) => a.priority - b.priority || byUrgency(a, b))[0] ?? null;

/**
 * What a card shows: { rank, group, look, symbol, word, why, channel, lost }; lowest rank first.
 *
 * now: the asset's situation; standing: its worst alarm over a measured limit, or null. It keeps its
 * colour and place while data are lost (`lost`, a second mark).
 */
export function cardVerdict(now, standing) {
  if (!now) return opening;
  const { now: answer, present_step: present, next_step: next, time_to_limit: toLimit } = now.verdict;
  const lost = now.live && now.lostChannels.length > 0;
  if (!now.live) return unknownCard(now);
  // Over a limit keeps its colour, also where the word is unknown because an input is missing.
  const over = answer.word === 'not safe' || (answer.word === 'unknown' && answer.limit);
  if (over || standing) return overCard(now, answer, standing, lost);
  if (answer.word === 'unknown') return unknownCard(now);
  if (answer.word === 'recovering') {
    return { rank: 3.5, group: 'over', look: '', symbol: ['none'], word: 'Recovering',
      why: answer.reasons[0], channel: answer.limit?.channel };
  }
  if (toLimit?.expected) return aheadCard(toLimit);
  const risky = [present, next].find((step) => step.word === 'not safe' && step.limit);
  if (risky) return aheadCard(risky);
  const why = next.word === 'unknown' ? `next step unknown: ${now.missingText}`
    : `limit ahead: ${percent(toLimit?.probability)}`;
  return {
    rank: next.word === 'unknown' ? 5 : 6, group: 'safe', look: '', symbol: ['ok'], word: 'Safe', why,
  };
}

function overCard(now, answer, alarm, lost) {
  const channel = answer.limit?.channel ?? alarm?.channel;
  const priority = Math.min(answer.limit?.level === 'alarm' ? 1 : 2, alarm?.priority ?? 2);
  const level = answer.limit?.level ?? alarm?.limit_level ?? 'limit';
  const limit = answer.limit?.value_c ?? alarm?.limit_value;
  const reading = now.readings.find((one) => one.sensor === channel);
  const unit = answer.limit ? '°C' : alarm?.unit ?? '°C';
  const over = isNumber(limit) ? `over ${level} ${fixed(limit, limit % 1 ? 1 : 0)} ${unit}`
    : answer.reasons[0];
  return {
    rank: priority - 1, group: 'over', look: `p${priority} solid`, symbol: [priority, 'filled'],
    word: { 'not safe': 'Not safe', unknown: 'Unknown', safe: 'Safe', recovering: 'Recovering' }[answer.word],
    channel, lost,
    why: reading && !reading.usable ? [over, ', ', v('b', {}, ageText(reading.ageS)), ' old'] : over,
  };
}

function unknownCard(now) {
  const doubtful = !now.live || !lacksModelOnly(now.missing);
  return {
    rank: 4, group: 'lost', look: doubtful ? 'bad' : 'idle', word: 'Unknown', lost: true,
    symbol: doubtful ? ['bad', 'hollow'] : ['none'], why: now.missingText,
  };
}

function aheadCard({ limit, probability, median_s: median }) {
  const priority = limit.level === 'alarm' ? 1 : 2;
  const words = isNumber(median) ? `${spanText(median)} to ${degrees(limit.value_c)}`
    : `${percent(probability)} over ${degrees(limit.value_c)}`;
  return {
    rank: priority === 1 ? 2.5 : 3, group: 'ahead', look: `p${priority}`,
    symbol: [priority, 'dashed'], word: 'Safe', why: ['limit ahead: ', v('b', {}, words)],
    channel: limit.channel,
  };
}

const WIDTH = 100;
const HEIGHT = 30;
const SPARE_K = 2;
const LEAST_SPAN_K = 12; // noise of a tenth of a kelvin is no mountain

function path(points, x, y) {
  let pen = 'M';
  return points.map(([time, value]) => {
    if (value === null) pen = 'M'; // a hole, which undefined is not
    if (!isNumber(value)) return '';
    const command = `${pen}${x(time).toFixed(1)} ${y(value).toFixed(1)}`;
    pen = 'L';
    return command;
  }).join('');
}

/**
 * past, ahead: [[time, value], …]; span: { fromMs, nowMs, endMs }; limits of the sensor are drawn
 * where they lie within the range of the values. Without any of these it is empty.
 */
function Sparkline({ past = [], ahead = [], span, limits }) {
  const values = [...past, ...ahead].map(([, value]) => value).filter(isNumber);
  const [least, greatest] = [Math.min(...values), Math.max(...values)];
  const spare = Math.max(SPARE_K, (LEAST_SPAN_K - (greatest - least)) / 2);
  const [low, high] = [least - spare, greatest + spare];
  const x = (time) => (time - span.fromMs) / (span.endMs - span.fromMs) * WIDTH;
  const y = (value) => HEIGHT - (value - low) / (high - low) * HEIGHT;
  const line = (name, points) => v('path', { class: name, d: path(points, x, y) });
  const level = (value, name) => value > low && value < high
    && v('path', { class: name, d: `M0 ${y(value)}H${WIDTH}` });
  return v('svg', { class: 'spark', 'aria-hidden': 'true', viewBox: `0 0 ${WIDTH} ${HEIGHT}`,
    preserveAspectRatio: 'none' },
  values.length > 0 && [level(limits?.warning, 'lw'), level(limits?.alarm, 'la'),
    v('path', { class: 'now', d: `M${x(span.nowMs)} 0V${HEIGHT}` }), line('past', past), line('ahead', ahead)]);
}

const PAST_MS = 2 * 3600e3;
const BRIDGE_WALL_MS = 1500;
const SPARKLINE_EVERY_MS = 5000;

/**
 * now: the situation of the asset; verdict: of `cardVerdict`; dense: a tile of 12 rem by 7 rem with a
 * sparkline, for walls with many assets.
 */
export class AssetCard extends Panel {
  render({ feed, clock, now, verdict, dense }) {
    const { state } = feed.store;
    const name = state.asset?.name ?? feed.assetId;
    const reading = (verdict.channel && now.readings.find((one) => one.sensor === verdict.channel))
      ?? now?.reading;
    const isOld = Boolean(reading) && (!now.live || !reading.usable);
    this.shown = now && [state, now, reading?.sensor];
    return v('a', { class: `card ${verdict.look}${dense ? ' dense' : ''}`, href: assetHash('operator', feed.assetId),
      'data-asset': feed.assetId, title: name },
    v('h2', {}, v('b', {}, name), v('span', {}, state.asset?.bearing ?? state.asset?.network,
      now && [' · ', pointFigure(now.speed, 'rpm'), ', ', pointFigure(now.load, 'N')]),
    verdict.lost && verdict.group !== 'lost' && v('span', { class: 'second', title: 'no data' },
      icon('bad', 'hollow', '1.1em'), v('span', { class: 'vh' }, 'no data'))),
    v('div', { class: 'big' }, v('span', { class: 'sy' }, icon(...verdict.symbol)),
      v('span', { class: 'word' }, joined(verdict.word)),
      v('span', { class: `fig${isOld ? ' st' : ''}` },
        isNumber(reading?.value) && [fixed(reading.value), v('span', { class: 'u' }, '°C')])),
    v('p', { class: 'l' }, [verdict.why].flat().map((part) => (typeof part === 'string' ? joined(part) : part))),
    dense ? this.sparkline() : v(Hosted, { class: 'plot', make: (box) => {
      this.trend = new TrendChart(box, null, { small: true });
      return this.trend;
    }, show: () => this.drawTrend() }),
    !dense && foot(state, reading, clock));
  }

  /** What is drawn of the past and of what lies ahead; null while nothing is. */
  span() {
    const [state, now, sensor] = this.shown ?? [];
    if (!state?.history || !sensor || document.hidden) return null;
    const fromMs = now.nowMs - PAST_MS;
    const endMs = now.endMs ?? now.nowMs + PAST_MS / 4;
    const { clock } = this.props;
    return { fromMs, endMs, nowMs: now.nowMs,
      ...state.history.columns(fromMs, now.nowMs, BRIDGE_WALL_MS * clock.rate) };
  }

  drawTrend() {
    const span = this.span();
    if (!span) return;
    const [state, now, sensor] = this.shown;
    const { columns, ...drawn } = span;
    this.trend.update({
      ...drawn, limits: { [sensor]: now.limits[sensor] }, fan: now.fan, ghost: null, lostMs: now.lostMs,
      sensors: [sensor], crossings: now.crossings.slice(0, 1),
      past: { [sensor]: { measured: columns[sensor] ?? [], twin: columns[`${sensor}.twin`] ?? [] } },
      current: { [sensor]: readChannel(state, this.props.clock, sensor) },
    });
  }

  sparkline() {
    const isDue = performance.now() - (this.drawnMs ?? -Infinity) > SPARKLINE_EVERY_MS;
    const span = isDue && this.span();
    if (span) {
      const [, now, sensor] = this.shown;
      const band = now.fan?.bands[sensor];
      const column = span.columns[sensor] ?? [];
      this.drawnMs = performance.now();
      this.line = v(Sparkline, { span, limits: now.limits[sensor],
        past: span.times.map((time, i) => [time, column[i]]),
        ahead: band ? now.fan.times.map((time, i) => [time, band.q50[i]]) : [] });
    }
    return this.line ?? v(Sparkline);
  }
}

function foot({ asset, alarms }, reading, clock) {
  const model = asset?.active_model;
  const waiting = [...alarms.values()].filter(needsAcknowledge);
  return v('div', { class: 'f' },
    v('span', { class: model?.trusted === false ? 'nt' : '' }, !model ? 'no model yet'
      : `model v${model.version}${model.trusted === false ? ', not trusted' : ''}`),
    v('b', { class: waiting.length > 0 && waiting.every(isDistrust) ? 'bt' : '' },
      waiting.length > 0 && `${waiting.length} unacknowledged`),
    v('span', {}, reading && `${lowerName(reading.sensor)}, ${
      reading.usable ? `data ${shortAge(reading.ageS / clock.rate)}` : 'data lost'}`));
}
