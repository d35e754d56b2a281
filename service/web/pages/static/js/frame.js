// What surrounds every view: header, lost-data strip, job strip (the banner: banner.js).
import { OPERATION } from './channels.js';
import { h, put, setText } from './dom.js';
import {
  ageText, channelName, dayTime, fixed, hourMinuteSecond, milliseconds, shortAge,
  timeElement, timeZone, utc,
} from './format.js';
import { icon, logo } from './icons.js';
import { currentVerdict, listed, missingChannels } from './live_verdict.js';
import { MOST_FOLLOWED } from './live.js';
import { limitedReadings, readChannel } from './readings.js';

const JOB_SHOWN_AFTER_MS = 15000;
const MOST_SOURCES = 3; // with more, only those that are silent are named

/** Age of what a source gave last, in process seconds; null when it never gave anything. */
function sourceAge(source, clock) {
  const now = clock.now();
  if (now === null || typeof source.age_s !== 'number') return null;
  return source.age_s + Math.max(0, (now - source.heardMs) / 1000);
}

const chipText = (up, lost, age) => [up ? '' : 'no data', up && lost ? `${lost} lost` : '',
  age === null ? '' : shortAge(age)].filter(Boolean).join(' ');

/**
 * Sources of an asset as the header shows them: { name, up, lost, ageS, detail }. A source is up
 * while it answers and any of its channels can be used, by the rule of the alarms; channels that
 * are pushed have no driver of their own, only their samples.
 */
export function sourceChips(state, clock) {
  const { asset, sources } = state;
  const of = new Map();
  for (const { name, source } of asset?.channels ?? []) {
    if (name.endsWith('.twin')) continue;
    if (!of.has(source)) of.set(source, []);
    of.get(source).push(readChannel(state, clock, name));
  }
  return [...of].map(([name, readings]) => {
    const driver = sources.find((source) => source.name === name);
    const lost = readings.filter((reading) => !reading.usable).length;
    const ages = readings.map((reading) => reading.ageS).filter((age) => age !== null);
    return {
      name, lost, up: driver?.up !== false && lost < readings.length, detail: driver?.detail,
      ageS: (driver && sourceAge(driver, clock)) ?? (ages.length ? Math.min(...ages) : null),
    };
  });
}

/** The same of all drivers, whatever the asset. */
export const driverChips = (state, clock) => state.sources.map((source) =>
  ({ name: source.name, up: source.up, lost: 0, ageS: sourceAge(source, clock), detail: source.detail }));

export class Header {
  /** actions: { chooseAsset(id), switchTheme(), logOut() }; jobs: the box of the job strip */
  constructor(box, jobs, actions) {
    this.tabs = h('nav', { class: 'tabs', 'aria-label': 'Views' });
    this.asset = h('div', { class: 'asset' });
    this.sources = h('div', { class: 'conn', role: 'group', 'aria-label': 'Sources' });
    this.clockText = h('span', {});
    this.zone = h('small', {});
    this.clock = h('div', { class: 'clock' }, this.clockText, this.zone);
    this.actions = actions;
    this.menu = this.createMenu();
    put(box, h('div', { class: 'brand' }, logo(), h('span', {}, 'Bearing Twin')), this.asset,
      this.tabs, h('div', { class: 'sp' }, jobs), this.sources, this.menu, this.clock);
  }

  createMenu() {
    this.role = h('summary', {});
    this.key = h('p', { class: 's mut' });
    this.theme = h('button', { class: 'btn', type: 'button', onclick: this.actions.switchTheme });
    this.exit = h('button', { class: 'btn', type: 'button', onclick: this.actions.logOut },
      'Log out');
    const menu = h('details', { class: 'menu' }, this.role,
      h('div', {}, this.key, this.theme, this.exit, h('a', { href: '/docs' }, 'HTTP interface')));
    const close = (event) => {
      if (!menu.contains(event.target) || event.key === 'Escape') menu.open = false;
    };
    document.addEventListener('click', close);
    document.addEventListener('keydown', (event) => event.key === 'Escape' && close(event));
    return menu;
  }

  showTheme(theme) {
    setText(this.theme, theme === 'dark' ? 'Light theme' : 'Dark theme');
  }

  /** Who is logged in, or null. */
  showSession(session) {
    setText(this.role, session ? session.role : 'menu');
    this.exit.hidden = !session;
    put(this.key, session && keyText(session));
  }

  /** views: [{ title, href, current, reason }]; a reason explains why it cannot be opened. */
  showViews(views) {
    put(this.tabs, views.map(({ title, href, current, reason }) => h('a', {
      href: reason ? null : href, 'aria-current': current ? 'page' : null,
      role: reason ? 'link' : null, 'aria-disabled': reason ? 'true' : null,
      tabindex: reason ? 0 : null, title: reason || null,
    }, title)));
    this.tabs.querySelector('[aria-current]')?.scrollIntoView({ block: 'nearest', inline: 'center' });
  }

  /** assets: as `GET /assets` lists them; current: id of the one looked at, null for none. */
  showAssets(assets, current) {
    const title = ({ id, name, bearing }) => [name ?? id, bearing].filter(Boolean).join(' · ');
    const one = assets.length > MOST_FOLLOWED ? assets.filter(({ id }) => id === current) : assets;
    if (one.length < 2) {
      put(this.asset, one.map((asset) => h('b', { class: 'nw', title: asset.id }, title(asset))));
      return;
    }
    if (current === null) {
      put(this.asset);
      return;
    }
    put(this.asset, h('select', {
      'aria-label': 'Asset', onchange: (event) => this.actions.chooseAsset(event.target.value),
    }, assets.map((asset) =>
      h('option', { value: asset.id, selected: asset.id === current }, title(asset)))));
  }

  /** Sources with the age of their data, and the clock of process time. */
  tick(state, clock) {
    const shown = state.sources.length > MOST_SOURCES ? state.sources.filter((one) => !one.up)
      : state.sources;
    // How fresh a line is belongs to the wall clock, however fast process time runs.
    const chips = shown.map(({ name, up, lost, ageS, detail }) =>
      [name, up, chipText(up, lost, ageS === null ? null : ageS / clock.rate), detail ?? '']);
    const rest = state.sources.length - shown.length;
    if (rest) chips.unshift([`${rest} sources`, true, '', '']);
    if (chips.length !== this.sources.children.length) {
      put(this.sources, chips.map(() => h('span', {}, h('span', {}), h('span', {}),
        h('span', { class: 'd' }))));
    }
    chips.forEach(([name, up, word, detail], i) => {
      const chip = this.sources.children[i];
      const look = `src${up ? '' : ' bad'}`;
      if (chip.className !== look) {
        chip.className = look;
        put(chip.children[0], up ? icon('ok', 'filled', '1.05em') : icon('bad', 'current', '1.1em'));
      }
      setText(chip.children[1], name);
      setText(chip.children[2], word);
      chip.title = detail;
    });
    this.tickClock(state, clock);
  }

  tickClock(state, clock) {
    const now = clock.now();
    const away = state.link.status === 'away';
    this.clock.classList.toggle('bad', away);
    if (away) {
      setText(this.clockText, `${ageText((Date.now() - state.link.sinceMs) / 1000)} old`);
      setText(this.zone, '');
      return;
    }
    setText(this.clockText, now === null ? '--:--:--' : hourMinuteSecond(now));
    const rate = clock.rate === 1 ? '' : ` ×${fixed(clock.rate, clock.rate % 1 ? 1 : 0)}`;
    setText(this.zone, now === null ? '' : `${timeZone(now)}${rate}`);
    this.clock.title = now === null ? '' : utc(now)
      + (rate ? `, process time runs at${rate} wall time` : '');
  }
}

/** The key of the session and how long it lasts. */
function keyText({ label, prefix, expires_at: expires }) {
  const name = label || (prefix ? `${prefix}…` : 'this session');
  return [`Key ${name}`, expires ? [', until ', timeElement(milliseconds(expires),
    dayTime(milliseconds(expires)))] : ', no expiry'];
}

/** What is lost at this moment: { title, ageS, text } or null; `whole`: only of the service. */
export function lostState(state, clock, whole = false) {
  if (state.link.status === 'away') {
    const { sinceMs, nextTryMs } = state.link;
    const waitS = Math.max(0, Math.ceil((nextTryMs - Date.now()) / 1000));
    return {
      title: 'Connection lost', ageS: (Date.now() - sinceMs) / 1000,
      text: notCurrent(clock, sinceMs),
      aside: waitS ? `next try in ${waitS} s` : 'Retrying …',
    };
  }
  if (state.link.status !== 'live') return null;
  if (whole) return silentSource(state, clock);
  if (!state.asset || !Object.keys(state.tags).length) return null;
  const lost = missingChannels(currentVerdict(state).missing)
    .map((name) => readChannel(state, clock, name));
  if (!lost.length) return silentSource(state, clock);
  const oldest = lost.reduce((a, b) => ((a.ageS ?? Infinity) > (b.ageS ?? Infinity) ? a : b));
  const shown = oldest.timeMs === null ? [] : ['Last values: ',
    timeElement(oldest.timeMs, hourMinuteSecond(oldest.timeMs)), '. '];
  return {
    title: `No ${listed(lostNames(state, clock, lost))} data`, ageS: oldest.ageS,
    text: [sentence(lost[0].reason ?? 'no usable value'), ' ', shown, consequence(state, clock, lost)],
  };
}

/** What is lost, in words; all temperatures with limits are one word. */
function lostNames(state, clock, lost) {
  const limited = limitedReadings(state, clock).map((reading) => reading.name);
  const names = lost.map((reading) => reading.name);
  const all = limited.length > 0 && limited.every((name) => names.includes(name));
  const named = all ? names.filter((name) => !/^t_.*_c$/.test(name)) : names;
  return [...(all ? ['temperature'] : []), ...named.map((name) => channelName(name).toLowerCase())];
}

/** What follows from it for the twin. */
function consequence(state, clock, lost) {
  if (lost.some(({ name }) => OPERATION.includes(name))) return 'No forecast without these values.';
  if (!state.forecast) return '';
  return limitedReadings(state, clock).some((reading) => reading.usable)
    ? 'The twin continues with the other sensors.' : 'The forecast uses no sensor.';
}

/** The time of the values shown: process time runs on while the service does not answer. */
function notCurrent(clock, sinceMs) {
  if (clock.now() === null) return 'Values are not current.';
  const lastMs = clock.now() - (Date.now() - sinceMs) * clock.rate;
  return ['Values are not current (last update ', timeElement(lastMs, hourMinuteSecond(lastMs)), ').'];
}

function silentSource(state, clock) {
  const silent = state.sources.find((source) => !source.up);
  if (!silent) return null;
  return {
    title: `No data from ${silent.name}`, ageS: sourceAge(silent, clock),
    text: sentence(silent.detail || 'The source does not answer'),
  };
}

const sentence = (text) => `${text.charAt(0).toUpperCase()}${text.slice(1)}`.replace(/\.?$/, '.');

/** The strip that names the lost data; screen readers do not read its age every second. */
export class LostStrip {
  /** tryNow(): look for the service at once. */
  constructor(box, tryNow) {
    this.box = box;
    this.again = h('button', { class: 'btn', type: 'button', onclick: tryNow }, 'Retry now');
    this.title = h('b', { role: 'alert' });
    this.age = h('b', { 'aria-live': 'off' });
    this.text = h('span', { class: 'x' });
    this.aside = h('span', { class: 's' });
    this.key = null;
  }

  tick(lost) {
    if (!lost) {
      if (this.key !== null) put(this.box).className = '';
      this.key = null;
      return;
    }
    if (this.key === null) {
      this.box.className = 'lost';
      put(this.box, icon('bad', 'current', '2rem'), this.title, this.age, this.text, this.aside,
        this.again);
    }
    const key = h('i', {}, [lost.title, lost.text].flat(Infinity).map((part) =>
      part.textContent ?? part)).textContent;
    if (key !== this.key) {
      setText(this.title, lost.title);
      put(this.text, lost.text);
      this.key = key;
    }
    setText(this.age, lost.ageS === null ? '' : `for ${ageText(lost.ageS)}`);
    setText(this.aside, lost.aside ?? '');
    this.again.hidden = !lost.aside;
  }
}

/** The job that everybody may see: the running one, or for a moment the one that ended. */
export function currentJob(jobs) {
  const all = [...jobs.values()];
  const running = all.find((job) => job.status === 'running') ?? all.find((job) =>
    job.status === 'queued');
  return running ?? all.filter((job) => job.heardMs > Date.now() - JOB_SHOWN_AFTER_MS)
    .sort((a, b) => b.heardMs - a.heardMs)[0] ?? null;
}

const ENDINGS = {
  failed: (job) => `failed: ${job.error ?? 'no reason given'}`,
  cancelled: () => 'cancelled',
  succeeded: (job) => `finished: model v${job.model_version}`,
  queued: () => 'queued',
};

export function jobText(job) {
  if (job.status !== 'running') return `Re-identification ${ENDINGS[job.status]?.(job) ?? ''}`;
  return job.evaluations ? 'Re-identification' : 'Re-identification starts';
}

export class JobStrip {
  constructor(box) {
    this.box = box;
    this.text = h('span', {});
    this.share = h('b', {});
    this.fill = h('i', {});
    this.bar = h('div', { class: 'bar', role: 'progressbar', 'aria-label': 'Re-identification',
      'aria-valuemin': 0, 'aria-valuemax': 100 }, this.fill);
    put(box, this.text, this.bar, this.share);
  }

  update(jobs) {
    const job = currentJob(jobs);
    this.box.className = job ? 'jobstrip' : '';
    this.box.hidden = !job;
    if (!job) return;
    const share = Math.round((job.progress ?? 0) * 100);
    setText(this.text, jobText(job));
    this.box.title = jobText(job);
    setText(this.share, job.status === 'running' ? `${share} %` : '');
    this.bar.hidden = job.status !== 'running';
    this.bar.setAttribute('aria-valuenow', share);
    this.fill.style.width = `${share}%`;
  }
}
