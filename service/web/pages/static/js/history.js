// The past by minutes: loaded from the store's one-minute means, carried on by live samples.
import { assetPath, callPages } from './api.js';
import { isNumber, milliseconds } from './format.js';

const MINUTE_MS = 60000;
const KEPT_MS = 13 * 3600e3;
const PAGE = 10000;

export class History {
  constructor(assetId, channels) {
    this.assetId = assetId;
    this.channels = channels;
    this.minutes = new Map(); // start of the minute (ms) -> { channel: mean }
    this.sums = new Map(); // the same, running sums of live samples: { channel: [sum, count] }
    this.from = null; // how far back has been asked for
    this.upTo = null; // up to where the store has answered
  }

  /** Make sure that everything from `fromMs` on is there. */
  async load(fromMs, nowMs) {
    const end = this.from ?? nowMs + MINUTE_MS;
    if (this.from !== null && fromMs >= this.from) return;
    await this.fetch(fromMs, end);
    this.from = fromMs;
    this.upTo ??= nowMs;
  }

  /** Replace the live means since the last answer by what the store has. */
  async refresh(nowMs) {
    if (this.upTo === null) return;
    await this.fetch(this.upTo - 3 * MINUTE_MS, nowMs + MINUTE_MS);
    this.upTo = nowMs;
    this.forget(nowMs - KEPT_MS);
  }

  async fetch(startMs, endMs) {
    const floor = (ms) => new Date(Math.floor(ms / MINUTE_MS) * MINUTE_MS).toISOString();
    const items = await callPages(assetPath(this.assetId, '/measurements'), {
      channel: this.channels, start: floor(startMs), end: floor(endMs),
      resolution: '1min', limit: PAGE,
    });
    const running = Math.floor(endMs / MINUTE_MS - 1) * MINUTE_MS;
    for (const item of items) {
      const minute = milliseconds(item.time);
      if (minute < running || !this.sums.has(minute)) {
        this.row(minute)[item.channel] = isNumber(item.mean) ? item.mean : null;
      }
    }
  }

  row(minute) {
    if (!this.minutes.has(minute)) this.minutes.set(minute, {});
    return this.minutes.get(minute);
  }

  /** A live sample; only good ones enter a mean. */
  add(channel, timeMs, value, good) {
    if (!this.channels.includes(channel) || !good || !isNumber(value)) return;
    const minute = Math.floor(timeMs / MINUTE_MS) * MINUTE_MS;
    if (!this.sums.has(minute)) this.sums.set(minute, {});
    const sum = (this.sums.get(minute)[channel] ??= [0, 0]);
    sum[0] += value;
    sum[1] += 1;
    this.row(minute)[channel] = sum[0] / sum[1];
  }

  forget(beforeMs) {
    for (const map of [this.minutes, this.sums]) {
      for (const minute of map.keys()) if (minute < beforeMs) map.delete(minute);
    }
    this.from = Math.max(this.from, beforeMs);
  }

  /**
   * Columns over an even grid of minutes, so that minutes without data are a hole in the line.
   * Only holes up to `bridgeMs` are bridged: where process time runs fast, a minute may well pass
   * between two samples. Gives { times (ms, the middle of each minute), columns: { channel: [] } }.
   */
  columns(fromMs, toMs, bridgeMs) {
    const times = [];
    const columns = Object.fromEntries(this.channels.map((channel) => [channel, []]));
    const first = Math.ceil((fromMs - MINUTE_MS / 2) / MINUTE_MS) * MINUTE_MS;
    for (let minute = first; minute + MINUTE_MS / 2 < toMs; minute += MINUTE_MS) {
      const row = this.minutes.get(minute);
      times.push(minute + MINUTE_MS / 2);
      for (const channel of this.channels) columns[channel].push(row?.[channel] ?? null);
    }
    for (const channel of this.channels) bridge(columns[channel], bridgeMs / MINUTE_MS);
    return { times, columns };
  }

  /** Start of the last minute in which a channel has a mean, null when there is none. */
  lastMs(channel) {
    let last = -Infinity;
    for (const [minute, row] of this.minutes) {
      if (isNumber(row[channel])) last = Math.max(last, minute);
    }
    return Number.isFinite(last) ? last : null;
  }

  /** Time of the first minute with data, null when there is none. */
  firstMs() {
    let first = Infinity;
    for (const minute of this.minutes.keys()) first = Math.min(first, minute);
    return Number.isFinite(first) ? first : null;
  }
}

/** Draw over holes of at most `most` values: undefined is no hole to the chart, null is one. */
function bridge(values, most) {
  let last = -1;
  values.forEach((value, i) => {
    if (value === null) return;
    if (last >= 0 && i - last - 1 <= most) values.fill(undefined, last + 1, i);
    last = i;
  });
}
