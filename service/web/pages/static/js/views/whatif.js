// What-if: change the plan and the twin answers at once. Nothing here ever commands the bench.
import { assetPath, call } from '../api.js';
import { BandChoice } from '../band_choice.js';
import { h, put, setText, unit } from '../dom.js';
import { distinctSteps, fanFrom, overSpan, stepsFrom } from '../forecast.js';
import { channelName, fixed, labelText, spanText } from '../format.js';
import { highestSpeed } from '../highest_speed.js';
import { LaneChart } from '../lane.js';
import { LatestQuestion } from '../latest.js';
import { csvOf, fieldsFor, fromLink, linkOf, MOST_STEPS, requestProfile } from '../profile.js';
import { ProfilePanel } from '../profile_panel.js';
import { readChannel } from '../readings.js';
import { marginText, marginTitle } from '../runaway.js';
import { chartSensors } from '../sensors.js';
import { crossingsAhead, situation } from '../situation.js';
import {
  awayTile, missingTile, noForecastTile, peakTile, profileTile, timeToLimitTile,
} from '../tiles.js';
import { TrendChart } from '../trend.js';
import { judgeProfile, timeAlongProfile } from '../verdict.js';

const HOUR_MS = 3600e3;
const PAST_SHARE = 0.22; // of what lies ahead, within these bounds
const PAST_MS = [HOUR_MS, 3 * HOUR_MS];
const QUIET_MS = 500; // after the last change, before the slower questions are asked
const REFRESH_S = 60; // of process time: the present state moves on under a profile that stays
const REFRESH_MS = [1500, 10000];
const ROWS = 160; // of an answer: about as many as the chart has room for
const FINEST_S = 30;
const TITLES = [['This profile', 'This profile'], ['Peak', 'Peak'],
  ['Time to limit', 'Time to limit']];

const query = () => location.hash.split('?')[1] ?? '';
const key = (look, ...text) => h('span', { class: 'key' }, h('i', { class: look }), text);

export class WhatIfView {
  constructor(box, page) {
    this.page = page;
    this.steps = null;
    this.touched = 0; // the step that was changed last
    this.fromEnd = false;
    this.answer = null;
    this.failure = '';
    this.answers = h('div', { class: 'answers' });
    this.heading = h('h2', {}, 'Forecast for this profile, °C');
    this.labels = h('span', { class: 'labels' });
    this.band = new BandChoice(page, () => this.show());
    this.margin = h('p', { class: 's mut margin' });
    this.ghostText = h('span', {}, 'as planned');
    this.boxes = {
      temperature: h('div', { class: 'plot t', role: 'img', 'aria-label': 'Forecast' }),
      speed: h('div', { class: 'plot sp1' }),
      load: h('div', { class: 'plot ld1' }),
    };
    this.panel = new ProfilePanel({
      preset: (name) => this.page.store.get('forecast') && this.use(this.preset(name)),
      add: () => this.use([...this.steps, { ...this.steps.at(-1) }], this.steps.length),
      remove: (index) => this.use(this.steps.filter((_, i) => i !== index)),
      tryFrom: (fromEnd) => {
        this.fromEnd = fromEnd;
        this.use(this.steps, this.touched);
      },
      change: (index, name, value) => {
        this.steps[index][name] = value;
        this.touched = index;
        this.changed();
      },
      copyLink: () => this.copyLink(),
      save: () => this.save(),
      useSpeed: () => {
        this.steps[this.highest.index].speed_rpm = this.highest.speed;
        this.use(this.steps, this.highest.index);
      },
    });
    put(box, h('h1', { class: 'vh' }, 'What-if'), this.panel.element, this.createResult());
    this.trend = new TrendChart(this.boxes.temperature, 'whatif');
    this.speed = new LaneChart(this.boxes.speed, { label: 'Speed, rpm', syncKey: 'whatif' });
    this.load = new LaneChart(this.boxes.load,
      { label: 'Load, N', syncKey: 'whatif', showTime: true });
    this.question = new LatestQuestion({
      ask: ({ profile }, signal) => this.ask(profile, signal),
      answered: (answer, question, ms) => this.take(answer, question, ms),
      failed: (error) => this.fail(error),
    });
    this.endings = [page.store.on(['tags', 'history', 'asset', 'forecast', 'link'],
      () => this.follow(), 1000)];
    this.refresh();
    this.follow();
  }

  destroy() {
    clearTimeout(this.timer);
    clearTimeout(this.quiet);
    this.question.stop();
    this.seeking?.abort();
    this.endings.forEach((end) => end());
    [this.trend, this.speed, this.load].forEach((chart) => chart.destroy());
  }

  createResult() {
    return h('div', { class: 'wr' }, this.answers, h('section', { class: 'panel p-trend' },
      h('header', {}, this.heading, this.labels,
        h('span', { class: 'keys' }, key('tw', 'median'), this.band.element,
          key('pl', this.ghostText))),
      this.margin, this.boxes.temperature, this.boxes.speed, this.boxes.load));
  }

  // ---------------------------------------------------------------- the profile
  presentStep(minutes) {
    const { state } = this.page.store;
    const value = (channel) => {
      const figure = readChannel(state, this.page.clock, channel).value ?? 0;
      return Math.round(figure / 50) * 50;
    };
    return { speed_rpm: value('speed_rpm'), load_n: value('load_n'), minutes };
  }

  preset(name) {
    if (name === 'hold') return [this.presentStep(180)];
    if (name === 'cool down') {
      const step = this.presentStep(120);
      return [{ ...step, speed_rpm: Math.min(step.speed_rpm, 1500) }];
    }
    return this.plannedSteps();
  }

  plannedSteps() {
    const steps = this.coming().map(({ speed_rpm, load_n, duration_s }) =>
      ({ speed_rpm: Math.round(speed_rpm), load_n: Math.round(load_n),
        minutes: Math.max(1, Math.round(duration_s / 60)) }));
    return steps.length > 1 && this.fromEnd ? steps.slice(1, MOST_STEPS) : steps.slice(0, MOST_STEPS);
  }

  /** What another view, a link or the last visit asks for; null when there is nothing. */
  wished() {
    const { wish } = this.page;
    this.page.wish = null;
    if (wish) return [{ ...wish, minutes: 120 }];
    const { tried, live } = this.page;
    const wished = fromLink(query()) ?? (tried?.assetId === live.assetId ? tried : null);
    if (wished) this.fromEnd = wished.fromEnd;
    return wished && wished.steps.map((step) => ({ ...step }));
  }

  /** The plan from now on, the present step first. */
  coming() {
    const { store, clock } = this.page;
    return distinctSteps(stepsFrom(store.get('forecast'), clock.now()));
  }

  /** Try these steps; `touched` is the one that the hint speaks of. */
  use(steps, touched = 0) {
    this.steps = steps.length ? steps : [this.presentStep(60)];
    this.touched = Math.min(touched, this.steps.length - 1);
    const coming = this.coming();
    const endMs = coming.length > 1 ? coming[0].to : null;
    if (endMs === null) this.fromEnd = false;
    this.panel.build(this.steps, this.fields(), { fromEnd: this.fromEnd, endMs });
    this.changed();
  }

  fields() {
    return fieldsFor(this.page.store.get('asset')?.low_risk, [...this.steps, this.presentStep(60)]);
  }

  /** What is left of the present step, where the profile is to begin at its end. */
  before() {
    return this.fromEnd ? this.coming()[0] ?? null : null;
  }

  profile(steps = this.steps) {
    return requestProfile(steps, this.before());
  }

  // ---------------------------------------------------------------- asking
  /** Ask at once; what takes longer waits until the hand is still. */
  changed() {
    this.put();
    this.seeking?.abort();
    clearTimeout(this.quiet);
    this.quiet = setTimeout(() => {
      this.keepInAddress();
      this.seekHighest();
    }, QUIET_MS);
  }

  put() {
    const { link, forecast } = this.page.store.state;
    if (!this.steps || !forecast || link.status !== 'live') return;
    this.question.put({ profile: this.profile(), madeMs: this.page.clock.now() });
  }

  refresh() {
    this.put();
    const [least, most] = REFRESH_MS;
    const everyMs = Math.min(most, Math.max(least, REFRESH_S * 1000 / this.page.clock.rate));
    this.timer = setTimeout(() => this.refresh(), everyMs);
  }

  sensors() {
    return chartSensors(this.page.store.get('asset'));
  }

  /** The temperatures that are drawn or have limits. */
  names() {
    return [...new Set([...this.sensors(), ...Object.keys(this.page.store.get('asset').limits)])];
  }

  ask(profile, signal, stepS = null) {
    const lengthS = profile.reduce((sum, step) => sum + step.duration_s, 0);
    const step_s = Math.min(stepS ?? Math.max(FINEST_S, Math.round(lengthS / ROWS)), 3600);
    return call(assetPath(this.page.live.assetId, '/forecasts'),
      { method: 'POST', body: { profile, nodes: this.names(), step_s }, signal });
  }

  take(answer, { profile, madeMs }, ms) {
    this.answer = { ...answer, made_at: answer.made_at ?? new Date(madeMs).toISOString(), profile };
    this.failure = '';
    this.panel.showProblem('');
    this.heading.title = `Answered in ${Math.round(ms)} ms`;
    const unknown = Object.entries(answer.not_known ?? {})
      .map(([name, why]) => `${channelName(name)} not known, ${why}`);
    put(this.labels, [...(answer.labels ?? []).map(labelText), ...unknown]
      .map((text) => h('span', { class: 'chip dash' }, text)));
    setText(this.margin, marginText(answer.runaway_margin));
    this.margin.title = marginTitle(answer.runaway_margin);
    this.show();
  }

  fail(error) {
    this.answer = null;
    this.failure = error.message;
    this.heading.title = '';
    setText(this.margin, '');
    this.panel.showProblem(`No answer: ${error.message}.`);
    this.show();
  }

  /** Up to which speed the step that was changed last keeps the warning improbable. */
  async seekHighest() {
    const { link, forecast, asset } = this.page.store.state;
    if (!this.steps || !forecast || link.status !== 'live') return;
    const seeking = new AbortController();
    this.seeking = seeking;
    const index = this.touched;
    const { load_n: load, minutes } = this.steps[index];
    const { speed_rpm: field } = this.fields();
    const of = `step ${index + 1}`;
    const at = `at ${fixed(load, 0)} N for ${spanText(minutes * 60)}`;
    this.panel.showHint(`Highest speed of ${of} with less than 5 % over a warning limit, ${at}`,
      null, false);
    if (this.steps[index].speed_rpm === 0) {
      this.panel.showHint(`Step ${index + 1} is a standstill.`, '–', false);
      return;
    }
    if (!Object.keys(asset.limits).length) {
      this.panel.showHint('No temperature of this asset has a limit.', '–', false);
      return;
    }
    let highest;
    try {
      highest = await highestSpeed({
        ...field,
        ask: (profile, stepS) => this.ask(profile, seeking.signal, stepS),
        profileAt: (speed) => this.profile(this.steps.slice(0, index + 1)
          .map((step, i) => (i === index ? { ...step, speed_rpm: speed } : step))),
      });
    } catch (error) {
      if (!seeking.signal.aborted) {
        this.panel.showHint(`Highest speed of ${of}: no answer, ${error.message}.`, '–', false);
      }
      return;
    }
    if (seeking.signal.aborted || !highest) return;
    this.highest = { index, speed: highest.speed };
    const over = `${channelName(highest.sensor).toLowerCase()} over ${highest.limit} °C`;
    const text = `Highest speed of ${of} with less than 5 % for ${over}, ${at}`;
    if (highest.speed === null) {
      this.panel.showHint(`${text}: more likely at every speed.`, 'None', false);
    } else if (highest.open) {
      this.panel.showHint(text, ['No limit up to ', fixed(highest.speed, 0), unit('rpm')], false);
    } else {
      this.panel.showHint(text, [fixed(highest.speed, 0), unit('rpm')], true);
    }
  }

  // ---------------------------------------------------------------- showing
  follow() {
    const now = situation(this.page.store.state, this.page.clock);
    if (!now) return;
    if (!this.steps && this.page.store.get('forecast')) this.use(this.wished() ?? this.plannedSteps());
    this.show();
  }

  show() {
    const { store, clock } = this.page;
    const now = situation(store.state, clock);
    if (!now) return;
    if (this.steps) this.showTimes(now);
    const fan = now.noForecast === 'the model is not trusted' || !now.live ? null
      : fanFrom(this.answer, now.nowMs, this.names());
    setText(this.ghostText, now.planned ? 'as planned' : 'current point held');
    this.showAnswers(now, fan);
    this.draw(now, fan);
  }

  showTimes(now) {
    let at = this.before()?.to ?? now.nowMs;
    const begins = this.steps.map(({ minutes }) => {
      at += minutes * 60000;
      return at - minutes * 60000;
    });
    this.panel.showTimes(now.speed.value, now.load.value, begins);
  }

  showAnswers(now, fan) {
    if (!now.live) {
      put(this.answers, TITLES.map(([label, title]) => awayTile(label, title)));
      return;
    }
    if (!fan) {
      const why = now.noForecast ?? (this.failure || 'computing …');
      put(this.answers, TITLES.map(([label, title]) => noForecastTile(label, title, why)));
      return;
    }
    const { limits, readings, nowMs } = now;
    const whole = judgeProfile({ forecast: this.answer, fan, limits, nowMs });
    if (!whole.word) {
      put(this.answers, TITLES.map(([label, title]) => noForecastTile(label, title, 'no limits')));
      return;
    }
    const planned = now.planned && now.fan
      && overSpan(now.fan, whole.peak.sensor, whole.peak.limits, nowMs, Infinity);
    const toLimit = timeAlongProfile({ forecast: this.answer, fan, readings, limits, nowMs });
    // No word without its inputs: what the machine's own verdict lacks, a profile's lacks too.
    const [profile, , limit] = TITLES.map(([label, title]) => missingTile(label, title, now));
    const known = now.missing.every((name) => name === 'forecast');
    put(this.answers, known ? profileTile(whole) : profile, peakTile(whole, planned),
      known ? timeToLimitTile(toLimit, now) : limit);
  }

  draw(now, fan) {
    const { store, clock } = this.page;
    const { history } = store.state;
    if (!history) return;
    const endMs = fan?.times.at(-1) ?? now.endMs ?? now.nowMs + HOUR_MS;
    const [least, most] = PAST_MS;
    const pastMs = Math.min(most, Math.max(least, PAST_SHARE * (endMs - now.nowMs)));
    const fromMs = now.nowMs - pastMs;
    const { times, columns } = history.columns(fromMs, now.nowMs, 1500 * clock.rate);
    const span = { nowMs: now.nowMs, fromMs, endMs, times };
    const sensors = this.sensors();
    const limits = Object.fromEntries(
      Object.entries(now.limits).filter(([sensor]) => sensors.includes(sensor)));
    const steps = fan ? stepsFrom(this.answer, now.nowMs) : [];
    const lanes = [
      { name: 'Speed', unit: 'rpm', key: 'speed_rpm', values: columns.speed_rpm },
      { name: 'Load', unit: 'N', key: 'load_n', values: columns.load_n },
    ];
    this.trend.update({
      ...span, lanes, steps, limits, fan: this.band.drawn(fan), ghost: now.fan, lostMs: now.lostMs, sensors,
      crossings: crossingsAhead(this.answer, fan, limits, now.nowMs),
      past: Object.fromEntries(sensors.map((sensor) => [sensor,
        { measured: columns[sensor], twin: columns[`${sensor}.twin`] }])),
      current: Object.fromEntries(sensors.map((sensor) =>
        [sensor, readChannel(store.state, clock, sensor)])),
    });
    const lane = (reading, name) => ({
      ...span, values: columns[name], current: reading.usable ? reading.value : null, steps,
      key: name,
    });
    this.speed.update(lane(now.speed, 'speed_rpm'));
    this.load.update(lane(now.load, 'load_n'));
  }

  // ---------------------------------------------------------------- keeping
  address() {
    return `${location.hash.split('?')[0] || '#whatif'}?${linkOf(this.steps, this.fromEnd)}`;
  }

  /** A page that is loaded again tries the same, and so does this view when it is opened again. */
  keepInAddress() {
    const { steps, fromEnd, page } = this;
    page.tried = { assetId: page.live.assetId, steps, fromEnd };
    history.replaceState(null, '', this.address());
  }

  async copyLink() {
    this.keepInAddress();
    try {
      await navigator.clipboard.writeText(location.href);
      this.page.notify('Link copied.');
    } catch {
      this.page.notify(`Copy failed. Link: ${location.href}`);
    }
  }

  save() {
    const ambient = readChannel(this.page.store.state, this.page.clock, 'ambient_c').value;
    const profile = this.profile();
    const lengthS = profile.reduce((sum, step) => sum + step.duration_s, 0);
    const highest = Math.max(...profile.map((step) => step.speed_rpm));
    const file = new Blob([csvOf(profile, ambient)], { type: 'text/csv' });
    const href = URL.createObjectURL(file);
    h('a', {
      href,
      download: `profile-${spanText(lengthS).replaceAll(' ', '')}-${fixed(highest, 0)}rpm.csv`,
    }).click();
    setTimeout(() => URL.revokeObjectURL(href), 10000);
  }
}
