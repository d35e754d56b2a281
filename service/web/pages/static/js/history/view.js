// The past at any scale: choose a span, draw a part of it out, down to the raw samples; save it.
// view: {"place": 60, "title": "History", "from": "viewer"}
import { assetPath, fetchFile, saveBlob } from '../app/api.js';
import { assetHash, readQuery } from '../app/route.js';
import { extremes, fetchLines } from '../charts/measured.js';
import { lineName, lookOf, PastChart, swatch } from '../charts/measured_chart.js';
import { OPERATION, UNITS } from '../parts/channels.js';
import { fixed, localInput, milliseconds, timeZone, wholeSpan } from '../parts/format.js';
import { button, choice, gap, Hosted, Panel, plainTable, quiet, section, tick, v } from '../parts/panel.js';
import { EventRibbon } from './event_ribbon.js';
import { channelNames, chartSensors } from '../live/readings.js';

const HOUR_MS = 3600e3;
const SPANS = [[1, '1 h'], [8, '8 h'], [24, '24 h'], [168, '7 d'], [null, 'all']];
const LEAST_SPAN_MS = 1000;
const REFRESH_MS = 10000;
const FORMATS = [['csv', 'CSV'], ['parquet', 'Parquet']];
const CHARTS = [['Temperature', '°C', 't'], ['Speed', 'rpm', 'lane'], ['Load', 'N', 'lane']];
const BEGINNING_MS = 0;
const PAGE = 50000;
const BRIDGE_WALL_MS = 1500;

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    const { asset } = this.page.store.state;
    this.asset = asset;
    this.names = selectable(asset);
    const asked = readQuery().getAll('channel').filter((name) => this.names.includes(name));
    Object.assign(this, {
      chosen: new Set(asked.length ? asked : defaults(asset)), resolution: 'auto', lines: {},
      past: [], // spans to go back to
      range: { hours: 8 }, // { hours } up to now, or { fromMs, toMs }
      charts: {}, // by unit
    });
    this.ribbon = new EventRibbon(assetHash('alarms', this.page.assets.length > 1 ? asset.id : null));
    this.every(REFRESH_MS, () => this.range.hours && !document.hidden && this.load());
    this.follow(this.page.store, ['link'], 500, () => !this.shown && this.load());
    this.load();
  }

  render({ page }) {
    const { Runs } = this;
    return [
      v('h1', { class: 'vh' }, 'History'),
      v('section', { class: 'panel p-hctl', 'aria-label': 'Selection' }, this.controls()),
      v('div', { class: 'runs-place', hidden: !this.isRunsOpen }, Runs && v(Runs, { page, names: this.names, unitOf,
        show: (run, notes) => this.showRun(run, notes),
        at: () => Object.values(this.charts).map((chart) => chart.at()).find((ms) => ms !== null) ?? null })),
      section('p-past', `History of ${this.asset.id}`, [quiet(this.status, 'status'), gap(),
        v('span', { class: 's mut hint' }, 'drag to zoom')],
      CHARTS.map(([title, unit, look]) => v(Hosted, { class: `plot ${look}`, role: 'img',
        'aria-label': `${title} over time`, hidden: Boolean(this.shown) && !this.namesOf(unit).length,
        make: (box) => this.makeChart(box, title, unit) })),
      v(Hosted, { make: (box) => box.append(this.ribbon.element) })),
      section('p-hval', 'Channels', null, plainTable(this.columns(), this.names)),
    ];
  }

  controls() {
    const span = this.span ?? this.asked();
    const named = (text, label, onclick, given) => button(text, onclick, { 'aria-label': label, ...given });
    const isTyped = ['From', 'To'].includes(document.activeElement?.ariaLabel);
    const time = (label, ms, given) => v('input', { type: 'datetime-local', step: 1, 'aria-label': label,
      value: isTyped || !span ? undefined : localInput(ms),
      onchange: ({ target }) => this.useInputs(target.parentElement), ...given });
    return [
      v('div', { class: 'row' },
        choice('Range up to now', SPANS, this.range.all ? null : this.range.hours,
          (hours) => this.go(hours ? { hours } : { all: true })),
        named('◀', 'Earlier', () => this.goTo(-0.5, 0.5)), named('▶', 'Later', () => this.goTo(0.5, 1.5)),
        named('+', 'Zoom in', () => this.goTo(0.25, 0.75)), named('−', 'Zoom out', () => this.goTo(-0.5, 1.5)),
        named('Back', 'Back to the previous range', () => this.go(null), { disabled: !this.past.length })),
      v('div', { class: 'row' }, quiet('from'), time('From', span?.fromMs,
        span && { title: `${wholeSpan((span.toMs - span.fromMs) / 1000)} are shown` }),
      quiet('to'), time('To', span?.toMs),
      quiet(span && [...new Set([span.fromMs, span.toMs].map(timeZone))].join(' to '))),
      v('div', { class: 'row' }, quiet('resolution'),
        choice('Resolution', [['auto', 'auto'], ['raw', 'raw']], this.resolution, (resolution) => {
          this.resolution = resolution;
          this.load();
        }),
        quiet('save'), FORMATS.map(([format, text]) => named(text,
          `Save the shown data as ${text}`, () => this.save(format), { disabled: !this.chosen.size || !this.shown })),
        button('Runs', () => this.openRuns(), { 'aria-expanded': Boolean(this.isRunsOpen) })),
    ];
  }

  columns() {
    const { chosen, lines, names } = this;
    const choose = (name, isChosen) => {
      if (isChosen) chosen.add(name);
      else chosen.delete(name);
      this.load();
    };
    const figures = ['low', 'mean', 'high'].map((which, i) => [['min', 'mean', 'max'][i], (name) =>
      fixed((chosen.has(name) && lines[name] && extremes(lines[name]))?.[which], unitOf(name) === '°C' ? 1 : 0),
    'r', 'r']);
    return [
      ['Channel', (name) => {
        const { colour, dash } = lookOf(names, name);
        return v('label', { class: 'chk' }, tick(null, chosen.has(name),
          (isChosen) => choose(name, isChosen), { value: name }), swatch(colour, dash),
        v('span', {}, lineName(name), v('span', { class: 'u' }, unitOf(name))));
      }], ...figures,
      ['limits', (name) => {
        const { warning, alarm } = this.page.store.get('asset').limits?.[name] ?? {};
        return warning !== undefined && button(`${warning} / ${alarm}`, () => this.pick(name), {
          'aria-label': `${warning} / ${alarm} °C: limits of ${lineName(name)}`, 'aria-pressed': this.picked === name,
          disabled: !chosen.has(name) && !chosen.has(`${name}.twin`),
        });
      }, 'r', 'r'],
    ];
  }

  makeChart(box, title, unit) {
    this.charts[unit] = new PastChart(box, {
      title, unit, syncKey: 'history', onZoom: (fromMs, toMs) => this.go({ fromMs, toMs }),
      onDrawn: () => this.showEvents(),
    });
    return this.charts[unit];
  }

  namesOf(unit) {
    return this.names.filter((name) => this.chosen.has(name) && unitOf(name) === unit);
  }

  // -- runs
  async openRuns() {
    const { RunsPanel } = await import('./runs_panel.js');
    this.set({ Runs: RunsPanel, isRunsOpen: !this.isRunsOpen });
  }

  showRun({ start, end }, notes) {
    this.notes = notes.map(({ time, text }) => ({ ms: milliseconds(time), text }));
    this.go({ fromMs: milliseconds(start), toMs: end ? milliseconds(end) : this.page.clock.now() });
  }

  // -- the span
  asked() {
    const now = this.page.clock.now();
    const { hours, all, fromMs, toMs } = this.range;
    if (fromMs !== undefined) return { fromMs, toMs };
    if (now === null) return null;
    return { fromMs: all ? BEGINNING_MS : now - hours * HOUR_MS, toMs: now };
  }

  go(range) {
    if (range) this.past.push(this.range);
    this.range = range ?? this.past.pop() ?? this.range;
    if (range?.fromMs !== undefined) {
      const span = Math.max(LEAST_SPAN_MS, range.toMs - range.fromMs);
      this.range = { fromMs: Math.max(0, range.fromMs), toMs: range.fromMs + span };
    }
    this.load();
  }

  /** Go to another span, whose ends are given in shares of what is shown. */
  goTo(begin, end) {
    if (!this.shown) return;
    const { fromMs, toMs } = this.shown;
    const at = (share) => fromMs + share * (toMs - fromMs);
    this.go({ fromMs: at(begin), toMs: at(end) });
  }

  useInputs(row) {
    const [fromMs, toMs] = [...row.querySelectorAll('input')].map((input) => new Date(input.value).getTime());
    if (Number.isFinite(fromMs) && Number.isFinite(toMs) && toMs > fromMs) this.go({ fromMs, toMs });
    else this.status = 'expected “to” later than “from”';
    this.draw();
  }

  // -- data
  async load() {
    const span = this.asked();
    this.set({ span });
    if (!span || !this.chosen.size) {
      if (span) this.show(span, { lines: {}, resolution: '', count: 0 });
      return;
    }
    const query = {
      channel: this.names.filter((name) => this.chosen.has(name)), resolution: this.resolution,
      start: new Date(span.fromMs).toISOString(), end: new Date(span.toMs).toISOString(),
    };
    if (!this.shown) this.status = 'loading …';
    // An earlier question is of no use any more, and keeps the service from this one.
    const signal = this.newSignal();
    try {
      const found = await fetchLines(this.page, { ...query, limit: PAGE }, BRIDGE_WALL_MS, signal);
      await this.ribbon.load(this.page.live.assetId, span, signal);
      if (this.ended) return;
      this.queryShown = query;
      this.show(span, found);
    } catch (error) {
      if (signal.aborted) return;
      if (!(error.status >= 0)) throw error;
      this.set({ status: `Loading failed: ${error.message}.` });
    }
  }

  show(asked, { lines, resolution, count }) {
    const first = Math.min(...Object.values(lines).map((line) => line.times[0] ?? Infinity));
    const span = { fromMs: this.range.all && Number.isFinite(first) ? first : asked.fromMs, toMs: asked.toMs };
    const what = resolution === 'raw' ? 'raw samples'
      : `mean, minimum and maximum per ${resolution.replace(/(\d)(\D)/, '$1 $2')}`;
    Object.assign(this, { lines, span, shown: span,
      status: count ? `${count} values: ${what}` : 'no data in this range' });
    this.forceUpdate(() => this.showCharts());
  }

  showCharts() {
    const units = CHARTS.map(([, unit]) => unit).filter((unit) => this.namesOf(unit).length);
    this.last = this.charts[units.at(-1)];
    for (const unit of units) {
      this.charts[unit].update({ all: this.names, names: this.namesOf(unit), lines: this.lines,
        showTime: this.charts[unit] === this.last, limits: this.page.store.get('asset').limits, picked: this.picked,
        notes: this.notes, ...this.shown });
    }
    this.showEvents();
  }

  pick(name) {
    this.set({ picked: this.picked === name ? null : name });
    Object.values(this.charts).forEach((chart) => chart.pick(this.picked));
  }

  /** Marks under the last chart; again when it is drawn, for its place may have changed. */
  showEvents() {
    if (this.shown) this.ribbon.show(this.shown, this.last?.area() ?? null);
  }

  async save(format) {
    const { assetId } = this.page.live;
    const blob = await this.tried('Not saved', () => fetchFile(assetPath(assetId, '/measurements'),
      { query: { ...this.queryShown, format } }));
    if (blob) saveBlob(`${assetId}-${this.queryShown.start.slice(0, 19).replaceAll(':', '')}.${format}`, blob);
  }
}

function selectable(asset) {
  const measured = channelNames(asset).filter((name) => unitOf(name));
  return measured.flatMap((name) => (chartSensors(asset).includes(name) ? [name, `${name}.twin`] : [name]));
}

const defaults = (asset) => [...chartSensors(asset), 'speed_rpm', 'load_n']
  .filter((name) => channelNames(asset).includes(name));

function unitOf(name) {
  if (OPERATION.includes(name)) return UNITS[name];
  return /_c(\.twin)?$/.test(name) ? '°C' : null;
}
