// What surrounds every view: header, banner, lost-data strip, job strip.
import { OPERATION } from '../parts/channels.js';
import {
  ageText, dayOrTime, fixed, hourMinuteSecond, joined, lowerName, moment, shortAge, timeElement,
  timeZone, utc,
} from '../parts/format.js';
import { icon, logo } from '../parts/icons.js';
import { draw, Panel, select, unless, v } from '../parts/panel.js';
import { ageMs } from '../live/age.js';
import { currentVerdict, listed, missingChannels } from '../live/verdict.js';
import { MOST_FOLLOWED } from '../live/live.js';
import { bySource, isDistrust, limitedReadings, readChannel } from '../live/readings.js';
import { detailText, headline, isAside, needsAcknowledge, raisedMs, symbol, worst } from '../alarms/alarm.js';

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
 * while it answers and any of its channels can be used; what is pushed has only its samples.
 */
export function sourceChips(state, clock) {
  return bySource(state.asset).map(([name, channels]) => {
    const readings = channels.map((channel) => readChannel(state, clock, channel));
    const driver = state.sources.find((source) => source.name === name);
    const lost = readings.filter((reading) => !reading.usable).length;
    const ages = readings.map((reading) => reading.ageS).filter((age) => age !== null);
    return {
      name, lost, up: driver?.up !== false && lost < readings.length, detail: driver?.detail,
      ageS: (driver && sourceAge(driver, clock)) ?? (ages.length ? Math.min(...ages) : null),
    };
  });
}

export const driverChips = (state, clock) => state.sources.map((source) =>
  ({ name: source.name, up: source.up, lost: 0, ageS: sourceAge(source, clock), detail: source.detail }));

/**
 * views: [{ title, href, current, reason }], a reason explains why it cannot be opened; asset: id of the
 * one looked at, null for none; session: who is logged in, or null; clock: of process time.
 */
export class Header extends Panel {
  constructor(attributes) {
    super(attributes);
    const close = (event) => {
      if (!this.menu.contains(event.target) || event.key === 'Escape') this.menu.open = false;
    };
    document.addEventListener('click', close);
    document.addEventListener('keydown', (event) => event.key === 'Escape' && close(event));
  }

  componentDidUpdate({ views }) {
    if (views !== this.props.views) {
      document.querySelector('.tabs [aria-current]')?.scrollIntoView({ block: 'nearest', inline: 'center' });
    }
  }

  render({ actions, theme, session, views, sources, jobs, newVersion }) {
    return [
      v('div', { class: 'brand' }, logo(), v('span', {}, 'Bearing Twin')), v('div', { class: 'asset' }, this.asset()),
      v('nav', { class: 'tabs', 'aria-label': 'Views' }, views.map(({ title, href, current, reason }) => v('a', {
        href: reason ? null : href, 'aria-current': current ? 'page' : null, key: title,
        role: reason ? 'link' : null, 'aria-disabled': reason ? 'true' : null,
        tabindex: reason ? 0 : null, title: reason || null,
      }, title))),
      v('div', { class: 'sp' }, jobStrip(currentJob(jobs)), newVersion && v('button', { class: 'btn sm',
        type: 'button', title: 'The service has been updated; this page is of the version before.',
        onclick: actions.loadNewVersion }, 'Load new version')),
      v('div', { class: 'conn', role: 'group', 'aria-label': 'Sources' }, this.sources(sources)),
      v('details', { class: 'menu', ref: (menu) => { this.menu = menu; } },
        v('summary', {}, session ? session.role : 'menu'),
        v('div', {}, v('p', { class: 's mut' }, session && keyText(session)),
          v('button', { class: 'btn', type: 'button', onclick: actions.switchTheme },
            theme === 'dark' ? 'Light theme' : 'Dark theme'),
          session && v('button', { class: 'btn', type: 'button', onclick: actions.logOut }, 'Log out'),
          v('a', { href: '/docs' }, 'HTTP interface'))),
      this.clock(),
    ];
  }

  asset() {
    const { assets, asset: current, actions } = this.props;
    const title = ({ id, name, bearing }) => [name ?? id, bearing].filter(Boolean).join(' · ');
    const one = assets.length > MOST_FOLLOWED ? assets.filter(({ id }) => id === current) : assets;
    if (one.length < 2) return one.map((asset) => v('b', { class: 'nw', title: asset.id }, title(asset)));
    return current !== null
      && select('Asset', assets.map((asset) => [asset.id, title(asset)]), current, actions.chooseAsset);
  }

  sources(sources) {
    const shown = sources.length > MOST_SOURCES ? sources.filter((one) => !one.up) : sources;
    const rest = sources.length - shown.length;
    const chip = (name, up, word, title) => v('span', { class: `src${up ? '' : ' bad'}`, title, key: name },
      v('span', {}, up ? icon('ok', 'filled', '1.05em') : icon('bad', 'current', '1.1em')), v('span', {}, name),
      v('span', { class: 'd' }, word));
    // How fresh a line is belongs to the wall clock, however fast process time runs.
    const { rate } = this.props.clock;
    return [rest > 0 && chip(`${rest} sources`, true, '', ''), shown.map(({ name, up, lost, ageS, detail }) =>
      chip(name, up, chipText(up, lost, ageS === null ? null : ageS / rate), detail ?? ''))];
  }

  clock() {
    const { clock, link } = this.props;
    const now = clock.now();
    if (link.status === 'offline') {
      return v('div', { class: 'clock bad' },
        v('span', {}, `${ageText(ageMs(link.heard) / 1000)} old`), v('small', {}));
    }
    const rate = clock.rate === 1 ? '' : ` ×${fixed(clock.rate, clock.rate % 1 ? 1 : 0)}`;
    return v('div', { class: 'clock', title: now === null ? '' : utc(now)
      + (rate ? `, process time runs at${rate} wall time` : '') },
    v('span', {}, now === null ? '--:--:--' : hourMinuteSecond(now)),
    v('small', {}, now !== null && `${timeZone(now)}${rate}`));
  }
}

function keyText({ label, prefix, expires_at: expires }) {
  const name = label || (prefix ? `${prefix}…` : 'this session');
  return [`Key ${name}`, expires ? [', until ', moment(expires)] : ', no expiry'];
}

/** What is lost at this moment: { title, ageS, text } or null; `whole`: only of the service. */
export function lostState(state, clock, whole = false) {
  if (state.link.status === 'offline') {
    const { heard, isOver, lastMs, nextTryMs } = state.link;
    const waitS = Math.max(0, Math.ceil((nextTryMs - Date.now()) / 1000));
    return {
      title: isOver ? 'Session ended' : 'Connection lost', ageS: ageMs(heard) / 1000,
      text: notCurrent(lastMs),
      aside: isOver ? '' : waitS ? `next try in ${waitS} s` : 'Retrying …',
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

function lostNames(state, clock, lost) {
  const limited = limitedReadings(state, clock).map((reading) => reading.name);
  const names = lost.map((reading) => reading.name);
  const all = limited.length > 0 && limited.every((name) => names.includes(name));
  const named = all ? names.filter((name) => !/^t_.*_c$/.test(name)) : names;
  return [...(all ? ['temperature'] : []), ...named.map(lowerName)];
}

function consequence(state, clock, lost) {
  if (lost.some(({ name }) => OPERATION.includes(name))) return 'No forecast without these values.';
  if (!state.forecast) return '';
  return limitedReadings(state, clock).some((reading) => reading.usable)
    ? 'The twin continues with the other sensors.' : 'The forecast uses no sensor.';
}

/** lastMs: process time of the last message, null before the first one. */
function notCurrent(lastMs) {
  if (lastMs === null) return 'Values are not current.';
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
export function showLost(box, lost, tryNow) {
  box.className = lost ? 'lost' : '';
  draw(box, lost && [icon('bad', 'current', '2rem'), v('b', { role: 'alert' }, lost.title),
    v('b', { 'aria-live': 'off' }, lost.ageS !== null && `for ${ageText(lost.ageS)}`),
    v('span', { class: 'x' }, lost.text), v('span', { class: 's' }, lost.aside),
    lost.aside && v('button', { class: 'btn', type: 'button', onclick: tryNow }, 'Retry now')]);
}

/** The job that every user may see: the running one, or for a moment the one that ended. */
export function currentJob(jobs) {
  const all = [...jobs.values()];
  const running = all.find((job) => job.status === 'running') ?? all.find((job) => job.status === 'queued');
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
  return job.evaluations ? 'Re-identification' : 'Re-identification: preparing the data';
}

function jobStrip(job) {
  if (!job) return v('div', { id: 'jobstrip', hidden: true });
  const share = Math.round((job.progress ?? 0) * 100);
  const counts = job.status === 'running' && job.evaluations > 0;
  return v('div', { id: 'jobstrip', class: 'jobstrip', title: jobText(job) }, v('span', {}, jobText(job)),
    v('div', { class: 'bar', role: 'progressbar', 'aria-label': 'Re-identification', 'aria-valuemin': 0,
      'aria-valuemax': 100, 'aria-valuenow': share, hidden: !counts }, v('i', { style: { width: `${share}%` } })),
    v('b', {}, counts && `${share} %`));
}

function ignorance(states) {
  if (states.some(({ link }) => link.status === 'offline')) return 'the service does not answer';
  const waiting = states.some(({ link, alarmsKnown }) => link.status !== 'live' || !alarmsKnown);
  return waiting ? 'loading' : '';
}

export class Banner {
  box;
  desk;
  openWaiting;

  constructor(box, desk, openWaiting) {
    Object.assign(this, { box, desk, openWaiting });
  }

  /**
   * all: the alarms that are meant; nameOf(alarm): name to show, or ''; live(alarm): the present
   * values of its asset's forecast and sensor; blind: a limit has no data;
   * states: { link, alarmsKnown } of all of which the alarms are meant.
   */
  update(all, { nameOf, live, blind, states }) {
    const alarm = worst(all);
    const unknown = ignorance(states);
    const others = all.filter((one) => needsAcknowledge(one) && one.id !== alarm?.id).length;
    const aside = all.filter(isAside).length;
    const act = (name, text) => alarm && v('button', { class: 'btn', type: 'button',
      onclick: () => this.desk.take(name, alarm), ...unless(this.desk.refusal(name, alarm)) }, text);
    const { message, detail, since } = alarm ? wordsOfAlarm(alarm, live(alarm), nameOf(alarm), unknown)
      : { message: unknown ? `Alarms unknown: ${unknown}`
        : blind ? 'Limit alarms not available: no data' : 'No active alarms' };
    this.box.className = !alarm ? `banner quiet${unknown ? ' unknown' : ''}`
      : `banner${alarm.predicted ? ` pred pr${alarm.priority}` : ''}`;
    if (alarm && !alarm.predicted) this.box.dataset.p = isDistrust(alarm) ? 'bad' : alarm.priority;
    else delete this.box.dataset.p;
    draw(this.box,
      v('span', { class: alarm?.state === 'UNACK' ? 'blink' : '' }, alarm ? symbol(alarm, '2.3rem', true)
        : unknown ? icon('bad', 'current') : icon(blind ? 'none' : 'ok')),
      v('div', { class: 'grow' }, v('span', { class: 'msg', role: 'status', 'aria-live': 'assertive' }, message),
        v('span', { class: 'msg' }, detail), v('span', { class: 'sub nw' }, since)),
      others > 0 && v('button', { class: 'sub nw more', type: 'button', onclick: this.openWaiting },
        alarm ? `+ ${others} more` : `${others} unacknowledged`),
      aside > 0 && !alarm && v('a', { class: 'sub nw', href: '#alarms' }, `${aside} suppressed`),
      alarm && needsAcknowledge(alarm) && act('acknowledge', 'Acknowledge'), act('shelve', 'Shelve…'));
  }
}

const wordsOfAlarm = (alarm, now, name, unknown) => ({
  message: joined(`${unknown ? 'LAST KNOWN ' : ''}${name ? `${name}: ` : ''}`
    + `${alarm.predicted ? 'PREDICTED ' : ''}${headline(alarm)}`),
  detail: unknown ? '' : `${alarm.predicted ? ', ' : '  '}${detailText(alarm, now)}`,
  since: [`  ·  ${alarm.state === 'UNACK' ? 'unacknowledged' : 'acknowledged'} since `,
    timeElement(raisedMs(alarm), dayOrTime(raisedMs(alarm), now.nowMs))],
});
