// What-if: change the plan and the twin answers at once. Nothing here ever commands the bench.
import { assetPath, call } from '../api.js';
import { h, put, setText } from '../dom.js';
import { distinctSteps, fanFrom, overSpan, stepsFrom } from '../forecast.js';
import { fixed, hourMinute, spanText, wholeMinute } from '../format.js';
import { LaneChart } from '../lane.js';
import { SENSORS } from '../live.js';
import { readChannel } from '../readings.js';
import { crossingsAhead, situation } from '../situation.js';
import { awayTile, noForecastTile, peakTile, profileTile, timeToLimitTile } from '../tiles.js';
import { TrendChart } from '../trend.js';
import { answerNextStep, answerTimeToLimit } from '../verdict.js';

const HOUR_MS = 3600e3;
const PAST_MS = HOUR_MS;
const PATIENCE_MS = 60; // a slider sends an event per pixel; the service is asked this often
const REFRESH_MS = 10000; // the present state moves on under a profile that stays
const MOST_STEPS = 12;
const FIELDS = {
  speed_rpm: { name: 'Speed', unit: 'rpm', low: 0, high: 7000, step: 50, most: 20000 },
  load_n: { name: 'Load', unit: 'N', low: 0, high: 7000, step: 50, most: 200000 },
  minutes: { name: 'Duration', unit: 'min', low: 5, high: 240, step: 5, most: 1440 },
};

const rounded = (value, step) => Math.round(value / step) * step;

export class WhatIfView {
  constructor(box, page) {
    this.page = page;
    this.steps = null;
    this.fromEnd = false;
    this.answer = null;
    this.answers = h('div', { class: 'answers' });
    this.stepList = h('div', { class: 'steps' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.latency = h('span', { class: 'chip', hidden: true });
    this.boxes = {
      temperature: h('div', { class: 'plot t', role: 'img', 'aria-label': 'Forecast' }),
      speed: h('div', { class: 'plot sp1' }),
      load: h('div', { class: 'plot ld1' }),
    };
    put(box, h('h1', { class: 'vh' }, 'What-if'), this.createControls(), this.createResult());
    this.trend = new TrendChart(this.boxes.temperature, 'whatif');
    this.speed = new LaneChart(this.boxes.speed, { label: 'Speed, rpm', syncKey: 'whatif' });
    this.load = new LaneChart(this.boxes.load,
      { label: 'Load, N', syncKey: 'whatif', showTime: true });
    this.endings = [page.store.on(['tags', 'history', 'asset', 'forecast', 'link'],
      () => this.follow(), 1000)];
    this.timer = setInterval(() => this.ask(), REFRESH_MS);
    this.follow();
  }

  destroy() {
    clearInterval(this.timer);
    clearTimeout(this.pending);
    this.asking?.abort();
    this.endings.forEach((end) => end());
    [this.trend, this.speed, this.load].forEach((chart) => chart.destroy());
  }

  createControls() {
    const preset = (text, steps) => h('button', {
      type: 'button', onclick: () => this.use(steps()),
    }, text);
    this.add = h('button', {
      class: 'btn', type: 'button', disabled: true, onclick: () => this.addStep(),
    }, 'Add step');
    this.saveButton = h('button', {
      class: 'btn', type: 'button', disabled: true, onclick: () => this.save(),
    }, 'Save as CSV');
    return h('section', { class: 'panel' },
      h('header', {}, h('h2', {}, 'Profile to try'), h('span', { class: 'sp' }),
        h('span', { class: 'seg' },
          preset('planned', () => this.plannedSteps()),
          preset('hold', () => [this.presentStep(180)]),
          preset('cool down', () => [{ ...this.presentStep(120), speed_rpm: 1500 }]))),
      this.stepList, this.problem,
      h('div', { class: 'row foot' }, this.add, h('span', { class: 'sp' }),
        this.saveButton));
  }

  createResult() {
    const key = (look, text) => h('span', { class: 'key' }, h('i', { class: look }), text);
    return h('div', { class: 'wr' }, this.answers, h('section', { class: 'panel p-trend' },
      h('header', {}, h('h2', {}, 'Forecast for this profile, °C'),
        h('span', { class: 'keys' }, key('tw', 'median'), key('f50', '50 %'), key('f95', '95 %'),
          key('pl', 'as planned'), this.latency)),
      this.boxes.temperature, this.boxes.speed, this.boxes.load));
  }

  // ---------------------------------------------------------------- the profile
  presentStep(minutes) {
    const { state } = this.page.store;
    const value = (channel) => readChannel(state, this.page.clock, channel).value ?? 0;
    return {
      speed_rpm: rounded(value('speed_rpm'), 50), load_n: rounded(value('load_n'), 50), minutes,
    };
  }

  plannedSteps() {
    const steps = this.coming().map(({ speed_rpm, load_n, duration_s }) =>
      ({ speed_rpm: Math.round(speed_rpm), load_n: Math.round(load_n),
        minutes: Math.max(1, Math.round(duration_s / 60)) }));
    return steps.length > 1 && this.fromEnd ? steps.slice(1, MOST_STEPS) : steps.slice(0, MOST_STEPS);
  }

  /** The point that another view hands over, as a profile; null when there is none. */
  wished() {
    const { wish } = this.page;
    this.page.wish = null;
    return wish && [{ ...wish, minutes: 120 }];
  }

  /** The plan from now on, the present step first. */
  coming() {
    const { store, clock } = this.page;
    return distinctSteps(stepsFrom(store.get('forecast'), clock.now()));
  }

  use(steps) {
    this.steps = steps.length ? steps : [this.presentStep(60)];
    this.buildSteps();
    this.askSoon();
  }

  addStep() {
    this.use([...this.steps, { ...this.steps.at(-1) }]);
  }

  buildSteps() {
    this.starts = this.steps.map(() => h('span', { class: 'hd' }));
    put(this.stepList, this.presentRow(), this.steps.map((step, i) => h('div', { class: 'step' },
      h('header', {}, h('b', {}, `Step ${i + 1}`), this.starts[i],
        this.steps.length > 1 && h('button', {
          class: 'btn sm', type: 'button', 'aria-label': `Remove step ${i + 1}`,
          onclick: () => this.use(this.steps.filter((one) => one !== step)),
        }, 'Remove')),
      Object.entries(FIELDS).map(([name, field]) => this.slider(step, i, name, field)))));
    this.add.disabled = this.steps.length >= MOST_STEPS;
    this.saveButton.disabled = false;
  }

  presentRow() {
    const choose = (fromEnd, text) => h('button', {
      type: 'button', 'aria-pressed': String(this.fromEnd === fromEnd),
      onclick: () => {
        this.fromEnd = fromEnd;
        this.use(this.steps);
      },
    }, text);
    this.present = h('b', {});
    const steps = this.coming();
    if (steps.length < 2) this.fromEnd = false;
    return h('div', { class: 'step cur' }, h('header', {}, this.present),
      h('div', { class: 'row' }, h('span', { class: 'hd' }, 'Try from'),
        h('span', { class: 'seg' }, choose(false, 'now'),
          steps.length > 1 && choose(true, `its end at ${hourMinute(wholeMinute(steps[0].to))}`))));
  }

  slider(step, index, name, { name: title, unit, low, high, step: by, most }) {
    const id = `step${index}-${name}`;
    const change = (event, other) => {
      const value = Number(event.target.value);
      if (event.target.value === '' || !(value >= 0) || value > most) return;
      step[name] = value;
      other().value = value;
      this.askSoon();
    };
    const range = h('input', {
      id, type: 'range', min: low, max: Math.max(high, step[name]), step: by, value: step[name],
      oninput: (event) => change(event, () => number),
    });
    const number = h('input', {
      type: 'number', 'aria-label': `${title}, step ${index + 1}, ${unit}`, min: low, max: most,
      step: by, value: step[name], oninput: (event) => change(event, () => range),
    });
    return h('div', { class: 'sl' }, h('label', { for: id }, title), range,
      h('span', { class: 'num' }, number, h('span', { class: 's mut' }, unit)));
  }

  /** The profile as the service takes it. */
  profile() {
    const steps = this.steps.filter((step) => step.minutes > 0).map((step) => ({
      duration_s: step.minutes * 60, speed_rpm: step.speed_rpm, load_n: step.load_n,
    }));
    const [present] = this.coming();
    if (!this.fromEnd || !present) return steps;
    const { speed_rpm, load_n, duration_s } = present;
    return [{ duration_s, speed_rpm, load_n }, ...steps];
  }

  // ---------------------------------------------------------------- asking
  askSoon() {
    clearTimeout(this.pending);
    this.pending = setTimeout(() => this.ask(), PATIENCE_MS);
  }

  /** The latest question wins; the answer to an older one is dropped. */
  async ask() {
    const { link, forecast } = this.page.store.state;
    if (!this.steps || !forecast || link.status !== 'live') return;
    this.asking?.abort();
    const asking = new AbortController();
    this.asking = asking;
    const profile = this.profile();
    const madeMs = this.page.clock.now();
    const askedAt = performance.now();
    const names = [...new Set([...SENSORS, ...Object.keys(this.page.store.get('asset').limits)])];
    try {
      const answer = await call(assetPath(this.page.live.assetId, '/forecasts'),
        { method: 'POST', body: { profile, nodes: names }, signal: asking.signal });
      const made_at = answer.made_at ?? new Date(madeMs).toISOString();
      this.answer = { ...answer, made_at, profile };
      setText(this.problem, '');
      this.latency.hidden = false;
      setText(this.latency, `answered in ${Math.round(performance.now() - askedAt)} ms`);
      this.show();
    } catch (error) {
      if (asking.signal.aborted) return;
      setText(this.problem, `No answer: ${error.message}.`);
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
    if (this.steps) this.showSteps(now);
    const fan = now.noForecast === 'the model is not trusted' || !now.live ? null
      : fanFrom(this.answer, now.nowMs, SENSORS);
    this.showAnswers(now, fan);
    this.draw(now, fan);
  }

  showSteps(now) {
    setText(this.present,
      `Running: ${fixed(now.speed.value, 0)} rpm, ${fixed(now.load.value, 0)} N`);
    let at = this.fromEnd ? this.coming()[0]?.to ?? now.nowMs : now.nowMs;
    this.steps.forEach((step, i) => {
      setText(this.starts[i], `from ${hourMinute(wholeMinute(at))}`);
      at += step.minutes * 60000;
    });
  }

  showAnswers(now, fan) {
    const titles = [['This profile', 'This profile'], ['Peak', 'Peak'],
      ['Time to limit', 'Time to limit']];
    if (!now.live) {
      put(this.answers, titles.map(([label, title]) => awayTile(label, title)));
      return;
    }
    if (!fan) {
      const why = now.noForecast ?? 'waiting for the answer';
      put(this.answers, titles.map(([label, title]) => noForecastTile(label, title, why)));
      return;
    }
    const { limits, readings, nowMs } = now;
    const whole = answerNextStep({ forecast: this.answer, fan, steps: [], limits, nowMs });
    const planned = now.fan
      && overSpan(now.fan, whole.peak.sensor, whole.peak.limits, nowMs, Infinity);
    const toLimit = answerTimeToLimit({ forecast: this.answer, fan, readings, limits, nowMs });
    put(this.answers, profileTile(whole), peakTile(whole, planned), timeToLimitTile(toLimit, now));
  }

  draw(now, fan) {
    const { store, clock } = this.page;
    const { history } = store.state;
    if (!history) return;
    const fromMs = now.nowMs - PAST_MS;
    const { times, columns } = history.columns(fromMs, now.nowMs, 1500 * clock.rate);
    const endMs = fan?.times.at(-1) ?? now.endMs ?? now.nowMs + HOUR_MS;
    const span = { nowMs: now.nowMs, fromMs, endMs, times };
    const limits = Object.fromEntries(
      Object.entries(now.limits).filter(([sensor]) => SENSORS.includes(sensor)));
    this.trend.update({
      ...span, limits, fan, ghost: now.fan, lostMs: now.lostMs, sensors: SENSORS,
      crossings: crossingsAhead(this.answer, fan, limits, now.nowMs),
      past: Object.fromEntries(SENSORS.map((sensor) => [sensor,
        { measured: columns[sensor], twin: columns[`${sensor}.twin`] }])),
      current: Object.fromEntries(SENSORS.map((sensor) =>
        [sensor, readChannel(store.state, clock, sensor)])),
    });
    const steps = fan ? stepsFrom(this.answer, now.nowMs) : [];
    const lane = (reading, name) => ({
      ...span, values: columns[name], current: reading.usable ? reading.value : null, steps,
      key: name,
    });
    this.speed.update(lane(now.speed, 'speed_rpm'));
    this.load.update(lane(now.load, 'load_n'));
  }

  /** The profile as the file that `bearing-twin forecast --profile` reads. */
  save() {
    const ambient = readChannel(this.page.store.state, this.page.clock, 'ambient_c').value;
    const lines = ['time_s,speed_rpm,load_n,ambient_c'];
    let at = 0;
    const steps = this.profile();
    for (const step of steps) {
      lines.push([at, step.speed_rpm, step.load_n, ambient ?? ''].join());
      at += Math.round(step.duration_s);
    }
    const last = steps.at(-1);
    lines.push([at, last.speed_rpm, last.load_n, ambient ?? ''].join());
    const link = h('a', {
      href: `data:text/csv;charset=utf-8,${encodeURIComponent(`${lines.join('\n')}\n`)}`,
      download: `profile-${spanText(at).replaceAll(' ', '')}-${fixed(last.speed_rpm, 0)}rpm.csv`,
    });
    link.click();
  }
}
