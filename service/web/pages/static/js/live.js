// Keeps every asset's store in step with the service: one stream for all of them.
import { call, callPages } from './api.js';
import { AssetFeed } from './feed.js';
import { milliseconds } from './format.js';
import { RINGS } from './channels.js';
import { Stream } from './stream.js';

export const SENSORS = RINGS;
const SUMMARY_EVERY_MS = 20000;

export class Live {
  /** `onLoggedOut(reason)` is called when the service no longer knows the session. */
  constructor(clock, onLoggedOut) {
    this.clock = clock;
    this.onLoggedOut = onLoggedOut;
    this.feeds = new Map();
    this.link = { status: 'connecting' };
  }

  /** Follow these assets (as `GET /assets` lists them) until `stop`. */
  start(assets) {
    this.stop();
    this.clock.reset();
    this.epoch = null;
    const guarded = (request) => this.guarded(request);
    this.feeds = new Map(assets.map((asset) =>
      [asset.id, new AssetFeed(asset.id, this.clock, guarded)]));
    assets.forEach((asset) => this.feeds.get(asset.id).takeAsset(asset));
    this.setLink({ status: 'connecting' });
    this.stream = new Stream(assets.map((asset) => asset.id), {
      message: (message) => this.receive(message),
      up: () => this.setLink({ status: 'live' }),
      down: ({ nextTryMs }) => this.goAway(nextTryMs),
      refused: () => this.isLoggedOut(),
    });
    this.summaryTimer = setInterval(() => this.guarded(() => this.loadAssets()), SUMMARY_EVERY_MS);
  }

  stop() {
    this.stream?.stop();
    clearInterval(this.summaryTimer);
    this.feeds.forEach((feed) => feed.stop());
    this.stream = null;
  }

  /** All alarms of all assets, as { alarm, feed }. */
  alarms() {
    return [...this.feeds.values()].flatMap((feed) =>
      [...feed.store.get('alarms').values()].map((alarm) => ({ alarm, feed })));
  }

  setLink(link) {
    this.link = link;
    this.feeds.forEach((feed) => feed.store.set('link', link));
  }

  goAway(nextTryMs) {
    const sinceMs = this.link.status === 'away' ? this.link.sinceMs : Date.now();
    this.setLink({ status: 'away', sinceMs, nextTryMs });
  }

  /** Whether the session is over; if so, everything ends, once for all who ask meanwhile. */
  isLoggedOut() {
    this.asking ??= this.askForSession().finally(() => { this.asking = null; });
    return this.asking;
  }

  async askForSession() {
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
      if (!(error.status >= 0)) throw error;
    }
  }

  receive(message) {
    const times = [milliseconds(message.time), milliseconds(message.sent_at)];
    const restarted = message.type === 'hello' && message.epoch !== this.epoch;
    // A restarted service may have another clock.
    if (restarted) this.clock.reset();
    this.clock.update(...times);
    if (message.asset) this.feeds.get(message.asset)?.receive(message);
    else this.feeds.forEach((feed) => feed.receive(message));
    if (!restarted) return;
    this.epoch = message.epoch;
    this.guarded(() => this.loadOthers());
  }

  /** Alarms of the assets that are not shown. */
  async loadOthers() {
    if (this.feeds.size < 2) return;
    const alarms = await callPages('/alarms', {});
    for (const [id, feed] of this.feeds) {
      if (!feed.depth) feed.takeAlarms(alarms.filter((alarm) => alarm.asset === id));
    }
  }

  async loadAssets() {
    for (const asset of await callPages('/assets', {})) this.feeds.get(asset.id)?.takeAsset(asset);
  }
}
