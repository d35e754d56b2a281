// Keeps the store in step with the service: a fresh start over REST, then the stream.
import { applyAlarm, isShown } from './alarms.js';
import { assetPath, call, callOptional, callPages } from './api.js';
import { isNumber, milliseconds } from './format.js';
import { History } from './history.js';
import { GOOD } from './readings.js';
import { emptyAsset } from './store.js';
import { Stream } from './stream.js';

export const SENSORS = ['t_inner_ring_c', 't_outer_ring_c'];
const PAST = ['speed_rpm', 'load_n', ...SENSORS, ...SENSORS.map((sensor) => `${sensor}.twin`)];
const HOUR_MS = 3600e3;
const SUMMARY_EVERY_MS = 20000;
const MOST_TRACE_POINTS = 5000;

export class Live {
  /** `onLoggedOut` is called when the service no longer knows the session. */
  constructor(store, clock, onLoggedOut) {
    this.store = store;
    this.clock = clock;
    this.onLoggedOut = onLoggedOut;
    this.history = null;
    this.span = HOUR_MS * 3;
  }

  start(assetId) {
    this.stop();
    this.assetId = assetId;
    this.clock.reset();
    for (const [topic, value] of Object.entries(emptyAsset())) this.store.set(topic, value);
    this.store.set('link', { status: 'connecting' });
    this.history = new History(assetId, PAST);
    this.stream = new Stream(assetId, {
      message: (message) => this.receive(message),
      up: () => this.store.set('link', { status: 'live' }),
      down: ({ nextTryMs }) => this.goAway(nextTryMs),
      refused: () => this.isLoggedOut(),
    });
    this.summaryTimer = setInterval(() => this.guarded(() => this.loadAsset()), SUMMARY_EVERY_MS);
  }

  stop() {
    this.stream?.stop();
    clearInterval(this.summaryTimer);
    clearTimeout(this.historyTimer);
    this.stream = null;
  }

  goAway(nextTryMs) {
    const link = this.store.get('link');
    const sinceMs = link.status === 'away' ? link.sinceMs : Date.now();
    this.store.set('link', { status: 'away', sinceMs, nextTryMs });
  }

  async isLoggedOut() {
    try {
      await call('/session');
      return false;
    } catch (error) {
      if (error.status !== 401) return false;
      this.stop();
      this.onLoggedOut();
      return true;
    }
  }

  /** Run a request whose failure only means that the next one must do. */
  async guarded(request) {
    try {
      await request();
    } catch (error) {
      if (error.status === 401) await this.isLoggedOut();
      else if (!(error.status >= 0)) throw error;
    }
  }

  receive(message) {
    this.clock.tell(milliseconds(message.time), milliseconds(message.sent_at));
    const handle = {
      hello: () => this.greet(message),
      measurement: () => this.takeSamples(message.data.samples),
      state: () => this.takeState(message.data),
      forecast: () => this.takeForecast(message.data),
      alarm: () => this.takeAlarm(message.data),
      job: () => this.takeJob(message.data),
      health: () => this.takeHealth(message.data),
    }[message.type];
    handle?.();
  }

  /** First message of a connection: all that may have been missed is asked for anew. */
  greet(message) {
    if (message.epoch !== this.epoch) this.meetAnew(message);
    this.takeSnapshot(message.data.tags);
    this.guarded(() => this.loadAll());
  }

  /** A service that was started anew may have another clock; what it said before is void. */
  meetAnew(message) {
    this.epoch = message.epoch;
    this.clock.reset();
    this.clock.tell(milliseconds(message.time), milliseconds(message.sent_at));
    this.store.set('forecast', null);
    this.store.set('nodes', null);
    this.store.set('jobs', new Map());
  }

  async loadAll() {
    // What the stream says while the answers are on their way is newer than the answers.
    const newer = [];
    this.newerAlarms = newer;
    await this.loadAsset();
    const path = (rest) => assetPath(this.assetId, rest);
    const [state, forecast, alarms] = await Promise.all([
      call(path('/state')), this.firstForecast(), callPages('/alarms', {}),
    ]);
    const mine = alarms.filter((alarm) => alarm.asset === this.assetId && isShown(alarm));
    this.store.set('alarms', new Map(mine.map((alarm) => [alarm.id, alarm])));
    newer.forEach((alarm) => applyAlarm(this.store, alarm));
    if (this.newerAlarms === newer) this.newerAlarms = null;
    this.takeState(state);
    if (forecast) this.takeForecast(forecast);
    await this.keepHistory();
  }

  /** The latest forecast, null while the twin still waits for its first data. */
  firstForecast() {
    const ready = Object.entries(this.store.get('tags')).some(([name, tag]) =>
      name.endsWith('.forecast_max') && tag.quality >= GOOD);
    return ready ? callOptional(assetPath(this.assetId, '/forecast')) : null;
  }

  takeAlarm(alarm) {
    this.newerAlarms?.push(alarm);
    applyAlarm(this.store, alarm);
  }

  takeForecast(forecast) {
    const known = this.store.get('forecast');
    if (known && milliseconds(known.made_at) > milliseconds(forecast.made_at)) return;
    this.store.set('forecast', forecast);
  }

  async loadAsset() {
    const asset = await call(assetPath(this.assetId));
    this.clock.setRate(asset.clock_rate);
    this.store.set('asset', asset);
  }

  /** The span of the past that the charts show, in milliseconds of process time. */
  async showPast(spanMs) {
    this.span = spanMs;
    await this.guarded(() => this.loadHistory());
  }

  async loadHistory() {
    const now = this.clock.now();
    if (now === null) return;
    const history = this.history;
    await history.refresh(now);
    await history.load(now - this.span, now);
    if (history === this.history) this.store.set('history', history);
  }

  /** Fetch the latest means again and again, more often when process time runs fast. */
  async keepHistory() {
    if (this.store.get('link').status === 'live') await this.guarded(() => this.loadHistory());
    if (!this.stream) return;
    const everyMs = Math.min(30000, Math.max(2000, 60000 / this.clock.rate));
    clearTimeout(this.historyTimer);
    this.historyTimer = setTimeout(() => this.keepHistory(), everyMs);
  }

  takeSnapshot(tags) {
    const known = {};
    for (const [name, tag] of Object.entries(tags)) {
      known[name] = patched(this.store.get('tags')[name], {
        value: tag.value, quality: tag.quality, time: milliseconds(tag.time),
      });
    }
    this.store.set('tags', { ...this.store.get('tags'), ...known });
  }

  takeSamples(samples) {
    const tags = { ...this.store.get('tags') };
    for (const sample of samples) {
      const time = milliseconds(sample.time);
      tags[sample.channel] = patched(tags[sample.channel], { ...sample, time });
      this.history.add(sample.channel, time, sample.value, sample.quality >= GOOD);
    }
    this.store.set('tags', tags);
  }

  takeState(state) {
    const { model_version: before, time } = this.store.get('nodes') ?? {};
    if (time && milliseconds(time) > milliseconds(state.time)) return;
    this.store.set('nodes', state);
    const changed = before !== undefined && before !== state.model_version;
    if (changed) this.guarded(() => this.loadAsset());
  }

  /** A job keeps the trace of its best fitness as long as the page is open. */
  takeJob(job) {
    const trace = this.store.get('jobs').get(job.id)?.trace ?? [[], []];
    const [evaluations, fitness] = trace;
    const further = job.evaluations > (evaluations.at(-1) ?? 0);
    if (further && job.best_fitness > 0 && evaluations.length < MOST_TRACE_POINTS) {
      evaluations.push(job.evaluations);
      fitness.push(job.best_fitness);
    }
    const heard = { ...job, trace, heardMs: Date.now() };
    this.store.set('jobs', new Map(this.store.get('jobs')).set(job.id, heard));
  }

  takeHealth(health) {
    const heardMs = this.clock.now();
    this.store.set('sources', health.sources.map((source) => ({ ...source, heardMs })));
  }
}

/** A tag keeps its last good value and time beside the latest word on it. */
function patched(before, { value, quality, time }) {
  const good = quality >= GOOD && isNumber(value);
  return {
    value, quality, time,
    goodValue: good ? value : before?.goodValue ?? null,
    goodTime: good ? time : before?.goodTime ?? null,
  };
}
