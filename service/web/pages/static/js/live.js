// Keeps every asset's store in step with the service: one stream for all of them.
import { call, callPages } from './api.js';
import { AssetFeed } from './feed.js';
import { milliseconds } from './format.js';
import { RINGS } from './channels.js';
import { Stream } from './stream.js';

export const SENSORS = RINGS;
const SUMMARY_EVERY_MS = 20000;
const LOOK_AFTER_MS = 500;

export class Live {
  /**
   * `onLoggedOut(reason)` is called when the service no longer knows the session, `onAssets(assets)`
   * when assets have come or gone.
   */
  constructor(clock, onLoggedOut, onAssets) {
    this.clock = clock;
    this.onLoggedOut = onLoggedOut;
    this.onAssets = onAssets;
    this.feeds = new Map();
    this.link = { status: 'connecting' };
  }

  /** Follow these assets (as `GET /assets` lists them) until `stop`. */
  start(assets) {
    this.stop();
    this.clock.reset();
    this.epoch = null;
    this.feeds = new Map(assets.map((asset) => [asset.id, this.createFeed(asset)]));
    this.setLink({ status: 'connecting' });
    this.stream = new Stream({
      message: (message) => this.receive(message),
      up: () => this.setLink({ status: 'live' }),
      down: ({ nextTryMs }) => this.goAway(nextTryMs),
      refused: () => this.isLoggedOut(),
    });
    this.summaryTimer = setInterval(() => this.guarded(() => this.loadAssets()), SUMMARY_EVERY_MS);
  }

  createFeed(asset) {
    const feed = new AssetFeed(asset.id, this.clock, (request) => this.guarded(request));
    feed.epoch = this.epoch;
    feed.takeAsset(asset);
    return feed;
  }

  stop() {
    this.stream?.stop();
    clearInterval(this.summaryTimer);
    clearTimeout(this.look);
    this.look = null;
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
    if (message.asset && !this.feeds.has(message.asset)) this.lookForAssets();
    else if (message.asset) this.feeds.get(message.asset).receive(message);
    else this.feeds.forEach((feed) => feed.receive(message));
    if (!restarted) return;
    this.epoch = message.epoch;
    this.guarded(() => this.loadOthers());
  }

  /** Alarms of the assets that are not shown. */
  async loadOthers() {
    if ([...this.feeds.values()].every((feed) => feed.depth)) return;
    const alarms = await callPages('/alarms', {});
    for (const [id, feed] of this.feeds) {
      if (!feed.depth) feed.takeAlarms(alarms.filter((alarm) => alarm.asset === id));
    }
  }

  /** What was refused when an asset was opened, as it may be of one that is just being added. */
  completeFeeds() {
    if (this.link.status !== 'live') return;
    for (const feed of this.feeds.values()) {
      if (feed.depth && !feed.store.get('loaded')) this.guarded(() => feed.loadAll());
    }
  }

  /** A message about an asset that is not known yet. */
  lookForAssets() {
    this.look ??= setTimeout(() => {
      this.look = null;
      this.guarded(() => this.loadAssets());
    }, LOOK_AFTER_MS);
  }

  /** All assets as they are now: some may have come or gone. */
  async loadAssets() {
    const { stream } = this;
    const assets = await callPages('/assets', {});
    if (stream !== this.stream) return; // of another session
    this.completeFeeds();
    const before = this.feeds;
    this.feeds = new Map(assets.map((asset) => {
      const known = before.get(asset.id);
      known?.takeAsset(asset);
      return [asset.id, known ?? this.createFeed(asset)];
    }));
    const added = [...this.feeds.values()].filter((feed) => !before.has(feed.assetId));
    const gone = [...before.values()].filter((feed) => !this.feeds.has(feed.assetId));
    if (!added.length && !gone.length) return;
    gone.forEach((feed) => feed.stop());
    added.forEach((feed) => feed.store.set('link', this.link));
    this.onAssets(assets);
    if (added.length) await this.loadOthers();
  }
}
