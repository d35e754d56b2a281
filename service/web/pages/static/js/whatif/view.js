// What-if: change the plan and the twin answers at once. Nothing here ever commands the bench.
// view: {"place": 30, "title": "What-if", "from": "operator"}
import { assetPath, call, saveText } from '../app/api.js';
import { BandChoice, chosenBand } from '../forecast/band_choice.js';
import { distinctSteps, fanFrom, overSpan, stepsFrom } from '../forecast/forecast.js';
import {
  channelName, fixed, hourMinute, labelText, lowerName, percent, spanText, wholeMinute,
} from '../parts/format.js';
import { button, choice, gap, key, Panel, problem, section, v } from '../parts/panel.js';
import { highestSpeed, LatestQuestion } from './questions.js';
import { ForecastCharts, limitsOfSensors } from '../charts/forecast_charts.js';
import { csvOf, fieldsFor, fromLink, linkOf, MOST_STEPS, requestProfile } from './profile.js';
import { chartSensors, readChannel } from '../live/readings.js';
import { crossingsAhead, NEVER_IDENTIFIED, situation } from '../live/situation.js';
import {
  computingTile, missingTile, noForecastTile, offlineTile, peakTile, profileTile, timeToLimitTile,
} from '../forecast/tiles.js';
import { judgeProfile, marginText, marginTitle, safeBelow, timeAlongProfile } from '../forecast/verdict.js';
import { NumberField } from '../parts/number_field.js';

/**
 * begins: the times in ms when the steps begin; endMs: when the present step ends, null where it does
 * not; failure: why there is no answer, or ''; hint: { text, figure (null while it is sought), usable }.
 */
class ProfilePanel extends Panel {
  wrong = {}; // what is wrong with a figure, by its place

  render({ steps, begins, fields, failure, hint, actions }) {
    const ready = Boolean(steps);
    const isFull = ready && steps.length >= MOST_STEPS;
    const act = (text, action, given) => button(text, action, { class: 'btn', disabled: !ready, ...given });
    return section('p-profile', 'Test profile', [gap(), choice('Begin with',
      ['planned', 'hold', 'cool down'].map((name) => [name, name]), undefined, actions.preset)],
      v('div', { class: 'steps' }, ready && [this.present(), steps.map((step, index) => v('div', { class: 'step' },
        v('header', {}, v('b', {}, `Step ${index + 1}`),
          v('span', { class: 'hd' }, begins && `from ${hourMinute(wholeMinute(begins[index]))}`),
          steps.length > 1 && button('Remove', () => actions.remove(index),
            { 'aria-label': `Remove step ${index + 1}` })),
        Object.entries(fields).map(([name, field]) => this.slider(step, index, name, field))))]),
      problem(Object.values(this.wrong).find(Boolean) ?? (failure && `No answer: ${failure}.`)),
      v('div', { class: 'row foot' }, act('Add step', actions.add, isFull
        ? { disabled: true, title: `At most ${MOST_STEPS} steps` } : {}),
      gap(), act('Copy link', actions.copyLink), act('Save as CSV', actions.save)),
      v('div', { class: 'hint' }, v('p', { class: 's mut' }, hint?.text), v('div', { class: 'row' },
        v('p', { class: 'v', role: 'status' }, hint && (hint.figure ?? '…')), gap(),
        hint?.usable && act('Use this speed', actions.useSpeed))));
  }

  present() {
    const { present: { speed, load }, endMs, fromEnd, actions } = this.props;
    const ends = [[false, 'now'],
      ...endMs === null ? [] : [[true, `end of current step (${hourMinute(wholeMinute(endMs))})`]]];
    return v('div', { class: 'step cur' },
      v('header', {}, v('b', {}, `${Math.abs(speed) < 1 ? 'Standstill' : `Running: ${fixed(speed, 0)} rpm`}, `
        + `${fixed(load, 0)} N`)),
      v('div', { class: 'row' }, v('span', { class: 'hd' }, 'Try from'),
        choice('Try from', ends, fromEnd, actions.tryFrom)));
  }

  slider(step, index, name, { name: title, unit, low, high, step: by, least = low, most }) {
    const id = `step${index}-${name}`;
    const value = step[name];
    const change = (figure, fault = '') => {
      const wrong = fault || (figure === null ? `expected ${least} to ${most} ${unit}` : '');
      this.wrong = { ...this.wrong, [id]: wrong && `Step ${index + 1}, ${title}: ${wrong}.` };
      if (wrong) this.draw();
      else this.props.actions.change(index, name, figure);
    };
    return v('div', { class: 'sl' }, v('label', { for: id }, title), v('input', {
      id, type: 'range', min: low, max: Math.max(high, value), step: by, value, 'aria-valuetext': `${value} ${unit}`,
      oninput: ({ target }) => change(Number(target.value)),
    }), v('span', { class: 'num' }, v(NumberField, { 'aria-label': `${title}, step ${index + 1}, ${unit}`, least, most,
      step: by, unit, unitShown: true, value, oninput: change })));
  }
}

const HOUR_MS = 3600e3;
const PAST_SHARE = 0.22; // of what lies ahead, within these bounds
const PAST_MS = [HOUR_MS, 3 * HOUR_MS];
const QUIET_MS = 500; // after the last change, before the slower questions are asked
const REFRESH_S = 60; // of process time: the present state moves on under a profile that stays
const REFRESH_MS = [1500, 10000];
const ROWS = 160; // of an answer: about as many as the chart has room for
const FINEST_S = 30;
const TITLES = ['This profile', 'Peak', 'Time to limit'];

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { steps: null, answer: null, failure: '', hint: null, fromEnd: false,
      touched: 0 }); // the step that was changed last
    this.question = new LatestQuestion({
      ask: ({ profile }, signal) => this.ask(profile, signal),
      answered: (answer, question, ms) => this.take(answer, question, ms),
      failed: (error) => this.set({ answer: null, failure: error.message }),
    });
    this.actions = {
      preset: (name) => this.page.store.get('forecast') && this.use(this.preset(name)),
      add: () => this.use([...this.steps, { ...this.steps.at(-1) }], this.steps.length),
      remove: (index) => this.use(this.steps.filter((_, i) => i !== index)),
      tryFrom: (fromEnd) => {
        this.fromEnd = fromEnd;
        this.use(this.steps, this.touched);
      },
      change: (index, name, value) => this.use(this.steps.with(index, { ...this.steps[index], [name]: value }), index),
      copyLink: () => this.copyLink(),
      save: () => this.save(),
      useSpeed: () => this.actions.change(this.highest.index, 'speed_rpm', this.highest.speed),
    };
    this.follow(this.page.store, ['tags', 'history', 'asset', 'forecast', 'link'], 1000, () => this.begin());
    this.follow(this.page.store, ['link'], 0);
    this.endings.push(() => this.question.stop());
    this.refresh();
    this.begin();
  }

  // -- the profile
  presentStep(minutes) {
    const { store, clock } = this.page;
    const value = (channel) => Math.round((readChannel(store.state, clock, channel).value ?? 0) / 50) * 50;
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
    const wished = fromLink(location.hash.split('?')[1] ?? '') ?? (tried?.assetId === live.assetId ? tried : null);
    if (wished) this.fromEnd = wished.fromEnd;
    return wished && wished.steps.map((step) => ({ ...step }));
  }

  coming() {
    const { store, clock } = this.page;
    return distinctSteps(stepsFrom(store.get('forecast'), clock.now()));
  }

  /** Try these steps; `touched` is the one that the hint speaks of. */
  use(steps, touched = 0) {
    this.steps = steps.length ? steps : [this.presentStep(60)];
    this.touched = Math.min(touched, this.steps.length - 1);
    const coming = this.coming();
    this.endMs = coming.length > 1 ? coming[0].to : null;
    if (this.endMs === null) this.fromEnd = false;
    this.draw();
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

  // -- asking
  /** Ask at once; what takes longer waits until the hand is still. */
  changed() {
    this.put();
    this.request?.abort();
    clearTimeout(this.quiet);
    this.quiet = this.after(QUIET_MS, () => {
      this.keepInAddress();
      this.seekHighest();
    });
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
    this.after(everyMs, () => this.refresh());
  }

  sensors() {
    return chartSensors(this.page.store.get('asset'));
  }

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
    this.set({ failure: '', took: `Answered in ${Math.round(ms)} ms`,
      answer: { ...answer, made_at: answer.made_at ?? new Date(madeMs).toISOString(), profile } });
  }

  /** Up to which speed the step that was changed last keeps the warning improbable. */
  async seekHighest() {
    const { link, forecast, asset } = this.page.store.state;
    if (!this.steps || !forecast || link.status !== 'live') return;
    const signal = this.newSignal();
    const index = this.touched;
    const { load_n: load, minutes } = this.steps[index];
    const { speed_rpm: field } = this.fields();
    const of = `step ${index + 1}`;
    const safe = safeBelow(asset);
    const at = `at ${fixed(load, 0)} N for ${spanText(minutes * 60)}`;
    const say = (text, figure, usable = false) => this.set({ hint: { text, figure, usable } });
    say(`Highest speed of ${of} with less than ${percent(safe)} over a warning limit, ${at}`, null);
    const hinder = this.steps[index].speed_rpm === 0 ? `Step ${index + 1} is a standstill.`
      : !Object.keys(asset.limits).length && 'No temperature of this asset has a limit.';
    if (hinder) {
      say(hinder, '–');
      return;
    }
    let highest;
    try {
      highest = await highestSpeed({
        ...field, safe, ask: (profile, stepS) => this.ask(profile, signal, stepS),
        profileAt: (speed) => this.profile(this.steps.slice(0, index + 1)
          .map((step, i) => (i === index ? { ...step, speed_rpm: speed } : step))),
      });
    } catch (error) {
      if (!signal.aborted) say(`Highest speed of ${of}: no answer, ${error.message}.`, '–');
      return;
    }
    if (signal.aborted || !highest) return;
    this.highest = { index, speed: highest.speed };
    const over = `${lowerName(highest.sensor)} over ${highest.limit} °C`;
    const text = `Highest speed of ${of} with less than ${percent(safe)} for ${over}, ${at}`;
    const rpm = [fixed(highest.speed, 0), v('span', { class: 'u' }, 'rpm')];
    if (highest.speed === null) say(`${text}: more likely at every speed.`, 'None');
    else if (highest.open) say(text, ['No limit up to ', rpm]);
    else say(text, rpm, true);
  }

  // -- showing
  begin() {
    const now = situation(this.page.store.state, this.page.clock);
    if (now && !this.steps && this.page.store.get('forecast')) this.use(this.wished() ?? this.plannedSteps());
    this.draw();
  }

  render() {
    const { page: { store, clock }, steps, answer } = this;
    const now = situation(store.state, clock);
    const fan = !now || now.noForecast === 'the model is not trusted' || !now.live ? null
      : fanFrom(answer, now.nowMs, this.names());
    const unknown = Object.entries(answer?.not_known ?? {})
      .map(([name, why]) => `${channelName(name)} not known, ${why}`);
    this.shown = now && [now, fan];
    return [
      v('h1', { class: 'vh' }, 'What-if'),
      v(ProfilePanel, { steps, fields: steps && this.fields(), begins: now && steps && this.begins(now),
        endMs: this.endMs, fromEnd: this.fromEnd, failure: this.failure, hint: this.hint, actions: this.actions,
        present: { speed: now?.speed.value, load: now?.load.value } }),
      v('div', { class: 'wr' }, v('div', { class: 'answers' }, now && this.tiles(now, fan)),
        v('section', { class: 'panel p-trend' },
          v('header', {}, v('h2', { title: answer ? this.took : '' }, 'Forecast for this profile, °C'),
            v('span', { class: 'labels' }, [...(answer?.labels ?? []).map(labelText), ...unknown]
              .map((text) => v('span', { class: 'chip dash' }, text))),
            v('span', { class: 'keys' }, key('tw', 'median'),
              v(BandChoice, { page: this.page, onchange: this.draw }),
              key('pl', v('span', {}, now && !now.planned ? 'current point held' : 'as planned')))),
          v('p', { class: 's mut margin', title: marginTitle(answer?.runaway_margin) },
            marginText(answer?.runaway_margin)),
          v(ForecastCharts, { page: this.page, syncKey: 'whatif', ref: (charts) => { this.charts = charts; } }))),
    ];
  }

  begins(now) {
    let at = this.before()?.to ?? now.nowMs;
    return this.steps.map(({ minutes }) => {
      at += minutes * 60000;
      return at - minutes * 60000;
    });
  }

  tiles(now, fan) {
    const { store } = this.page;
    if (!now.live) return TITLES.map((title) => offlineTile(title, title));
    if (!fan) {
      // Who asks is answered from the prior, too; the words are unknown then.
      const why = now.noForecast === NEVER_IDENTIFIED ? this.failure : now.noForecast ?? this.failure;
      return TITLES.map((title) => (why ? noForecastTile(title, title, why) : computingTile(title, title)));
    }
    const { limits, readings, nowMs } = now;
    const asked = { forecast: this.answer, fan, limits, nowMs, safe: safeBelow(store.get('asset')) };
    const whole = judgeProfile(asked);
    if (!whole.word) return TITLES.map((title) => noForecastTile(title, title, 'no limits'));
    const planned = now.planned && now.fan && overSpan(now.fan, whole.peak.sensor);
    const toLimit = timeAlongProfile({ ...asked, readings });
    // No word without its inputs: what the machine's own verdict lacks, a profile's lacks too.
    const [profile, , limit] = TITLES.map((title) => missingTile(title, title, now));
    const known = now.missing.every((name) => name === 'forecast');
    return [known ? profileTile(whole) : profile, peakTile(whole, planned),
      known ? timeToLimitTile(toLimit, now) : limit];
  }

  componentDidMount() {
    this.componentDidUpdate();
  }

  componentDidUpdate() {
    if (this.shown) this.drawCharts(...this.shown);
  }

  drawCharts(now, fan) {
    if (!this.page.store.get('history')) return;
    const { nowMs } = now;
    const endMs = fan?.times.at(-1) ?? now.endMs ?? nowMs + HOUR_MS;
    const [least, most] = PAST_MS;
    const sensors = this.sensors();
    this.charts.show(now, {
      fromMs: nowMs - Math.min(most, Math.max(least, PAST_SHARE * (endMs - nowMs))), endMs, sensors,
      steps: fan ? stepsFrom(this.answer, nowMs) : [], fan: chosenBand(this.page, fan), ghost: now.fan,
      crossings: crossingsAhead(this.answer, fan, limitsOfSensors(now, sensors), nowMs),
    });
  }

  // -- keeping
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
    saveText(`profile-${spanText(lengthS).replaceAll(' ', '')}-${fixed(highest, 0)}rpm.csv`,
      csvOf(profile, ambient), 'text/csv');
  }
}
