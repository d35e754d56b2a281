// Low-risk windows: which of them the next identification learns from, on an axis of time and as a table.
import { button, form, key, Panel, plainTable, quiet, scrolled, section, v } from '../parts/panel.js';
import {
  counted, dayTime, fixed, hourMinute, isNumber, localInput, milliseconds, moment, spanText,
} from '../parts/format.js';
import { MINUTE_MS, Minutes } from '../live/minutes.js';

const LOOK_BACK_MS = 72 * 3600e3;
// A set-point at the edge of the region is measured with noise.
const TOLERANCE = 1.02;

export class OperationMinutes extends Minutes {
  constructor(assetId) {
    super(assetId, ['speed_rpm', 'load_n']);
  }

  /** Fetch what has come since the last time. */
  async load(nowMs) {
    await this.fetch(this.upTo === null ? nowMs - LOOK_BACK_MS : this.upTo - 2 * MINUTE_MS, nowMs + MINUTE_MS);
    this.upTo = nowMs;
    this.forget(nowMs - LOOK_BACK_MS);
  }

  highRisk({ speed_rpm_max: speedMax, load_n_max: loadMax }) {
    const spans = [];
    for (const [minute, { speed_rpm: speed, load_n: load }] of this.ordered()) {
      if (!(Math.abs(speed) > speedMax * TOLERANCE || load > loadMax * TOLERANCE)) continue;
      const last = spans.at(-1);
      if (last && minute - last.toMs < 3 * MINUTE_MS) last.toMs = minute + MINUTE_MS;
      else spans.push({ fromMs: minute, toMs: minute + MINUTE_MS });
    }
    return spans;
  }

  /** The speed in runs without holes: [[[ms, rpm], …], …], every `everyMs` at most. */
  speedRuns(everyMs) {
    const runs = [];
    let last = -Infinity;
    let kept = -Infinity;
    for (const [minute, { speed_rpm: speed }] of this.ordered()) {
      if (!isNumber(speed)) continue;
      const isHole = minute - last > Math.max(5 * MINUTE_MS, 2 * everyMs);
      last = minute;
      if (isHole) runs.push([]);
      else if (minute - kept < everyMs) continue;
      kept = minute;
      runs.at(-1).push([minute + MINUTE_MS / 2, Math.abs(speed)]);
    }
    return runs;
  }

  ordered() {
    return [...this.minutes].sort(([one], [other]) => one - other);
  }
}

const HEIGHT = 140;
const BASE = 102;
const HOUR_MS = 3600e3;
const MARGIN = 8;
const LEAST_DRAG_MS = 5 * 60000;

export const pointText = (point) =>
  `${fixed(point.speed_rpm, 0)} rpm, ${fixed(point.load_n, 0)} N, ${spanText(point.duration_s)}`;

const startOf = (window) => milliseconds(window.start);
const endOf = (window) => milliseconds(window.end);

export const overlaps = (one, other) => startOf(one) < endOf(other) && endOf(one) > startOf(other);

export const isUsed = (window, used) => used.some((other) => overlaps(window, other));

export const windowOf = (fromMs, toMs) =>
  ({ start: new Date(fromMs).toISOString(), end: new Date(toMs).toISOString() });

/**
 * windows (null while they are asked for), used (of the active model), chosen, byHand, nowMs, minutes
 * (`OperationMinutes`), region; toggle(window) and drag(fromMs, toMs) are used by hand only.
 */
class WindowTimeline extends Panel {
  componentDidMount() {
    const observer = new ResizeObserver(() => this.dragged || this.draw());
    observer.observe(this.box);
    this.endings.push(() => observer.disconnect());
  }

  /** What is dragged stays as it is until it is let go. */
  shouldComponentUpdate() {
    return !this.dragged;
  }

  render() {
    return v('div', { class: 'wtl', ref: (box) => { this.box = box ?? this.box; },
      onpointerdown: (event) => this.begin(event), onpointermove: (event) => this.move(event),
      onpointerup: (event) => this.end(event), onpointercancel: () => this.stop() }, this.picture());
  }

  picture() {
    const { windows, chosen, byHand, nowMs, minutes, region } = this.props;
    if (!windows || !(this.box?.clientWidth >= 50)) return null;
    const first = Math.min(minutes.firstMs() ?? Infinity, ...[...windows, ...chosen].map(startOf));
    if (!Number.isFinite(first)) return v('p', { class: 'mut s pad' }, 'No data in the store yet.');
    this.width = Math.max(280, this.box.clientWidth);
    this.first = first;
    this.span = Math.max(nowMs - first, HOUR_MS);
    return v('svg', { viewBox: `0 0 ${this.width} ${HEIGHT}`, role: 'group', class: byHand ? 'byhand' : null,
      'aria-label': `${counted(windows.length, 'low-risk window')} over ${spanText(this.span / 1000)}` },
    this.timeMarks(), this.highRiskBoxes(minutes, region), this.speedLine(minutes),
    v('path', { d: `M${MARGIN} ${BASE}H${this.width - MARGIN}`, stroke: 'var(--line-2)' }),
    windows.map((window) => this.windowBox(window)),
    byHand && chosen.filter((one) => !windows.includes(one)).map((one) => this.ownBox(one)),
    v('rect', { y: 12, height: BASE - 12, x: 0, width: 0, fill: 'var(--fan50)', stroke: 'var(--ink)',
      'stroke-dasharray': '4 3', 'pointer-events': 'none', key: 'drag', ref: (box) => { this.dragBox = box; } }));
  }

  x(ms) {
    return MARGIN + (ms - this.first) / this.span * (this.width - 2 * MARGIN);
  }

  msAt(event) {
    const box = this.box.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * this.width;
    const share = (x - MARGIN) / (this.width - 2 * MARGIN);
    return this.first + Math.min(1, Math.max(0, share)) * this.span;
  }

  // -- by hand
  begin(event) {
    if (!this.props.byHand || event.button !== 0 || event.target.closest('[data-own]')) return;
    this.dragged = { fromMs: this.msAt(event), window: event.target.closest('[data-window]') };
    this.box.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.dragged) return;
    const [from, to] = [this.dragged.fromMs, this.msAt(event)].sort((a, b) => a - b);
    this.dragBox.setAttribute('x', this.x(from));
    this.dragBox.setAttribute('width', this.x(to) - this.x(from));
  }

  end(event) {
    if (!this.dragged) return;
    const { fromMs, window } = this.dragged;
    const [from, to] = [fromMs, this.msAt(event)].sort((a, b) => a - b);
    this.stop();
    if (to - from >= Math.max(LEAST_DRAG_MS, this.span / this.width * 6)) {
      this.props.drag(from, to);
    } else if (window) {
      this.props.toggle(this.props.windows.find((one) => one.start === window.dataset.window));
    }
  }

  stop() {
    this.dragged = null;
    this.dragBox?.setAttribute('width', 0);
    this.draw();
  }

  // -- drawing
  highRiskBoxes(minutes, region) {
    return region ? minutes.highRisk(region).map(({ fromMs, toMs }) => {
      const [left, width] = [this.x(fromMs), Math.max(2, this.x(toMs) - this.x(fromMs))];
      return v('g', {}, v('title', {}, `high-risk from ${dayTime(fromMs)} for `
        + `${spanText((toMs - fromMs) / 1000)}: never used for training`),
      v('rect', { x: left, y: 34, width, height: BASE - 34, fill: 'var(--line)', opacity: 0.65 }),
      width > 62 && v('text', { x: left + 6, y: 74, style: { fill: 'var(--ink-3)' } }, 'high-risk'));
    }) : null;
  }

  speedLine(minutes) {
    const runs = minutes.speedRuns(this.span / this.width);
    const top = Math.max(1000, ...runs.flat().map(([, speed]) => speed));
    const y = (speed) => BASE - 2 - (BASE - 16) * speed / top;
    const line = (run) => run.map(([ms, speed], i) =>
      `${i ? 'L' : 'M'}${this.x(ms).toFixed(1)} ${y(speed).toFixed(1)}`).join('');
    return v('path', { d: runs.map(line).join(''), class: 'speedline' });
  }

  windowBox(window) {
    const { used, chosen, byHand, windows, toggle } = this.props;
    const highest = Math.max(...windows.map((one) => one.score), 1e-9);
    const left = this.x(startOf(window));
    const width = Math.max(10, this.x(endOf(window)) - left);
    const height = 12 + 64 * window.score / highest;
    const on = chosen.includes(window);
    const learned = isUsed(window, used);
    const durationS = (endOf(window) - startOf(window)) / 1000;
    const text = (y, style, content, room) => width > room
      && v('text', { x: left + width / 2, y, 'text-anchor': 'middle', style }, content);
    const lines = [`${dayTime(startOf(window))}, ${spanText(durationS)}`,
      `score ${fixed(window.score, 2)} (information per hour)`, ...window.operating_points.map(pointText),
      learned && 'in the active model'].filter(Boolean);
    return v('g', {
      'data-window': window.start, key: window.start, class: 'win', tabindex: byHand ? 0 : null,
      role: byHand ? 'checkbox' : null, 'aria-checked': byHand ? String(on) : null,
      'aria-label': lines.join(', '),
      onkeydown: (event) => {
        if (!byHand || ![' ', 'Enter'].includes(event.key)) return;
        event.preventDefault();
        toggle(window);
      },
    },
    v('title', {}, lines.join('\n')),
    v('rect', {
      x: left, y: BASE - height, width, height, rx: 2, 'stroke-width': 1.5,
      fill: on ? 'var(--fan50)' : 'var(--panel)', 'fill-opacity': on ? 1 : 0.6,
      stroke: on ? 'var(--twin)' : 'var(--ink-3)',
    }),
    learned && v('rect', { x: left, y: BASE + 1, width, height: 4, fill: 'var(--twin)' }),
    text(BASE - height - 5, { fill: 'var(--ink)', fontWeight: 700 }, fixed(window.score, 2), 30),
    text(BASE + 18, { fill: 'var(--ink-3)' }, spanText(durationS), 52));
  }

  ownBox(window) {
    const left = this.x(startOf(window));
    const width = Math.max(6, this.x(endOf(window)) - left);
    return v('g', { 'data-own': window.start },
      v('title', {}, `added manually: ${dayTime(startOf(window))} to ${dayTime(endOf(window))}`),
      v('rect', {
        x: left, y: 12, width, height: BASE - 12, rx: 2, fill: 'var(--fan50)',
        stroke: 'var(--twin)', 'stroke-width': 1.5, 'stroke-dasharray': '5 3',
      }),
      width > 56 && v('text', { x: left + width / 2, y: 26, 'text-anchor': 'middle',
        style: { fill: 'var(--ink)', fontWeight: 700 } }, 'manual'));
  }

  timeMarks() {
    const marks = [];
    const hours = [1, 2, 6, 12, 24, 7 * 24].find((one) => this.span / (one * HOUR_MS) <= this.width / 80);
    for (const at of localTimes(this.first, this.first + this.span, hours ?? 30 * 24)) {
      const midnight = hourMinute(at) === '00:00';
      const fits = this.x(at) < this.width - 50;
      marks.push(v('path', { d: `M${this.x(at)} 8V${BASE + 22}`, stroke: 'var(--line)' }),
        fits && v('text', { x: this.x(at) + 5, y: HEIGHT - 3,
          style: midnight ? { fill: 'var(--ink)', fontWeight: 700 } : {} },
        midnight ? dayTime(at).replace(/ \d\d:\d\d$/, '') : hourMinute(at)));
    }
    return marks;
  }
}

/**
 * Local times between two moments, so many hours apart by the clock on the wall: from midnight, or
 * whole weeks from a Monday. On a day whose clock is changed they stay at the same hours.
 */
export function localTimes(fromMs, toMs, hours) {
  const first = new Date(fromMs);
  const sinceMonday = hours % (7 * 24) ? 0 : (first.getDay() + 6) % 7;
  const [year, month, day] = [first.getFullYear(), first.getMonth(), first.getDate() - sinceMonday];
  const at = (count) => new Date(year, month, day, count * hours).getTime();
  const times = [];
  for (let count = 0; at(count) < toMs; count += 1) {
    // An hour that is left out falls on the next one.
    if (at(count) >= fromMs && at(count) !== times.at(-1)) times.push(at(count));
  }
  return times;
}

const sorted = (windows) => windows.toSorted((a, b) => milliseconds(a.start) - milliseconds(b.start));

/** The windows of a request for an identification; byHand: null (automatic) or the chosen windows. */
export const requestOf = (byHand) => (byHand ? sorted(byHand).map(({ start, end }) => ({ start, end })) : 'auto');

/** Why no identification can be started from this choice, or ''. */
export function refusalOf(windows, byHand) {
  if (byHand) return byHand.length ? '' : 'No window is selected.';
  return windows?.length ? ''
    : 'No low-risk window in the store yet: at least 30 min of good data inside the region.';
}

/** Windows by hand as they are when the service has sent all of them again. */
export const kept = (byHand, before, now) => byHand?.map((one) => (before.includes(one)
  ? now.find((other) => other.start === one.start) ?? one : one)) ?? null;

/** windows: null while they are asked for; used: of the active model; choose(byHand) */
export function WindowPanel({ windows, used, nowMs, minutes, region, byHand, choose }) {
  const without = (window) => choose(byHand.filter((one) => one !== window));
  // A span by hand takes the place of what it overlaps: data must not count twice.
  const add = (window) => choose([...byHand.filter((one) => !overlaps(one, window)), window]);
  const addSpan = (...ends) => add(windowOf(...ends.map((ms) => Math.round(ms / MINUTE_MS) * MINUTE_MS)));
  const toggle = (window) => window && (byHand.includes(window) ? without(window) : add(window));
  const chosen = sorted(byHand ?? windows ?? []);
  return section('e-win', 'Low-risk windows', [quiet(!windows ? 'loading …'
    : region && [`up to ${region.speed_rpm_max} rpm and ${region.load_n_max} N`,
      byHand ? 'click a window to include or exclude it; drag to add a range'
        : 'filled windows train the next model'].join('; ')),
  v('span', { class: 'keys' }, key('box chosen', 'trains the next model'), key('box', 'excluded'),
    key('risky', 'high-risk, never used'), key('learned', 'in the active model'),
    button(byHand ? 'Use all windows' : 'Select manually', () => choose(byHand ? null : [...windows]),
      { disabled: !windows }))],
  v(WindowTimeline, { windows, used, chosen, byHand: Boolean(byHand), nowMs, minutes, region, toggle, drag: addSpan }),
  scrolled('Selected windows', 'wt', byHand ? chosenTable(chosen, without, addSpan, nowMs)
    : chosen.length > 0 && v('details', { class: 's' }, v('summary', {}, counted(chosen.length, 'window')),
      plainTable([...TIMES, pointsOf(''), ['Score', ({ score }) => score.toFixed(2)],
        [v('th'), (window) => isUsed(window, used) && 'in the active model', 'mut']],
      chosen.reverse(), { attributesOf: ({ start }) => ({ key: start }) }))));
}

const TIMES = [['From', ({ start }) => moment(start), 'nw'],
  ['Length', ({ start, end }) => spanText((milliseconds(end) - milliseconds(start)) / 1000), 'nw']];
const pointsOf = (none) =>
  ['Operating points', (window) => window.operating_points?.map(pointText).join(' · ') ?? none];

function chosenTable(windows, without, addSpan, nowMs) {
  const field = (name, ms, given) => v('label', { class: 's mut' }, `${name === 'To' ? 'to' : name} `, v('input', {
    type: 'datetime-local', name, required: true, defaultValue: localInput(ms, 16), 'aria-label': name, ...given }));
  const submit = ({ elements: { From: from, To: to } }) => {
    const [fromMs, toMs] = [from, to].map((input) => new Date(input.value).getTime());
    to.setCustomValidity(toMs > fromMs ? '' : 'later than the start');
    if (to.reportValidity()) addSpan(fromMs, toMs);
  };
  return [v('div', { class: 'chosen' }, plainTable([...TIMES, pointsOf('added manually'),
    [v('th'), (window) => button('Exclude', () => without(window)), 'r']], windows,
  { empty: 'No window is selected.', attributesOf: ({ start }) => ({ key: start }) })),
  form({ class: 'row addspan' }, submit, field('From', nowMs - 2 * HOUR_MS),
    field('To', nowMs - HOUR_MS, { oninput: ({ target }) => target.setCustomValidity('') }),
    v('button', { class: 'btn sm' }, 'Add range'))];
}
