// The page: session, frame, views.
import { AlarmDesk } from './alarms/desk.js';
import { AlarmSound } from './alarms/sound.js';
import { assetsOf } from './alarms/alarm.js';
import { ApiError, currentSession, onRefusedKey } from './app/api.js';
import { ProcessClock } from './live/clock.js';
import { notify } from './parts/dialogs.js';
import { find } from './parts/dom.js';
import { draw, place, v } from './parts/panel.js';
import { Banner, driverChips, Header, lostState, showLost, sourceChips } from './app/frame.js';
import { listAssets, Live } from './live/live.js';
import { Login, logInAbove, logInFromAddress, logOut } from './app/login.js';
import { assetHash, readHash } from './app/route.js';
import { liveDetail, situation } from './live/situation.js';
import { emptyAsset } from './live/store.js';
import { fetchStyle } from './app/styles.js';
import { loadVersion, otherVersion } from './app/update.js';
import { VIEWS } from './app/views.js';
import { OperatorView } from './operator/view.js';
import { showWaiting } from './alarms/list.js';

const FETCH_OTHERS_MS = 3000;
/** Views that show no asset of their own, and those that can be shown without any. */
const OF_ALL = Object.keys(VIEWS).filter((name) => VIEWS[name].of);
const OF_NONE = OF_ALL.filter((name) => VIEWS[name].of === 'none');
/** Views without a form, as they hang on a wall. */
const WATCHED = ['operator', 'fleet'];
const ROLES = ['viewer', 'operator', 'engineer', 'admin'];
const TICK_MS = 250;
const SESSION_OVER = 'Your key is no longer valid, or your session has ended.';
const AWAY_RETRY_MS = 3000;
const clock = new ProcessClock();
const live = new Live(clock, {
  onLoggedOut: logInAgain,
  onAssets: takeAssets,
  onLink: () => {
    refresh();
    updateFrame();
  },
  onReturn: async () => {
    newVersion = await otherVersion();
    header.update({ newVersion });
  },
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
let newVersion = null; // of the page, where the service has had another one since this was opened

const several = () => assets.length > 1;
const may = (role) => ROLES.indexOf(session?.role) >= ROLES.indexOf(role);
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
/** Name of the asset of an alarm; '' where it has several, which its message counts. */
const nameOfAlarm = (alarm) => (assetsOf(alarm).length === 1 ? nameOf(assetsOf(alarm)[0]) : '');
const detailOf = (alarm) => {
  const known = assetsOf(alarm).map((id) => live.feeds.get(id)).find(Boolean);
  const nothing = { ...emptyAsset(), link: live.link, sources: [] };
  return liveDetail(known?.store.state ?? nothing, clock);
};

const desk = new AlarmDesk(live, refusal);
const sound = new AlarmSound(() => live.alarms());
const page = {
  clock, may, refusal, notify, desk, nameOf, nameOfAlarm, detailOf, sound,
  connection: live, // all assets
  get store() { return feed.store; },
  get live() { return feed; },
  get assets() { return assets; },
  reloadAssets: () => live.loadAssets(),
  openAsset: (id, name) => { location.hash = assetHash(name, id); },
  wish: null, // a point that one view hands over to another: { speed_rpm, load_n }
};

const SIGNED_OUT = { session: null, views: [], assets: [], asset: null, sources: [], jobs: new Map() };
const header = place(find('#top'), Header, {
  ...SIGNED_OUT, clock, link: live.link, theme: '', actions: {
    chooseAsset: (id) => page.openAsset(id, viewName()),
    switchTheme: () => setTheme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark'),
    loadNewVersion: () => loadVersion(newVersion),
    logOut: async () => {
      live.stop();
      endView(); // a request of it would find the session ended, and ask for a key
      await whileAway(logOut);
      start();
    },
  },
});
const banner = new Banner(find('#banner'), desk, () => showWaiting(desk, {
  alarms: bannerAlarms,
  ...bannerWords(),
}));

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem('theme', theme);
  header.update({ theme });
  if (view) showView(); // canvases take their colours when they are made
}

async function showView() {
  const name = viewName();
  endView();
  shown = nowhere() ? '' : name;
  const asked = readHash().view;
  if (VIEWS[asked] && asked !== name && assets.length) {
    notify(refusal(VIEWS[asked].from) || 'Only one asset is configured.');
  }
  main.className = `v-${shown || 'nowhere'}`;
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
    draw(main, v('p', { class: 'panel waiting' }, 'Loading this view failed.'));
    return;
  }
  if (mine !== latest || looked !== feed) return;
  view = place(main, View, { page });
  updateFrame();
}

/** Of many assets only that which is looked at is known as a whole, and only from then on. */
async function knowFeed(one) {
  if (one && !one.store.get('asset')) await whileAway(() => one.loadAsset());
}

/** The views and the asset that is looked at; views of all assets look at none. */
function showHeader() {
  const tabs = Object.entries(VIEWS).filter(([key, { hidden }]) => isOf(key) && !hidden);
  const asset = ofAll() || shown === 'alarms' ? null : feed.assetId;
  header.update({ assets, asset, views: tabs.map(([key, { title, from }]) => ({
    title, href: assetHash(key, several() ? feed.assetId : null), current: key === shown,
    reason: refusal(from),
  })) });
}

/** The address names an asset or a view that is not there: no other is shown in its place. */
function showNowhere() {
  draw(main, v('div', { class: 'panel waiting', role: 'status' }, v('p', {}, nowhere()),
    assets.length > 0 && v('p', {}, several() ? v('a', { href: '#fleet' }, 'All assets')
      : v('a', { href: '#operator' }, 'Operator view'))));
  updateFrame();
}

/** The operator's view comes with the page; the others are fetched when they are first shown. */
async function fetchView(name) {
  if (name === 'operator') return OperatorView;
  const file = name === 'fleet' && live.many ? 'map_view' : 'view';
  const [module] = await Promise.all([import(`./${name}/${file}.js`),
    VIEWS[name].style !== false && fetchStyle(`css/${name}.css`)]);
  return module.View;
}

/** Fetch every view before the service may be offline. */
function fetchOthers() {
  for (const [name, { from, hidden }] of Object.entries(VIEWS)) {
    if (may(from) && !hidden) fetchView(name).catch(() => {});
  }
}

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
  view?.part.assetsChanged?.();
}

function refresh() {
  const state = feed?.store.state;
  header.update({ link: live.link, sources: state ? chipsShown(state) : [], ...(state && { jobs: state.jobs }) });
  showLost(find('#lost'), state ? lostState(state, clock, ofNone()) : null, () => live.stream?.tryNow());
  sound.tick();
  showLink();
  if (newVersion && isOnlyWatched()) loadVersion(newVersion);
}

/** Whether loading the page again costs its users nothing: no input, and no sound until they click. */
const isOnlyWatched = () => WATCHED.includes(shown) && live.link.status === 'live'
  && !document.querySelector('dialog[open]') && !sound.isOn;

const chipsShown = (state) => (ofNone() ? driverChips(state, clock) : sourceChips(state, clock));

/** A page without connection looks out of date and takes no input. */
function showLink() {
  const offline = live.link.status === 'offline';
  document.body.classList.toggle('offline', offline);
  main.inert = offline;
}

const ofAll = () => !shown || (OF_ALL.includes(shown) && shown !== 'alarms');
/** Whether no asset is known as a whole. */
const ofNone = () => ofAll() || (live.many && shown === 'alarms');
const bannerAlarms = () => live.alarms(ofAll() || shown === 'alarms' ? null : [feed]);
const bannerFeeds = () => (ofAll() || shown === 'alarms' ? [...live.feeds.values()] : [feed]);
const bannerStates = (feeds) => (live.many && feeds[0] !== feed ? [live]
  : feeds.map((one) => one.store.state));
const bannerWords = () => ({
  nameOf: (alarm) => (bannerFeeds().length > 1 ? nameOfAlarm(alarm) : ''),
  live: detailOf,
});

function updateFrame() {
  if (!live.stream || (!view && shown) || !(feed || ofAll())) return;
  const feeds = bannerFeeds();
  const overall = live.many && ofAll() ? view?.part.overall : null;
  const answers = overall ? [] : feeds.map((one) => situation(one.store.state, clock));
  const words = overall?.words ?? answers.map((one) => one?.verdict.now.word);
  const blind = overall?.blind ?? answers.some((one) => one?.lostMs != null);
  banner.update(bannerAlarms(), { ...bannerWords(), blind, states: bannerStates(feeds) });
  const mark = words.includes('not safe') ? '▲ ' : words.includes('unknown') ? '✕ ' : '';
  const title = VIEWS[shown]?.title ?? 'Not found';
  document.title = [mark + (ofAll() ? title : `${nameOf(feed.assetId)} · ${title}`),
    'Bearing Twin'].join(' · ');
}

async function whileAway(action) {
  for (;;) {
    try {
      return await action();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      // The page begins again with a log-in, unless the session could not be asked for.
      if (error.status === 401 && await live.isLoggedOut()) return new Promise(() => {});
      const why = error.status === 0 ? 'The service does not answer' : `Service: ${error.message}`;
      draw(main, v('p', { class: 'panel waiting', role: 'status' }, `${why}. Retrying …`));
      await new Promise((resolve) => setTimeout(resolve, AWAY_RETRY_MS));
    }
  }
}

/** What was entered in the view, or in a dialog, is kept for a user of the same role. */
async function logInAgain() {
  const keeps = view && `Log in with a key of the role ${session.role} to keep your input.`;
  const known = keeps && await logInAbove(`${SESSION_OVER} ${keeps}`);
  if (known && known.role === session?.role) {
    session = known;
    header.update({ session });
    live.goOn();
  } else {
    live.stop();
    start(known ? '' : SESSION_OVER);
  }
}

function endView() {
  view?.destroy();
  view = null;
}

async function start(reason = '') {
  endView();
  feed = null;
  main.inert = false;
  main.className = 'v-start';
  document.body.dataset.view = 'start';
  document.title = 'Bearing Twin';
  document.querySelectorAll('dialog').forEach((dialog) => dialog.close());
  header.update(SIGNED_OUT);
  session = await whileAway(currentSession);
  while (!session) {
    const login = { reason, offered: offeredKey };
    await new Promise((done) => { place(main, Login, { ...login, done, key: Symbol('login') }); });
    offeredKey = '';
    session = await whileAway(currentSession);
    draw(main);
  }
  header.update({ session });
  const list = await whileAway(listAssets);
  assets = list.items;
  live.start(list);
  follow();
  setTimeout(fetchOthers, FETCH_OTHERS_MS);
}

setInterval(refresh, TICK_MS);
setInterval(updateFrame, 1000); // times to limits run down between messages
window.addEventListener('hashchange', () => {
  if (newVersion) loadVersion(newVersion);
  else if (live.stream) follow();
});
setTheme(localStorage.getItem('theme') ?? 'dark');

async function begin() {
  [offeredKey] = await Promise.all([
    whileAway(logInFromAddress),
    document.fonts.load('400 16px B612'), document.fonts.load('700 16px B612'),
  ]);
  await start();
}

begin(); // without a wait: a view that is fetched meanwhile needs this module to be complete
