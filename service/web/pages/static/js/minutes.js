// Speed and load by minutes over the days that windows are looked for in.
import { assetPath, callPages } from './api.js';
import { isNumber, milliseconds } from './format.js';

const MINUTE_MS = 60000;
const LOOK_BACK_MS = 72 * 3600e3;
const PAGE = 10000;
const CHANNELS = ['speed_rpm', 'load_n'];
// A set-point at the edge of the region is measured with noise.
const TOLERANCE = 1.02;

export class OperationMinutes {
  constructor(assetId) {
    this.assetId = assetId;
    this.minutes = new Map(); // start (ms) -> { speed_rpm, load_n }
    this.upTo = null;
  }

  /** Fetch what has come since the last time. */
  async load(nowMs) {
    const startMs = this.upTo === null ? nowMs - LOOK_BACK_MS : this.upTo - 2 * MINUTE_MS;
    const whole = (ms) => new Date(Math.floor(ms / MINUTE_MS) * MINUTE_MS).toISOString();
    const items = await callPages(assetPath(this.assetId, '/measurements'), {
      channel: CHANNELS, start: whole(startMs), end: whole(nowMs + MINUTE_MS),
      resolution: '1min', limit: PAGE,
    });
    for (const { time, channel, mean } of items) {
      const minute = milliseconds(time);
      if (!this.minutes.has(minute)) this.minutes.set(minute, {});
      this.minutes.get(minute)[channel] = mean;
    }
    this.upTo = nowMs;
    for (const minute of this.minutes.keys()) {
      if (minute < nowMs - LOOK_BACK_MS) this.minutes.delete(minute);
    }
  }

  /** Time of the first minute, null where there is none. */
  firstMs() {
    return this.minutes.size ? Math.min(...this.minutes.keys()) : null;
  }

  /** Spans beyond the low-risk region: [{ fromMs, toMs }]. */
  highRisk({ speed_rpm_max: speedMax, load_n_max: loadMax }) {
    const spans = [];
    for (const [minute, { speed_rpm: speed, load_n: load }] of this.ordered()) {
      if (!(Math.abs(speed) > speedMax * TOLERANCE || load > loadMax * TOLERANCE)) continue;
      const last = spans.at(-1);
      if (last && minute - last.toMs < 3 * MINUTE_MS) last.toMs = minute + MINUTE_MS;
      else spans.push({ fromMs: minute, toMs: minute + MINUTE_MS });
    }
    return spans;
  }

  /** The speed in runs without holes: [[[ms, rpm], …], …], every `everyMs` at most. */
  speedRuns(everyMs) {
    const runs = [];
    let last = -Infinity;
    let kept = -Infinity;
    for (const [minute, { speed_rpm: speed }] of this.ordered()) {
      if (!isNumber(speed)) continue;
      const point = [minute + MINUTE_MS / 2, Math.abs(speed)];
      if (minute - last > Math.max(5 * MINUTE_MS, 2 * everyMs)) runs.push([point]);
      else if (minute - kept >= everyMs) runs.at(-1).push(point);
      else {
        last = minute;
        continue;
      }
      last = minute;
      kept = minute;
    }
    return runs;
  }

  ordered() {
    return [...this.minutes].sort(([one], [other]) => one - other);
  }
}
