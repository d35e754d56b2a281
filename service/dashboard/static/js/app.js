// The page: session, frame, views.
import { acknowledge } from './alarms.js';
import { ApiError, call } from './api.js';
import { ProcessClock } from './clock.js';
import { notify } from './dialogs.js';
import { find, h, put } from './dom.js';
import { Banner, Header, JobStrip, LostStrip, lostState } from './frame.js';
import { Live } from './live.js';
import { currentSession, logInFromAddress, logOut, showLogin } from './login.js';
import { liveDetail, situation } from './situation.js';
import { emptyAsset, Store } from './store.js';
import { EngineerView } from './views/engineer.js';
import { EnvelopeView } from './views/envelope.js';
import { OperatorView } from './views/operator.js';
import { WhatIfView } from './views/whatif.js';

const VIEWS = {
  operator: { title: 'Operator', view: OperatorView, from: 'viewer' },
  whatif: { title: 'What-if', view: WhatIfView, from: 'operator' },
  envelope: { title: 'Envelope', view: EnvelopeView, from: 'viewer' },
  engineer: { title: 'Engineer', view: EngineerView, from: 'engineer' },
};
const ROLES = ['viewer', 'operator', 'engineer', 'admin'];
const TICK_MS = 250;
const AWAY_RETRY_MS = 3000;

const store = new Store({
  session: null, assets: [], link: { status: 'connecting' }, sources: [], history: null,
  ...emptyAsset(),
});
const clock = new ProcessClock();
const live = new Live(store, clock, () => start());
const main = find('#main');
let view = null;
let assetId = null;

const may = (role) => ROLES.indexOf(store.get('session')?.role) >= ROLES.indexOf(role);
const viewName = () => {
  const name = location.hash.slice(1);
  return VIEWS[name] && may(VIEWS[name].from) ? name : 'operator';
};

async function acknowledgeAlarm(alarm, button) {
  button.disabled = true;
  try {
    await acknowledge(store, alarm);
  } catch (error) {
    notify(`Not acknowledged: ${error.message}.`);
  } finally {
    button.disabled = false;
  }
}

const page = {
  store, clock, live, may, notify,
  wish: null, // a point that one view hands over to another: { speed_rpm, load_n }
  acknowledge: acknowledgeAlarm,
  mayAcknowledge: () => may('operator'),
};

const header = new Header(find('#top'), {
  chooseAsset: (id) => openAsset(id),
  switchTheme: () => setTheme(document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark'),
  logOut: async () => {
    live.stop();
    await logOut();
    start();
  },
});
const strip = new LostStrip(find('#lost'));
const banner = new Banner(find('#banner'), page);
const jobs = new JobStrip(find('#jobstrip'));

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem('theme', theme);
  header.showTheme(theme);
  if (view) showView(); // canvases take their colours when they are made
}

function showView() {
  const name = viewName();
  view?.destroy();
  main.className = `v-${name}`;
  document.body.dataset.view = name;
  header.showViews(Object.entries(VIEWS).filter(([, one]) => may(one.from))
    .map(([key, one]) => [key, one.title]), name);
  view = new VIEWS[name].view(main, page);
}

function openAsset(id) {
  assetId = id;
  live.start(id);
  header.showAssets(store.get('assets'), id);
  showView();
}

function tick() {
  const { state } = store;
  header.tick(state, clock);
  strip.tick(assetId ? lostState(state, clock) : null);
  jobs.update(state.jobs);
}

function updateFrame() {
  banner.update(store.get('alarms'), liveDetail(store.state, clock),
    store.get('link').status !== 'live');
  const now = situation(store.state, clock);
  const mark = { over: '▲ ', unknown: '✕ ' }[now?.now.word] ?? '';
  document.title = `${mark}${assetId ?? ''} · ${VIEWS[viewName()].title} · Bearing Twin`;
}

/** Wait for a service that is not there (yet). */
async function whileAway(action) {
  for (;;) {
    try {
      return await action();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      const why = error.status === 0 ? 'The service does not answer' : `Service: ${error.message}`;
      put(main, h('p', { class: 'panel waiting', role: 'status' }, `${why}. Trying again …`));
      await new Promise((resolve) => setTimeout(resolve, AWAY_RETRY_MS));
    }
  }
}

async function start() {
  view?.destroy();
  view = null;
  assetId = null;
  main.className = 'v-start';
  document.body.dataset.view = 'start';
  header.showSession(null, false);
  header.showViews([], '');
  let session = await whileAway(currentSession);
  while (!session) {
    await showLogin(main);
    session = await whileAway(currentSession);
  }
  store.set('session', session);
  header.showSession(session, true);
  const answer = await whileAway(() => call('/assets'));
  store.set('assets', answer.items ?? answer);
  const [first] = store.get('assets');
  if (!first) {
    put(main, h('p', { class: 'panel waiting' },
      'No asset is configured. Add an [[assets]] section to the configuration file.'));
    return;
  }
  openAsset(first.id);
}

store.on(['alarms', 'forecast', 'tags', 'link', 'session'], updateFrame, 250);
setInterval(tick, TICK_MS);
window.addEventListener('hashchange', () => {
  if (assetId) showView();
});
setTheme(localStorage.getItem('theme') ?? 'dark');
await Promise.all([document.fonts.load('400 16px B612'), document.fonts.load('700 16px B612')]);
await whileAway(logInFromAddress);
await start();
