// The page: session, frame, views.
import { AlarmDesk } from './alarm_desk.js';
import { AlarmSound } from './alarm_sound.js';
import { ApiError, onRefusedKey } from './api.js';
import { Banner } from './banner.js';
import { ProcessClock } from './clock.js';
import { notify } from './dialogs.js';
import { find, h, put } from './dom.js';
import {
  driverChips, Header, JobStrip, LostStrip, lostState, sourceChips,
} from './frame.js';
import { listAssets, Live } from './live.js';
import { currentSession, logInFromAddress, logOut, showLogin } from './login.js';
import { assetHash, readHash } from './route.js';
import { liveDetail, situation } from './situation.js';
import { showWaiting } from './waiting_dialog.js';
import { fetchStyle } from './styles.js';

// Views are fetched when they are first shown, so that the first of them is there at once; `style`
// is the style sheet of a view that has one of its own.
const VIEWS = {
  fleet: {
    title: 'Fleet', from: 'viewer', style: 'css/fleet.css',
    load: async () => (live.many ? (await import('./views/fleet_map.js')).FleetMapView
      : (await import('./views/fleet.js')).FleetView),
  },
  operator: {
    title: 'Operator', from: 'viewer', load: async () => (await import('./views/operator.js')).OperatorView,
  },
  whatif: {
    title: 'What-if', from: 'operator', load: async () => (await import('./views/whatif.js')).WhatIfView,
    style: 'css/whatif.css',
  },
  envelope: {
    title: 'Envelope', from: 'viewer', load: async () => (await import('./views/envelope.js')).EnvelopeView,
    style: 'css/envelope.css',
  },
  engineer: {
    title: 'Engineer', from: 'engineer', load: async () => (await import('./views/engineer.js')).EngineerView,
    style: 'css/engineer.css',
  },
  history: {
    title: 'History', from: 'viewer', load: async () => (await import('./views/history.js')).HistoryView,
    style: 'css/history.css',
  },
  accuracy: {
    title: 'Accuracy', from: 'viewer', load: async () => (await import('./views/accuracy.js')).AccuracyView,
    style: 'css/accuracy.css',
  },
  alarms: {
    title: 'Alarms', from: 'viewer', load: async () => (await import('./views/alarms.js')).AlarmsView,
  },
  assets: {
    title: 'Assets', from: 'engineer', load: async () => (await import('./views/assets.js')).AssetsView,
    style: 'css/assets.css',
  },
  // Reached from Assets, and fetched only then: a bench is put into service once.
  commissioning: {
    title: 'Commissioning', from: 'admin', style: 'css/commissioning.css', hidden: true,
    load: async () => (await import('./views/commissioning.js')).CommissioningView,
  },
};
const FETCH_OTHERS_MS = 3000;
/** Views that show no asset of their own. */
const OF_ALL = ['fleet', 'alarms', 'assets', 'commissioning'];
/** Views that can be shown without any asset. */
const OF_NONE = ['assets', 'commissioning'];
const ROLES = ['viewer', 'operator', 'engineer', 'admin'];
const TICK_MS = 250;
const AWAY_RETRY_MS = 3000;

const clock = new ProcessClock();
const live = new Live(clock, {
  onLoggedOut: () => start('Your key is no longer valid, or your session has ended.'),
  onAssets: takeAssets,
  onFeed: (one) => one.store.on(['alarms', 'forecast', 'verdict', 'tags', 'link'], updateFrame, 250),
});
onRefusedKey(() => live.isLoggedOut());
const main = find('#main');
let session = null;
let offeredKey = ''; // of a link, not used for a login yet
let assets = [];
let view = null;
let latest = 0; // number of the view that was asked for last
let feed = null; // of the asset that is looked at
let shown = ''; // name of the view on the page; '' where the address leads nowhere

const several = () => assets.length > 1;
const may = (role) => ROLES.indexOf(session?.role) >= ROLES.indexOf(role);
/** Why this user may not do what needs a role, or ''. */
const refusal = (role) =>
  (may(role) ? '' : `Needs the role ${role}; you are logged in as ${session?.role}.`);
/** Whether a view can be shown with the assets that there are; only one needs none. */
const isOf = (name) => (OF_NONE.includes(name) ? may(VIEWS[name].from)
  : assets.length > (name === 'fleet' ? 1 : 0));
const viewName = () => {
  const { view: name } = readHash();
  if (!assets.length) return name === 'commissioning' && isOf(name) ? name : 'assets';
  const known = VIEWS[name] && may(VIEWS[name].from) && isOf(name);
  return known ? name : several() && !name ? 'fleet' : 'operator';
};
/** Why the address leads nowhere, or ''. */
const nowhere = () => {
  const { view: name, asset } = readHash();
  if (!assets.length) {
    return may(VIEWS.assets.from) ? ''
      : 'No asset is configured. Add an [[assets]] section to the configuration file.';
  }
  if (name && !Object.hasOwn(VIEWS, name)) return `Unknown view “${name}”.`;
  if (!asset || live.assets.has(asset)) return '';
  return `Unknown asset “${asset}”. It may have been renamed or removed.`;
};
const nameOf = (id) => live.feeds.get(id)?.store.get('asset')?.name ?? live.assets.get(id)?.name ?? id;

const desk = new AlarmDesk(live, refusal);
const sound = new AlarmSound(() => live.alarms().map(({ alarm }) => alarm));
const page = {
  clock, may, refusal, notify, desk, nameOf, sound,
  connection: live, // all assets
  get store() { return feed.store; },
  get live() { return feed; },
  get assets() { return assets; },
  reloadAssets: () => live.loadAssets(),
  openAsset: (id, name) => { location.hash = assetHash(name, id); },
  wish: null, // a point that one view hands over to another: { speed_rpm, load_n }
};

const jobBox = h('div', { id: 'jobstrip' });
const header = new Header(find('#top'), jobBox, {
  chooseAsset: (id) => page.openAsset(id, viewName()),
  switchTheme: () => setTheme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark'),
  logOut: async () => {
    live.stop();
    await whileAway(logOut);
    start();
  },
});
const strip = new LostStrip(find('#lost'), () => live.stream?.tryNow());
const banner = new Banner(find('#banner'), desk, () => showWaiting(desk, {
  alarms: () => bannerFeeds().flatMap((one) => [...one.store.get('alarms').values()]),
  ...bannerWords(),
}));
const jobs = new JobStrip(jobBox);

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem('theme', theme);
  header.showTheme(theme);
  if (view) showView(); // canvases take their colours when they are made
}

async function showView() {
  const name = viewName();
  view?.destroy();
  view = null;
  shown = nowhere() ? '' : name;
  const asked = readHash().view;
  if (VIEWS[asked] && asked !== name && assets.length) {
    notify(refusal(VIEWS[asked].from) || 'Only one asset is configured.');
  }
  put(main).className = `v-${shown || 'nowhere'}`;
  document.body.dataset.view = shown || 'nowhere';
  showHeader();
  latest += 1;
  if (!shown) {
    showNowhere();
    return;
  }
  const looked = feed;
  const mine = latest;
  let View;
  try {
    [View] = await Promise.all([fetchView(name), !ofAll() && knowFeed(looked)]);
  } catch {
    put(main, h('p', { class: 'panel waiting' }, 'Loading this view failed.'));
    return;
  }
  if (mine !== latest || looked !== feed) return;
  view = new View(main, page);
  updateFrame();
}

/** Of many assets only that which is looked at is known as a whole, and only from then on. */
async function knowFeed(one) {
  if (one && !one.store.get('asset')) await whileAway(() => one.loadAsset());
}

/** The views and the asset that is looked at; views of all assets look at none. */
function showHeader() {
  const tabs = Object.entries(VIEWS).filter(([key, { hidden }]) => isOf(key) && !hidden);
  header.showViews(tabs.map(([key, { title, from }]) => ({
    title, href: assetHash(key, several() ? feed.assetId : null), current: key === shown,
    reason: refusal(from),
  })));
  header.showAssets(assets, ofAll() ? null : feed.assetId);
}

/** The address names an asset or a view that is not there: no other is shown in its place. */
function showNowhere() {
  put(main, h('div', { class: 'panel waiting', role: 'status' }, h('p', {}, nowhere()),
    assets.length > 0 && h('p', {}, several() ? h('a', { href: '#fleet' }, 'All assets')
      : h('a', { href: '#operator' }, 'Operator view'))));
  updateFrame();
}

/** The class of a view, once its style sheet is there too. */
async function fetchView(name) {
  const { load, style } = VIEWS[name];
  const [View] = await Promise.all([load(), style && fetchStyle(style)]);
  return View;
}

/** Have every view at hand before the service may be away. */
function fetchOthers() {
  for (const [name, { from, hidden }] of Object.entries(VIEWS)) {
    if (may(from) && !hidden) fetchView(name).catch(() => {});
  }
}

/** Show what the address asks for. */
function follow() {
  chooseFeed();
  showView();
}

function chooseFeed() {
  const id = [readHash().asset, feed?.assetId, assets[0]?.id].find((one) => live.assets.has(one));
  feed = live.feedOf(id);
  const ofOne = feed && !OF_ALL.includes(viewName());
  const greeted = live.follow(ofOne ? [feed.assetId] : live.many ? [] : null);
  if (ofOne || (feed && !live.many)) live.guarded(() => feed.open('whole', greeted));
}

/** Assets have come or gone: what lists them is made again, what shows one of them stays. */
function takeAssets(list) {
  assets = list;
  const lost = !OF_NONE.includes(shown) && live.feeds.get(feed?.assetId) !== feed;
  if (lost || !isOf(shown) || ['fleet', 'alarms', ''].includes(shown)) {
    follow();
    return;
  }
  chooseFeed();
  showHeader();
  view?.assetsChanged?.();
}

function tick() {
  const state = feed?.store.state;
  header.tick({ link: live.link, sources: state ? chipsShown(state) : [] }, clock);
  strip.tick(state ? lostState(state, clock, ofNone()) : null);
  if (state) jobs.update(state.jobs);
  sound.tick();
  showLink();
}

/** The sources of the asset that is looked at, or of all. */
const chipsShown = (state) => (ofNone() ? driverChips(state, clock) : sourceChips(state, clock));

/** A page without connection looks out of date and takes no input. */
function showLink() {
  const away = Boolean(live.stream) && live.link.status === 'away';
  document.body.classList.toggle('away', away);
  main.inert = away;
}

/** Whether the page speaks of all assets instead of one. */
const ofAll = () => ['fleet', 'assets', 'commissioning', ''].includes(shown);
/** Whether no asset is known as a whole. */
const ofNone = () => ofAll() || (live.many && shown === 'alarms');
const bannerFeeds = () => (ofAll() || shown === 'alarms' ? [...live.feeds.values()] : [feed]);
/** Whose alarms the banner knows, or not yet. */
const bannerStates = (feeds) => (live.many && feeds[0] !== feed ? [live]
  : feeds.map((one) => one.store.state));
const bannerWords = () => ({
  nameOf: (alarm) => (bannerFeeds().length > 1 ? nameOf(alarm.asset) : ''),
  live: (alarm) => liveDetail(live.feeds.get(alarm.asset).store.state, clock),
});

function updateFrame() {
  if (!live.stream || (!view && shown) || !(feed || ofAll())) return;
  const feeds = bannerFeeds();
  const overall = live.many && ofAll() ? view?.overall : null;
  const answers = overall ? [] : feeds.map((one) => situation(one.store.state, clock));
  const words = overall?.words ?? answers.map((one) => one?.verdict.now.word);
  const blind = overall?.blind ?? answers.some((one) => one?.lostMs != null);
  banner.update(feeds, { ...bannerWords(), blind, states: bannerStates(feeds) });
  const mark = words.includes('not safe') ? '▲ ' : words.includes('unknown') ? '✕ ' : '';
  const title = VIEWS[shown]?.title ?? 'Not found';
  document.title = [mark + (ofAll() ? title : `${nameOf(feed.assetId)} · ${title}`),
    'Bearing Twin'].join(' · ');
}

/** Wait for a service that is not there (yet). */
async function whileAway(action) {
  for (;;) {
    try {
      return await action();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      const why = error.status === 0 ? 'The service does not answer' : `Service: ${error.message}`;
      put(main, h('p', { class: 'panel waiting', role: 'status' }, `${why}. Retrying …`));
      await new Promise((resolve) => setTimeout(resolve, AWAY_RETRY_MS));
    }
  }
}

async function start(reason = '') {
  view?.destroy();
  view = null;
  feed = null;
  main.inert = false;
  main.className = 'v-start';
  document.body.dataset.view = 'start';
  document.title = 'Bearing Twin';
  document.querySelectorAll('dialog').forEach((dialog) => dialog.close());
  header.showSession(null);
  header.showViews([]);
  header.showAssets([], null);
  session = await whileAway(currentSession);
  while (!session) {
    await showLogin(main, reason, offeredKey);
    offeredKey = '';
    session = await whileAway(currentSession);
  }
  header.showSession(session);
  const list = await whileAway(listAssets);
  assets = list.items;
  live.start(list);
  follow();
  setTimeout(fetchOthers, FETCH_OTHERS_MS);
}

setInterval(tick, TICK_MS);
setInterval(updateFrame, 1000); // times to limits run down between messages
window.addEventListener('hashchange', () => {
  if (live.stream) follow();
});
setTheme(localStorage.getItem('theme') ?? 'dark');
[offeredKey] = await Promise.all([
  whileAway(logInFromAddress),
  document.fonts.load('400 16px B612'), document.fonts.load('700 16px B612'),
]);
await start();
