// Keeps what the page knows in step with the service: one stream, and a store for each asset that
// is shown or has an alarm.
import { applyAlarm, isShown } from './alarms.js';
import { assetPath, call, callPages } from './api.js';
import { AssetFeed } from './feed.js';
import { milliseconds } from './format.js';
import { RINGS } from './channels.js';
import { Stream } from './stream.js';

export const SENSORS = RINGS;
/** With more assets the page knows only of those that it shows, and of their neighbours by name. */
export const MOST_FOLLOWED = 36;
const PAGE = 500;
const SUMMARY_EVERY_MS = 20000;
const LOOK_AFTER_MS = 500;
// With many assets, what is suppressed by design is not listed: it is most of what there is.
const LISTED = ['UNACK', 'ACKED', 'RTNUN', 'LATCH', 'SHLVD', 'OOSRV'];

/**
 * All assets, { items, revision }: of many only what a list shows (id, name, group, bearing, state …),
 * in the order of the map, and which make of the list it is.
 */
export async function listAssets() {
  const first = await call('/fleet', { query: { sort: 'id', limit: MOST_FOLLOWED } });
  if (!first.next) return { items: (await call('/assets')).items, revision: null };
  let revision = null;
  const items = await callPages('/fleet', { sort: 'id', limit: PAGE }, (page) => {
    revision ??= page.revision;
  });
  return { items, revision };
}

export class Live {
  /**
   * `onLoggedOut(reason)` is called when the service no longer knows the session, `onAssets(assets)`
   * when assets have come or gone, `onFeed(feed)` for each asset of which more is known from now on.
   */
  constructor(clock, { onLoggedOut, onAssets, onFeed }) {
    this.clock = clock;
    this.onLoggedOut = onLoggedOut;
    this.onAssets = onAssets;
    this.onFeed = onFeed;
    this.assets = new Map();
    this.feeds = new Map();
    this.link = { status: 'connecting' };
  }

  /** Whether there are too many assets to follow all of them. */
  get many() {
    return this.assets.size > MOST_FOLLOWED;
  }

  /**
   * Keep in step with these assets (as `listAssets` gives them) until `stop`; `follow` says with
   * which of them in all they do.
   */
  start(list) {
    this.stop();
    this.clock.reset();
    this.epoch = null;
    this.alarmsKnown = false;
    this.feeds = new Map();
    this.takeList(list);
    this.setLink({ status: 'connecting' });
    this.summaryTimer = setInterval(() => {
      if (!this.many) this.guarded(() => this.loadAssets());
    }, SUMMARY_EVERY_MS);
    if (this.many) this.guarded(() => this.learnRate(list.items[0].id));
  }

  /** How fast process time runs, which every asset knows. */
  async learnRate(id) {
    this.clock.setRate((await call(assetPath(id))).clock_rate);
  }

  takeList({ items, revision }) {
    this.revision = revision;
    this.assets = new Map(items.map((asset) => [asset.id, asset]));
    if (this.many) return;
    for (const asset of items) this.feedOf(asset.id).takeAsset(asset);
  }

  /** What is known of an asset, from now on; null where there is none of that id. */
  feedOf(id) {
    if (!this.assets.has(id)) return null;
    if (!this.feeds.has(id)) {
      const feed = new AssetFeed(id, this.clock, (request) => this.guarded(request));
      feed.epoch = this.epoch;
      feed.store.set('link', this.link);
      feed.store.set('alarmsKnown', this.alarmsKnown);
      this.feeds.set(id, feed);
      this.onFeed(feed);
    }
    return this.feeds.get(id);
  }

  /**
   * Follow some assets, or all (null), and no others; gives whether the stream greets them again.
   * Of many assets, what was known of the others is forgotten, but for their alarms.
   */
  follow(ids) {
    if (this.many) {
      for (const [id, feed] of this.feeds) if (feed.depth && !ids.includes(id)) feed.close();
    }
    if (this.stream) return this.stream.follow(ids);
    this.stream = new Stream({
      message: (message) => this.receive(message),
      up: () => this.setLink({ status: 'live' }),
      down: ({ nextTryMs }) => this.goAway(nextTryMs),
      refused: () => this.isLoggedOut(),
    }, ids);
    return true;
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
    const { type, asset } = message;
    const restarted = type === 'hello' && message.epoch !== this.epoch;
    // A restarted service may have another clock.
    if (restarted) this.clock.reset();
    this.clock.update(...times);
    if (asset && !this.assets.has(asset)) this.lookForAssets();
    else if (asset) this.receiveOf(message);
    else if (type !== 'hello') this.feeds.forEach((feed) => feed.receive(message));
    if (restarted) this.meetAnew(message.epoch);
    else if (type === 'hello' && message.gap) this.loadOthersSoon();
  }

  /** Of many assets one without a feed gets one with its first alarm. */
  receiveOf(message) {
    const known = this.feeds.get(message.asset);
    const news = message.type === 'hello'
      || (message.type === 'alarm' && LISTED.includes(message.data.state));
    (known ?? (news ? this.feedOf(message.asset) : null))?.receive(message);
    if (message.type === 'alarm') this.newerAlarms?.push(message.data);
  }

  meetAnew(epoch) {
    this.epoch = epoch;
    this.alarmsKnown = false;
    for (const feed of this.feeds.values()) if (feed.epoch !== epoch) feed.meetAnew(epoch);
    this.loadOthersSoon();
  }

  /** Once for all the greetings of a connection. */
  loadOthersSoon() {
    this.others ??= Promise.resolve().then(() => {
      this.others = null;
      return this.guarded(() => this.loadOthers());
    });
  }

  /** Alarms of the assets that are not shown. */
  async loadOthers() {
    if (!this.many && [...this.feeds.values()].every((feed) => feed.depth)) return;
    const newer = [];
    this.newerAlarms = newer;
    const alarms = await callPages('/alarms', this.many ? { state: LISTED } : {});
    this.alarmsKnown = true;
    const byAsset = new Map();
    for (const alarm of alarms.filter(isShown)) {
      if (!byAsset.has(alarm.asset)) byAsset.set(alarm.asset, []);
      byAsset.get(alarm.asset).push(alarm);
    }
    for (const id of byAsset.keys()) this.feedOf(id);
    for (const [id, feed] of this.feeds) {
      if (!feed.depth) feed.takeAlarms(byAsset.get(id) ?? []);
    }
    // What the stream said while the answer was on its way is newer than the answer.
    for (const alarm of newer) {
      const feed = this.feeds.get(alarm.asset);
      if (feed && !feed.depth) applyAlarm(feed.store, alarm);
    }
    if (this.newerAlarms === newer) this.newerAlarms = null;
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
    const before = this.assets;
    const few = this.many ? null : (await call('/assets')).items;
    const list = few && few.length <= MOST_FOLLOWED ? { items: few, revision: null } : await listAssets();
    if (stream !== this.stream) return; // of another session
    this.completeFeeds();
    this.takeList(list);
    const gone = [...before.keys()].filter((id) => !this.assets.has(id));
    for (const id of gone) {
      this.feeds.get(id)?.stop();
      this.feeds.delete(id);
    }
    const added = list.items.filter(({ id }) => !before.has(id));
    if (!added.length && !gone.length && !this.many) return;
    this.onAssets(list.items);
    if (added.length) await this.loadOthers();
  }
}
