// The past by minutes: means as the service has them, continued with live samples.
import { assetPath, callPages } from '../app/api.js';
import { isNumber, milliseconds } from '../parts/format.js';

export const MINUTE_MS = 60000;
const MOST_ROWS = 10000;

export class Minutes {
  constructor(assetId, channels) {
    this.assetId = assetId;
    this.channels = channels;
    this.minutes = new Map(); // start of the minute (ms) -> { channel: mean }
    this.upTo = null; // up to where the service has answered
  }

  /** Fetch the means of a span; isTaken(minute in ms): whether it may replace what there is. */
  async fetch(startMs, endMs, isTaken = (_) => true) {
    const floor = (ms) => new Date(Math.floor(ms / MINUTE_MS) * MINUTE_MS).toISOString();
    const items = await callPages(assetPath(this.assetId, '/measurements'), {
      channel: this.channels, start: floor(startMs), end: floor(endMs), resolution: '1min', limit: MOST_ROWS,
    });
    for (const { time, channel, mean } of items) {
      if (isTaken(milliseconds(time))) this.row(milliseconds(time))[channel] = mean ?? null;
    }
  }

  row(minute) {
    if (!this.minutes.has(minute)) this.minutes.set(minute, {});
    return this.minutes.get(minute);
  }

  forget(beforeMs) {
    for (const minute of this.minutes.keys()) if (minute < beforeMs) this.minutes.delete(minute);
  }

  firstMs() {
    return this.minutes.size ? Math.min(...this.minutes.keys()) : null;
  }
}

const KEPT_MS = 13 * 3600e3;

export class History extends Minutes {
  constructor(assetId, channels) {
    super(assetId, channels);
    this.sums = new Map(); // of live samples: start of the minute (ms) -> { channel: [sum, count] }
    this.from = null; // how far back has been asked for
  }

  async load(fromMs, nowMs) {
    if (this.from !== null && fromMs >= this.from) return;
    await this.fetchMeans(fromMs, this.from ?? nowMs + MINUTE_MS);
    this.from = fromMs;
    this.upTo ??= nowMs;
  }

  /** Replace the live means since the last answer by what the store has. */
  async refresh(nowMs) {
    if (this.upTo === null) return;
    await this.fetchMeans(this.upTo - 3 * MINUTE_MS, nowMs + MINUTE_MS);
    this.upTo = nowMs;
    this.forget(nowMs - KEPT_MS);
  }

  /** The minute that is running is known better from live samples. */
  fetchMeans(startMs, endMs) {
    const running = Math.floor(endMs / MINUTE_MS - 1) * MINUTE_MS;
    return this.fetch(startMs, endMs, (minute) => minute < running || !this.sums.has(minute));
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
    super.forget(beforeMs);
    for (const minute of this.sums.keys()) if (minute < beforeMs) this.sums.delete(minute);
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

  lastMs(channel) {
    const known = [...this.minutes.keys()].filter((minute) => isNumber(this.minutes.get(minute)[channel]));
    return known.length ? Math.max(...known) : null;
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
