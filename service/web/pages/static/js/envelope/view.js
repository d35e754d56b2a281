// Safe operating envelope over speed and load: where the machine may go from here.
// view: {"place": 40, "title": "Envelope", "from": "viewer"}
import { assetPath, call } from '../app/api.js';
import { EnvelopeMap } from './map.js';
import { distinctSteps, stepsFrom } from '../forecast/forecast.js';
import {
  celsius, channelName, dayOrTime, fixed, isNumber, labelText, milliseconds, percent, spanText,
  wholeSpan,
} from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { button, choice, gap, Hosted, Panel, plainTable, problem, v } from '../parts/panel.js';
import { chanceAt, nearestAt, planeOf, valueAt } from './plane.js';
import { missingNames } from '../live/verdict.js';
import { readChannel } from '../live/readings.js';
import { situation } from '../live/situation.js';
import { ALARM_LIKELY, priorityFor, safeBelow } from '../forecast/verdict.js';

const REFRESH_MS = 15000;
const PATIENCE_MS = 60000;
const QUICK_MS = 700; // an answer that takes longer is announced
const RUNAWAY_C = 450; // stands for a member that has run away

const lastAnswers = new Map(); // by asset; shown while a new one is computed

/** The word for a point, from its probabilities; `priority` 0 is calm. */
export const verdictAt = (warning, alarm, safe) =>
  ({ word: warning < safe ? 'Safe' : 'Not safe', priority: priorityFor(warning, alarm, safe) });

const symbol = (priority, size) => (priority ? icon(priority, 'dashed', size) : icon('ok', 'filled', size));

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { mode: 'temperature', sensor: null, probe: null,
      answer: lastAnswers.get(this.page.live.assetId) ?? null });
    this.follow(this.page.store, ['forecast', 'link', 'tags'], 1000);
    this.poll(REFRESH_MS, () => this.load());
  }

  /** The envelope as the service has it; it keeps one until the machine has changed. */
  async load() {
    if (this.isAsking || (this.page.store.get('link').status !== 'live' && this.answer)) return;
    const { assetId } = this.page.live;
    const signal = this.newSignal(); // aborted when the view is left: the service then computes none
    this.isAsking = true;
    const slow = setTimeout(() => this.set({ slow: true }), QUICK_MS);
    try {
      this.answer = await call(assetPath(assetId, '/envelope'), { signal, timeoutMs: PATIENCE_MS });
      lastAnswers.set(assetId, this.answer);
      this.problem = '';
    } catch (error) {
      if (signal.aborted) return;
      const busy = error.message.startsWith('busy:');
      this.problem = `${busy ? error.message.replace('busy:', 'Busy:')
        : `No envelope: ${error.message}`}. Retrying in ${REFRESH_MS / 1000} s.`;
    } finally {
      clearTimeout(slow);
      this.isAsking = false;
      this.set({ slow: false });
    }
  }

  trusted() {
    return this.page.store.get('asset')?.active_model?.trusted !== false;
  }

  scene() {
    const { answer, page: { store, clock } } = this;
    const sensors = Object.keys(answer.sensors);
    if (!sensors.includes(this.sensor)) [this.sensor] = sensors;
    const maps = answer.sensors[this.sensor];
    const { warning, alarm } = maps.limits;
    const limits = warning ? { warning: warning.limit_c, alarm: alarm.limit_c } : null;
    if (!limits) this.mode = 'temperature';
    const plane = planeOf(answer);
    const now = (name, kept) => {
      const reading = readChannel(store.state, clock, name);
      return reading.usable ? reading.value : kept;
    };
    // No word without its inputs: what the machine's own verdict lacks, a point's lacks too.
    const live = situation(store.state, clock);
    const missing = live?.missing.filter((name) => name !== 'forecast');
    this.lacks = live?.live ? missingNames(missing) : 'the service does not answer';
    const { speed_rpm: speed, load_n: load } = answer.present;
    const present = {
      speed: now('speed_rpm', speed), load: now('load_n', load), reading: now(this.sensor, null),
    };
    const ahead = clock.now() === null ? [] : distinctSteps(stepsFrom(store.get('forecast'), clock.now()));
    const steps = ahead.slice(1).map((step) => ({ speed: step.speed_rpm, load: step.load_n }));
    this.probe ??= steps[0] ?? {
      speed: Math.max(present.speed, plane.low.speed), load: Math.max(present.load, plane.low.load),
    };
    return { answer, maps, limits, present, steps, sensors, plane, mode: this.mode, probe: this.probe };
  }

  render() {
    const { answer } = this;
    const scene = answer && this.scene();
    this.safe = safeBelow(this.page.store.get('asset'));
    const nowMs = this.page.clock.now();
    const madeMs = milliseconds(answer?.made_at);
    const modes = scene && [['temperature', 'steady temperature'],
      ...scene.limits ? [['time', `time to ${scene.limits.warning} °C`]] : []];
    return [
      v('h1', { class: 'vh' }, 'Envelope'),
      v('section', { class: `panel p-map${answer ? '' : ' loading'}` },
        v('header', {}, v('h2', {}, 'Safe operating envelope'), gap(), scene && [
          choice('Sensor', scene.sensors.map((sensor) => [sensor, channelName(sensor)]), this.sensor,
            (sensor) => this.set({ sensor })),
          choice('What the map shows', modes, this.mode, (mode) => this.set({ mode }))]),
        answer && !this.trusted() && v('p', { class: 'distrust', role: 'alert' }, icon('bad'),
          ' The model is not trusted. Do not rely on this map.'),
        problem(this.problem),
        v(Hosted, { class: 'map', make: (box) => new EnvelopeMap(box, (probe) => this.set({ probe })),
          show: (map) => scene && map.update({ ...scene, safe: this.safe }) }),
        v('p', { class: 's mut', role: 'status' }, !answer ? !this.problem && 'Computing the envelope …'
          : [`Each point is held until steady, from the present state; times within ${wholeSpan(answer.horizon_s)}`,
            ...answer.labels.map(labelText)].join('; ')),
        v('p', { class: 's mut', role: 'status' }, answer && nowMs !== null
          && `Map of ${dayOrTime(madeMs, nowMs)}, ${spanText((nowMs - madeMs) / 1000)} old`
            + `${this.slow ? '. Computing a new one …' : ''}`)),
      v('div', { class: 'side' },
        v('section', { class: 'panel', id: 'probe', 'aria-live': 'polite' }, scene && this.point(scene)),
        v('section', { class: 'panel' }, scene && this.steps(scene)),
        v('section', { class: 'panel' }, scene && legendOf(scene.limits, this.safe))),
    ];
  }

  point(scene) {
    const { plane, maps, limits, probe } = scene;
    const { speed, load } = probe;
    const chances = chancesAt(scene, probe);
    const at = (matrix) => valueAt(plane, matrix, speed, load);
    const degrees = (value) => (isNumber(value) && value < RUNAWAY_C ? celsius(value) : 'thermal runaway');
    const rows = [['Steady, median', degrees(at(maps.steady_c.q50))],
      ['Upper bound (97.5 %)', degrees(at(maps.steady_c.q975))]];
    for (const [i, level] of limits ? ['warning', 'alarm'].entries() : []) {
      const median = nearestAt(plane, maps.limits[level].median_s, speed, load);
      const first = nearestAt(plane, maps.limits[level].earliest_s, speed, load);
      rows.push([`Over ${limits[level]} °C when steady`, percent(chances[i])],
        ['median time', median === null ? `not within ${wholeSpan(this.answer.horizon_s)}` : spanText(median)],
        ['earliest time', first === null ? '–' : spanText(first)]);
    }
    const { runaway } = this.answer;
    const open = nearestAt(plane, runaway.not_excluded, speed, load);
    rows.push(['Thermal runaway', `${open ? 'not ruled out' : 'unlikely'}, ${percent(at(runaway.probability))}`]);
    const [kelvins, newtons] = [runaway.margin_k, runaway.margin_n].map(
      (matrix) => nearestAt(plane, matrix, speed, load));
    if (isNumber(kelvins)) rows.push(['margin', `${fixed(kelvins, 0)} K`]);
    if (isNumber(newtons)) rows.push(['load to 5 %', `${newtons > 0 ? '+' : ''}${fixed(newtons, 0)} N`]);
    const handOver = (role, view, text) => this.page.may(role) && button(text, () => {
      this.page.wish = { speed_rpm: speed, load_n: load };
      location.hash = view;
    }, { class: 'btn' });
    return [v('header', {}, v('h2', {}, `At ${fixed(speed, 0)} rpm, ${fixed(load, 0)} N`)),
      chances && this.head(chances),
      v('dl', { class: 'kv' }, rows.map(([name, value]) => [v('dt', {}, name), v('dd', {}, value)])),
      open && v('p', { class: 'open' }, icon(2, 'dashed'), 'Thermal runaway is not ruled out here'),
      v('div', { class: 'row foot' }, handOver('operator', 'whatif', 'Try in what-if'),
        handOver('engineer', 'engineer', 'Reduce uncertainty here'))];
  }

  /** The word for the probe, or why it has none. */
  head(chances) {
    const { word, priority } = verdictAt(...chances, this.safe);
    if (this.trusted() && !this.lacks) {
      return v('div', { class: `verd${priority ? ` p${priority}` : ''}` },
        symbol(priority, '1em'), v('span', { class: 'word' }, word));
    }
    return [v('div', { class: 'verd bt' }, icon('bad', 'hollow', '1em'),
      v('span', { class: 'word' }, this.trusted() ? 'Unknown' : 'Not trusted')),
    this.lacks && v('p', { class: 's mut' }, this.lacks)];
  }

  steps(scene) {
    const isJudged = Boolean(scene.limits) && this.trusted() && !this.lacks;
    const rows = [scene.present, ...scene.steps].map((step) => {
      const chances = chancesAt(scene, step);
      return { ...step, chances, ...(isJudged && verdictAt(...chances, this.safe)) };
    });
    return [v('header', {}, v('h2', {}, 'Planned steps')), plainTable([
      ['', (_, i) => (i ? v('b', {}, i) : 'now')],
      ['', ({ speed }) => [fixed(speed, 0), v('span', { class: 'u' }, 'rpm')], 'r'],
      ['', ({ load }) => [fixed(load, 0), v('span', { class: 'u' }, 'N')], 'r'],
      isJudged && ['', ({ word, priority }) => [symbol(priority, '1.3em'), ' ', word], 'nw'],
      isJudged && ['', ({ chances }) => percent(chances[0]), 'r b']], rows)];
  }
}

/** How probable warning and alarm are at a point; null without limits. @returns {any} */
const chancesAt = ({ plane, maps, limits, present }, at) => limits && ['warning', 'alarm'].map((level) =>
  chanceAt(plane, maps.limits[level], at, present));

function legendOf(limits, safe) {
  const box = (...parts) => v('svg', { viewBox: '0 0 34 22', 'aria-hidden': 'true' }, parts);
  const ground = (fill, opacity) => v('rect', { width: 34, height: 22, fill, opacity });
  const circle = (r, more) => v('circle', { cx: 17, cy: 11, r, ...more });
  const items = [
    ...limits ? [
      [box(v('rect', { width: 34, height: 22, fill: 'var(--panel-2)', stroke: 'var(--line)' })),
        `under ${percent(safe)} over ${limits.warning} °C: safe`],
      [box(ground('var(--p2)', 0.55)), `${percent(safe)} or more: not safe`],
      [box(ground('var(--p1)', 0.7)), `and ${percent(ALARM_LIKELY)} or more over ${limits.alarm} °C`],
    ] : [],
    [box(circle(8, { fill: 'none', stroke: 'var(--ink)', 'stroke-width': 3 }),
      circle(2.5, { fill: 'var(--ink)' })), 'current operating point'],
    [box(v('path', { d: 'M2 11H32', stroke: 'var(--ink)', 'stroke-width': 2, 'stroke-dasharray': '5 4' }),
      circle(6, { fill: 'var(--panel)', stroke: 'var(--ink)', 'stroke-width': 2 })), 'planned steps in order'],
    [box(v('rect', { x: 2, y: 2, width: 30, height: 18, fill: 'none', stroke: 'var(--twin)', 'stroke-width': 2 })),
      'low-risk region (training data)'],
  ];
  return [v('header', {}, v('h2', {}, 'Legend')),
    v('div', { class: 'lk' }, items.map(([drawn, text]) => [drawn, v('span', {}, text)]))];
}
