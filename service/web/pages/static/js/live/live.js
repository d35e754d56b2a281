// Keeps what the page knows in step with the service: one stream, and a store for each asset that
// is shown or has an alarm.
import { applyAlarm, assetsOf, isShared, isShown } from '../alarms/alarm.js';
import { assetPath, call, callPages, currentSession } from '../app/api.js';
import { AssetFeed } from './feed.js';
import { milliseconds } from '../parts/format.js';
import { Stream } from './stream.js';

/** With more assets the page knows only of those that it shows, and of their neighbours by name. */
export const MOST_FOLLOWED = 36;
const FLEET_PAGE = 500;
const SUMMARY_EVERY_MS = 20000;
const LOOK_AFTER_MS = 500;
const RESUME_LOOK_MS = 50;
const LONGEST_RESUME_MS = 10000;
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
  const items = await callPages('/fleet', { sort: 'id', limit: FLEET_PAGE }, (page) => {
    revision ??= page.revision;
  });
  return { items, revision };
}

const pause = (ms) => new Promise((done) => { setTimeout(done, ms); });

export class Live {
  /** `onFeed(feed)` is called for each asset of which more is known from now on. */
  constructor(clock, { onLoggedOut, onAssets, onFeed, onLink, onReturn }) {
    this.clock = clock;
    this.onLoggedOut = onLoggedOut;
    this.onAssets = onAssets;
    this.onFeed = onFeed;
    this.onLink = onLink;
    this.onReturn = onReturn;
    this.assets = new Map();
    this.feeds = new Map();
    this.shared = new Map(); // alarms of causes that assets share, also of those without a feed
    this.link = { status: 'connecting' };
    this.lastMs = null; // process time of the last message
  }

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
    this.lastMs = null;
    this.alarmsKnown = false;
    this.feeds = new Map();
    this.shared = new Map();
    this.takeList(list);
    this.setLink({ status: 'connecting' });
    this.lookAtAll();
    if (this.many) this.guarded(() => this.learnRate(list.items[0].id));
  }

  /** Few assets are asked for again and again: what a list shows of them does not come by the stream. */
  lookAtAll() {
    this.summaryTimer = setInterval(() => {
      if (!this.many) this.guarded(() => this.loadAssets());
    }, SUMMARY_EVERY_MS);
  }

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
      up: () => this.isUp(),
      down: (lost) => this.goAway(lost),
      refused: () => this.isLoggedOut(),
      hears: () => this.assets.size > 0 && this.stream?.followed?.length !== 0,
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
    this.link = { status: 'connecting' };
  }

  /** The session is over: nothing more is heard until `goOn`, and what is known stays. */
  pause() {
    clearInterval(this.summaryTimer);
    this.stream.stop();
    this.goAway({ heard: this.stream.heard, nextTryMs: null, isOver: true });
  }

  /** The same user is logged in again. */
  goOn() {
    const { followed } = this.stream;
    this.stream = null;
    this.epoch = null; // what was missed of the other assets is asked for as after a restart
    this.setLink({ ...this.link, isOver: false });
    this.lookAtAll();
    this.follow(followed);
  }

  alarms(feeds = null) {
    const known = [...(feeds ?? this.feeds.values())].map((feed) => feed.store.get('alarms'));
    return [...new Map([...(feeds ? [] : this.shared), ...known.flatMap((one) => [...one])]).values()];
  }

  takeAlarm(alarm) {
    if (!isShared(alarm)) {
      this.feeds.get(alarm.asset)?.takeAlarm(alarm);
      return;
    }
    if (isShown(alarm)) this.shared.set(alarm.id, alarm);
    else this.shared.delete(alarm.id);
    for (const feed of this.feeds.values()) {
      if (assetsOf(alarm).includes(feed.assetId) || feed.store.get('alarms').has(alarm.id)) {
        feed.takeAlarm(alarm);
      }
    }
  }

  setLink(link) {
    this.link = link;
    this.feeds.forEach((feed) => feed.store.set('link', link));
    setTimeout(() => this.onLink()); // after the views, which hear of it at once
  }

  /** After a break the page goes on at one moment: when all that it shows was heard again. */
  async isUp() {
    const { link } = this;
    if (link.status !== 'offline') {
      this.setLink({ status: 'live' });
      return;
    }
    if (this.resumes === link) return;
    this.resumes = link;
    const untilMs = performance.now() + LONGEST_RESUME_MS;
    const shown = () => [...this.feeds.values()].filter((feed) => feed.depth);
    do await pause(RESUME_LOOK_MS);
    while (this.link === link && performance.now() < untilMs && !shown().every((feed) => feed.heardAgain));
    if (this.link !== link) return;
    this.setLink({ status: 'live' });
    shown().forEach((feed) => feed.keepHistory());
    this.onReturn();
  }

  /** isOver: because the session is. */
  goAway({ heard, nextTryMs, isOver = false }) {
    this.feeds.forEach((feed) => { feed.heardAgain = false; });
    this.setLink({ status: 'offline', heard, lastMs: this.lastMs, nextTryMs, isOver });
  }

  /** Whether the session is over; if so, everything ends, once for all who ask meanwhile. */
  isLoggedOut() {
    if (this.link.isOver) return Promise.resolve(true);
    this.asking ??= this.askForSession().finally(() => { this.asking = null; });
    return this.asking;
  }

  async askForSession() {
    const isOver = await currentSession().then((session) => !session, () => false);
    if (isOver) {
      if (this.stream) this.pause();
      this.onLoggedOut();
    }
    return isOver;
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
    this.lastMs = this.clock.now();
    if (type === 'alarm' && isShared(message.data)) {
      this.newerAlarms?.push(message.data);
      this.takeAlarm(message.data);
    } else if (asset && !this.assets.has(asset)) this.lookForAssets();
    else if (asset) this.receiveOf(message);
    else if (type !== 'hello') this.feeds.forEach((feed) => feed.receive(message));
    if (restarted) this.restart(message.epoch);
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

  restart(epoch) {
    this.epoch = epoch;
    this.alarmsKnown = false;
    for (const feed of this.feeds.values()) if (feed.epoch !== epoch) feed.restart(epoch);
    this.loadOthersSoon();
  }

  /** Once for all the greetings of a connection. */
  loadOthersSoon() {
    this.others ??= Promise.resolve().then(() => {
      this.others = null;
      return this.guarded(() => this.loadOthers());
    });
  }

  async loadOthers() {
    if (!this.many && [...this.feeds.values()].every((feed) => feed.depth)) return;
    const newer = [];
    this.newerAlarms = newer;
    const alarms = await callPages('/alarms', this.many ? { state: LISTED } : {});
    this.alarmsKnown = true;
    const byAsset = new Map();
    const shown = alarms.filter(isShown);
    this.shared = new Map(shown.filter(isShared).map((alarm) => [alarm.id, alarm]));
    for (const alarm of shown) {
      for (const id of assetsOf(alarm)) {
        if (isShared(alarm) && !this.feeds.has(id)) continue;
        if (!byAsset.has(id)) byAsset.set(id, []);
        byAsset.get(id).push(alarm);
      }
    }
    for (const id of byAsset.keys()) this.feedOf(id);
    for (const [id, feed] of this.feeds) {
      if (!feed.depth) feed.takeAlarms(byAsset.get(id) ?? []);
    }
    // What the stream said while the answer was on its way is newer than the answer.
    for (const alarm of newer) {
      if (isShared(alarm)) this.takeAlarm(alarm);
      const feed = this.feeds.get(alarm.asset);
      if (feed && !feed.depth) applyAlarm(feed.store, alarm, feed.assetId);
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
