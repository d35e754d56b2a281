// Safe operating envelope over speed and load: where the machine may go from here.
import { assetPath, call } from '../api.js';
import { h, put, s, setText } from '../dom.js';
import { EnvelopeMap } from '../envelope_map.js';
import { distinctSteps, stepsFrom } from '../forecast.js';
import {
  celsius, channelName, fixed, isNumber, labelText, percent, spanText, wholeSpan,
} from '../format.js';
import { icon } from '../icons.js';
import { chanceAt, nearestAt, planeOf, valueAt } from '../plane.js';
import { readChannel } from '../readings.js';
import { THRESHOLDS } from '../verdict.js';

const REFRESH_MS = 15000;
const AWAY_C = 450; // stands for a member that has run away
const WORDS = { safe: 'Safe', risk: 'At risk', unsafe: 'Not safe' };

/** The word for a point, from its probabilities; `priority` 0 is calm. */
export function verdictAt(warning, alarm) {
  const word = warning < THRESHOLDS.atRisk ? 'safe'
    : warning < THRESHOLDS.notSafe ? 'risk' : 'unsafe';
  const priority = alarm >= THRESHOLDS.alarm ? 1 : warning >= THRESHOLDS.atRisk ? 2 : 0;
  return { word, priority };
}

const symbol = (priority, size) =>
  (priority ? icon(priority, 'dashed', size) : icon('ok', 'filled', size));

export class EnvelopeView {
  constructor(box, page) {
    this.page = page;
    this.mode = 'temperature';
    this.sensor = null;
    this.answer = null;
    this.probe = null;
    this.side = {
      point: h('section', { class: 'panel', id: 'probe', 'aria-live': 'polite' }),
      steps: h('section', { class: 'panel' }),
      key: h('section', { class: 'panel' }),
    };
    put(box, h('h1', { class: 'vh' }, 'Envelope'), this.createMap(),
      h('div', { class: 'side' }, Object.values(this.side)));
    this.map = new EnvelopeMap(this.mapBox, (probe) => {
      this.probe = probe;
      this.show();
    });
    this.endings = [page.store.on(['forecast', 'link', 'tags'], () => this.show(), 1000)];
    this.timer = setInterval(() => this.load(), REFRESH_MS);
    this.load();
  }

  destroy() {
    clearInterval(this.timer);
    this.endings.forEach((end) => end());
    this.map.destroy();
  }

  createMap() {
    this.title = h('h2', {}, 'Safe operating envelope');
    this.note = h('p', { class: 's mut', role: 'status' },
      'Computing the envelope …');
    this.sensorChoice = h('span', { class: 'seg' });
    this.modeChoice = h('span', { class: 'seg' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.mapBox = h('div', { class: 'map' });
    this.distrust = h('p', { class: 'distrust', role: 'alert', hidden: true },
      icon('bad'), ' The model is not trusted. Do not rely on this map.');
    return h('section', { class: 'panel p-map loading' },
      h('header', {}, this.title, h('span', { class: 'sp' }), this.sensorChoice, this.modeChoice),
      this.distrust, this.problem, this.mapBox, this.note);
  }

  /** The envelope as the service has it; it keeps one until the machine has changed. */
  async load() {
    if (this.page.store.get('link').status !== 'live' && this.answer) return;
    try {
      this.answer = await call(assetPath(this.page.live.assetId, '/envelope'));
      setText(this.problem, '');
    } catch (error) {
      setText(this.problem, `No envelope: ${error.message}.`);
      if (!this.answer) setText(this.note, 'Retrying …');
      return;
    }
    this.mapBox.parentElement.classList.remove('loading');
    this.show();
  }

  limits() {
    const own = this.answer.sensors[this.sensor].limits;
    return own.warning ? { warning: own.warning.limit_c, alarm: own.alarm.limit_c } : null;
  }

  /** Whether the model is trusted. */
  trusted() {
    return this.page.store.get('asset')?.active_model?.trusted !== false;
  }

  show() {
    if (!this.answer) return;
    this.distrust.hidden = this.trusted();
    const { store, clock } = this.page;
    const sensors = Object.keys(this.answer.sensors);
    if (!sensors.includes(this.sensor)) [this.sensor] = sensors;
    const limits = this.limits();
    if (!limits) this.mode = 'temperature';
    const maps = this.answer.sensors[this.sensor];
    const plane = planeOf(this.answer);
    const now = (name, kept) => {
      const reading = readChannel(store.state, clock, name);
      return reading.usable ? reading.value : kept;
    };
    const { speed_rpm: speed, load_n: load } = this.answer.present;
    const present = {
      speed: now('speed_rpm', speed), load: now('load_n', load), reading: now(this.sensor, null),
    };
    const ahead = clock.now() === null ? []
      : distinctSteps(stepsFrom(store.get('forecast'), clock.now()));
    const steps = ahead.slice(1).map((step) => ({ speed: step.speed_rpm, load: step.load_n }));
    this.probe ??= steps[0] ?? {
      speed: Math.max(present.speed, plane.low.speed), load: Math.max(present.load, plane.low.load),
    };
    this.showHead(sensors, limits);
    this.map.update({
      answer: this.answer, maps, limits, mode: this.mode, probe: this.probe, present, steps,
    });
    this.showPoint(plane, maps, limits, present);
    this.showSteps(plane, maps, limits, [present, ...steps]);
    this.showKey(limits);
  }

  showHead(sensors, limits) {
    const key = JSON.stringify([sensors, this.sensor, this.mode, limits]);
    const hours = wholeSpan(this.answer.horizon_s);
    setText(this.note, [`Each point is held until steady, from the present state; times within ${hours}`,
      ...this.answer.labels.map(labelText)].join('; '));
    if (key === this.headKey) return;
    this.headKey = key;
    const choice = (text, pressed, choose) => h('button', {
      type: 'button', 'aria-pressed': String(pressed),
      onclick: () => {
        choose();
        this.show();
      },
    }, text);
    put(this.sensorChoice, sensors.map((name) =>
      choice(channelName(name), name === this.sensor, () => { this.sensor = name; })));
    put(this.modeChoice,
      choice('steady temperature', this.mode === 'temperature',
        () => { this.mode = 'temperature'; }),
      limits && choice(`time to ${limits.warning} °C`, this.mode === 'time',
        () => { this.mode = 'time'; }));
  }

  showPoint(plane, maps, limits, present) {
    const { speed, load } = this.probe;
    const chances = limits && ['warning', 'alarm'].map((level) =>
      chanceAt(plane, maps.limits[level], this.probe, present));
    // Built again only when its content changes, so that its buttons keep focus and clicks.
    const key = JSON.stringify([speed, load, this.sensor, this.answer.made_at,
      this.answer.model_version, this.trusted(), chances]);
    if (key === this.pointKey) return;
    this.pointKey = key;
    const at = (matrix) => valueAt(plane, matrix, speed, load);
    const degrees = (value) => (isNumber(value) && value < AWAY_C ? celsius(value) : 'thermal runaway');
    const rows = [['Steady, median', degrees(at(maps.steady_c.q50))],
      ['Upper bound (97.5 %)', degrees(at(maps.steady_c.q975))]];
    let head = null;
    if (limits) {
      const [warning, alarm] = ['warning', 'alarm'].map((level) => maps.limits[level]);
      const { word, priority } = verdictAt(...chances);
      head = this.trusted() ? h('div', { class: `verd${priority ? ` p${priority}` : ''}` },
        symbol(priority, '1em'), h('span', { class: 'word' }, WORDS[word]))
        : h('div', { class: 'verd bt' }, icon('bad', 'hollow', '1em'),
          h('span', { class: 'word' }, 'Not trusted'));
      for (const [i, [level, map]] of [['warning', warning], ['alarm', alarm]].entries()) {
        const median = nearestAt(plane, map.median_s, speed, load);
        const first = nearestAt(plane, map.earliest_s, speed, load);
        const hours = wholeSpan(this.answer.horizon_s);
        rows.push([`Over ${limits[level]} °C when steady`, percent(chances[i])],
          ['median time', median === null ? `not within ${hours}` : spanText(median)],
          ['earliest time', first === null ? '–' : spanText(first)]);
      }
    }
    const { runaway } = this.answer;
    const open = nearestAt(plane, runaway.not_excluded, speed, load);
    rows.push(['Thermal runaway', `${open ? 'not ruled out' : 'unlikely'}, ${percent(at(runaway.probability))}`]);
    const [kelvins, newtons] = [runaway.margin_k, runaway.margin_n].map(
      (matrix) => nearestAt(plane, matrix, speed, load));
    if (isNumber(kelvins)) rows.push(['margin', `${fixed(kelvins, 0)} K`]);
    if (isNumber(newtons)) rows.push(['load to 5 %', `${newtons > 0 ? '+' : ''}${fixed(newtons, 0)} N`]);
    put(this.side.point, h('header', {},
      h('h2', {}, `At ${fixed(speed, 0)} rpm, ${fixed(load, 0)} N`)), head,
    h('dl', { class: 'kv' }, rows.map(([name, value]) => [h('dt', {}, name), h('dd', {}, value)])),
    open && h('p', { class: 'open' }, icon(2, 'dashed'), 'Thermal runaway is not ruled out here'),
    h('div', { class: 'row foot' },
      this.page.may('operator') && h('button', {
        class: 'btn', type: 'button', onclick: () => this.handOver('whatif'),
      }, 'Try in what-if'),
      this.page.may('engineer') && h('button', {
        class: 'btn', type: 'button', onclick: () => this.handOver('engineer'),
      }, 'Reduce uncertainty here')));
  }

  showSteps(plane, maps, limits, steps) {
    const [present] = steps;
    const row = (step, i) => {
      const chance = limits && ['warning', 'alarm'].map((level) =>
        chanceAt(plane, maps.limits[level], step, present));
      const { word, priority } = limits && this.trusted() ? verdictAt(...chance) : {};
      return h('tr', {}, h('td', {}, i ? h('b', {}, String(i)) : 'now'),
        h('td', { class: 'r' }, fixed(step.speed, 0), h('span', { class: 'u' }, 'rpm')),
        h('td', { class: 'r' }, fixed(step.load, 0), h('span', { class: 'u' }, 'N')),
        word && h('td', { class: 'nw' }, symbol(priority, '1.3em'), ' ', WORDS[word]),
        word && h('td', { class: 'r b' }, percent(chance[0])));
    };
    put(this.side.steps, h('header', {}, h('h2', {}, 'Planned steps')),
      h('table', {}, h('tbody', {}, steps.map(row))));
  }

  showKey(limits) {
    if (this.keyFor === JSON.stringify(limits)) return;
    this.keyFor = JSON.stringify(limits);
    const box = (parts) => s('svg', { viewBox: '0 0 34 22', 'aria-hidden': 'true' }, parts);
    const ground = (fill, opacity) => s('rect', { width: 34, height: 22, fill, opacity });
    const circle = (r, more) => s('circle', { cx: 17, cy: 11, r, ...more });
    const items = limits ? [
      [box(s('rect', { width: 34, height: 22, fill: 'var(--panel-2)', stroke: 'var(--line)' })),
        `under 5 % over ${limits.warning} °C`],
      [box([ground('var(--p2)', 0.3), s('path', {
        d: 'M0 22 22 0M12 22 34 0', stroke: 'var(--p2)', 'stroke-width': 2,
      })]), '5 to 50 %: at risk'],
      [box(ground('var(--p2)', 0.55)), `over ${limits.warning} °C likely`],
      [box(ground('var(--p1)', 0.7)), `over ${limits.alarm} °C likely`],
    ] : [];
    items.push(
      [box([circle(8, { fill: 'none', stroke: 'var(--ink)', 'stroke-width': 3 }),
        circle(2.5, { fill: 'var(--ink)' })]), 'current operating point'],
      [box([s('path', {
        d: 'M2 11H32', stroke: 'var(--ink)', 'stroke-width': 2, 'stroke-dasharray': '5 4',
      }), circle(6, { fill: 'var(--panel)', stroke: 'var(--ink)', 'stroke-width': 2 })]),
      'planned steps in order'],
      [box(s('rect', {
        x: 2, y: 2, width: 30, height: 18, fill: 'none', stroke: 'var(--twin)', 'stroke-width': 2,
      })), 'low-risk region (training data)']);
    put(this.side.key, h('header', {}, h('h2', {}, 'Legend')),
      h('div', { class: 'lk' }, items.map(([drawn, text]) => [drawn, h('span', {}, text)])));
  }

  /** Hand the point over to another view. */
  handOver(view) {
    this.page.wish = { speed_rpm: this.probe.speed, load_n: this.probe.load };
    location.hash = view;
  }
}
