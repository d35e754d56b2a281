// What the page knows of one asset: its store, its history, and how messages change them.
import { applyAlarm, isShown } from '../alarms/alarm.js';
import { assetPath, call, callOptional, callPages } from '../app/api.js';
import { OPERATION } from '../parts/channels.js';
import { isNumber, milliseconds } from '../parts/format.js';
import { thisMoment } from './age.js';
import { channelNames, chartSensors, GOOD, UNCERTAIN } from './readings.js';
import { emptyAsset, Store } from './store.js';
import { History } from './minutes.js';

const FLEET_SPAN_MS = 2 * 3600e3;
const FIRST_SPAN_MS = 3 * 3600e3;
const LAST_VALUE_MS = 60000;

export class AssetFeed {
  /** guarded(request): runs a request whose failure only means that the next one must do. */
  constructor(assetId, clock, guarded) {
    this.assetId = assetId;
    this.clock = clock;
    this.guarded = guarded;
    this.store = new Store({ link: { status: 'connecting' }, sources: [], history: null, ...emptyAsset() });
    this.history = null;
    this.span = FIRST_SPAN_MS;
    this.depth = null; // null, 'card' or 'whole': how much is asked for in addition to the stream
  }

  stop() {
    clearTimeout(this.historyTimer);
    this.stopped = true;
  }

  /**
   * Ask for what the fleet's card needs ('card') or for everything ('whole'), and keep it;
   * greeted: the stream is about to greet this asset, which asks for everything.
   */
  async open(depth, greeted = false) {
    if (this.depth === depth || (this.depth === 'whole' && depth === 'card')) return;
    this.depth = depth;
    if (!greeted && this.store.get('link').status === 'live') await this.loadAll();
  }

  /** Forget all but the alarms: no news of it come any more. */
  close() {
    clearTimeout(this.historyTimer);
    this.depth = null;
    this.history = null;
    const { alarms, alarmsKnown } = this.store.state;
    const nothing = { ...emptyAsset(), history: null, alarms, alarmsKnown };
    for (const [topic, value] of Object.entries(nothing)) this.store.set(topic, value);
  }

  receive(message) {
    const handle = {
      hello: () => this.greet(message),
      measurement: () => this.takeSamples(message.data.samples),
      state: () => this.takeState(message.data),
      verdict: () => this.takeVerdict(message.data),
      forecast: () => this.takeForecast(message.data),
      alarm: () => this.takeAlarm(message.data),
      job: () => this.takeJob(message.data),
      health: () => this.takeHealth(message.data),
    }[message.type];
    handle?.();
  }

  /** First message of a connection: all that may have been missed is asked for again. */
  greet(message) {
    if (message.epoch !== this.epoch) this.restart(message.epoch);
    this.takeSnapshot(message.data.tags);
    this.store.set('sources', []); // how they were before the break
    if (this.depth) this.guarded(() => this.loadAll());
  }

  restart(epoch) {
    this.epoch = epoch;
    this.store.set('alarmsKnown', false);
    this.store.set('forecast', null);
    this.store.set('verdict', null);
    this.store.set('nodes', null);
    this.store.set('jobs', new Map());
  }

  async loadAll() {
    // What the stream says while the answers are on their way is newer than the answers.
    const newer = [];
    this.newerAlarms = newer;
    await this.loadAsset();
    const path = (rest) => assetPath(this.assetId, rest);
    // The stream greets with a snapshot; an asset that came later has had none.
    if (!Object.keys(this.store.get('tags')).length) {
      this.takeSnapshot((await call(path('/snapshot'))).tags);
    }
    const [state, forecast, alarms, verdict] = await Promise.all([
      call(path('/state')), this.firstForecast(), callPages('/alarms', { asset: this.assetId }),
      call(path('/verdict')),
    ]);
    if (!this.depth) return; // closed meanwhile
    this.takeVerdict(verdict);
    this.takeAlarms(alarms);
    newer.forEach((alarm) => applyAlarm(this.store, alarm, this.assetId));
    if (this.newerAlarms === newer) this.newerAlarms = null;
    this.takeState(state);
    if (forecast) this.takeForecast(forecast);
    this.store.set('loaded', true);
    this.heardAgain = true;
    await this.keepHistory();
  }

  /** The latest forecast, null while the twin still waits for its first data. */
  firstForecast() {
    const ready = Object.entries(this.store.get('tags')).some(([name, tag]) =>
      name.endsWith('.forecast_max') && tag.quality >= UNCERTAIN);
    return ready ? callOptional(assetPath(this.assetId, '/forecast')) : null;
  }

  async loadAsset() {
    this.takeAsset(await call(assetPath(this.assetId)));
  }

  takeAsset(asset) {
    this.clock.setRate(asset.clock_rate);
    this.history ??= new History(this.assetId, pastChannels(asset));
    this.store.set('asset', asset);
  }

  takeAlarms(alarms) {
    this.store.set('alarmsKnown', true);
    this.store.set('alarms', new Map(alarms.filter(isShown).map((alarm) => [alarm.id, alarm])));
  }

  takeAlarm(alarm) {
    this.newerAlarms?.push(alarm);
    applyAlarm(this.store, alarm, this.assetId);
  }

  takeForecast(forecast) {
    const known = this.store.get('forecast');
    if (known && milliseconds(known.made_at) > milliseconds(forecast.made_at)) return;
    this.store.set('forecast', forecast);
    // Somebody has changed the limits: the asset must not show those before.
    const { limits } = this.store.get('asset') ?? {};
    if (limits && JSON.stringify(limits) !== JSON.stringify(forecast.limits)) {
      this.guarded(() => this.loadAsset());
    }
  }

  takeVerdict(verdict) {
    const known = this.store.get('verdict');
    if (known && milliseconds(known.time) > milliseconds(verdict.time)) return;
    this.store.set('verdict', { ...verdict, heard: thisMoment() });
  }

  async showPast(spanMs) {
    this.span = spanMs;
    await this.guarded(() => this.loadHistory());
  }

  async loadHistory() {
    const now = this.clock.now();
    const { history } = this;
    if (now === null || !history) return;
    await history.refresh(now);
    await history.load(now - (this.depth === 'whole' ? this.span : FLEET_SPAN_MS), now);
    if (this.stopped || history !== this.history) return;
    this.store.set('history', history);
    await this.findLastValues();
  }

  /** A channel that was silent when the page was opened: its last value is in the store. */
  async findLastValues() {
    for (const channel of this.history.channels) {
      const tag = this.store.get('tags')[channel];
      if (!tag || tag.goodValue !== null) continue;
      // Around its latest sample, which minutes may not hold yet; else in the last minute with data.
      const last = await this.lastGood(channel, tag.time - LAST_VALUE_MS)
        ?? await this.lastGood(channel, this.history.lastMs(channel));
      const now = this.store.get('tags')[channel];
      if (!last || now.goodValue !== null) continue;
      const found = { ...now, goodValue: last.value, goodTime: milliseconds(last.time) };
      this.store.set('tags', { ...this.store.get('tags'), [channel]: found });
    }
  }

  async lastGood(channel, fromMs) {
    if (!isNumber(fromMs)) return null;
    /** @type {{ items: any[] }} */
    const { items } = await call(assetPath(this.assetId, '/measurements'), { query: {
      channel, start: new Date(fromMs).toISOString(), end: new Date(fromMs + LAST_VALUE_MS + 1).toISOString(),
    } });
    return items.findLast((item) => item.quality >= GOOD && isNumber(item.value)) ?? null;
  }

  /** Fetch the latest means again and again, more often when process time runs fast. */
  async keepHistory() {
    if (this.store.get('link').status === 'live') await this.guarded(() => this.loadHistory());
    if (this.stopped || !this.depth) return;
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
      this.history?.add(sample.channel, time, sample.value, sample.quality >= GOOD);
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

  takeJob(job) {
    this.store.set('jobs', new Map(this.store.get('jobs')).set(job.id, { ...job, heardMs: Date.now() }));
  }

  takeHealth(health) {
    const heardMs = this.clock.now();
    this.store.set('sources', health.sources.map((source) => ({ ...source, heardMs })));
  }
}

function pastChannels(asset) {
  const sensors = chartSensors(asset);
  const others = OPERATION.filter((name) => channelNames(asset).includes(name));
  return [...others, ...sensors, ...sensors.map((sensor) => `${sensor}.twin`)];
}

/** A tag keeps its last good value and time next to its latest ones. */
function patched(before, { value, quality, time }) {
  const good = quality >= GOOD && isNumber(value);
  return {
    value, quality, time,
    goodValue: good ? value : before?.goodValue ?? null,
    goodTime: good ? time : before?.goodTime ?? null,
  };
}
