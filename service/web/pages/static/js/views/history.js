// The past at any scale: choose a span, draw a part of it out, down to the raw samples; save it.
import { assetPath, callPages, fetchFile } from '../api.js';
import { OPERATION, UNITS } from '../channels.js';
import { h, put, setText, unit } from '../dom.js';
import { EventRibbon } from '../event_ribbon.js';
import { fixed, milliseconds, timeZone, wholeSpan } from '../format.js';
import { saveBlob } from '../files.js';
import { byChannel, extremes } from '../past.js';
import { lineName, lookOf, PastChart } from '../past_chart.js';
import { assetHash } from '../route.js';
import { channelNames, chartSensors } from '../sensors.js';

const HOUR_MS = 3600e3;
const SPANS = [[1, '1 h'], [8, '8 h'], [24, '24 h'], [168, '7 d'], [null, 'all']];
const LEAST_SPAN_MS = 1000;
const REFRESH_MS = 10000;
const RESOLUTIONS = [['auto', 'auto'], ['raw', 'raw']];
const BEGINNING_MS = 0;
const PAGE = 50000;
const BRIDGE_WALL_MS = 1500;

/** A local date and time for an input, to the second. */
const localInput = (ms) => {
  const date = new Date(ms);
  return new Date(ms - date.getTimezoneOffset() * 60000).toISOString().slice(0, 19);
};

export class HistoryView {
  constructor(box, page) {
    this.page = page;
    const { asset } = page.store.state;
    this.names = selectable(asset);
    const asked = new URLSearchParams(location.hash.split('?')[1]).getAll('channel')
      .filter((name) => this.names.includes(name));
    this.chosen = new Set(asked.length ? asked : defaults(asset));
    this.resolution = 'auto';
    this.past = []; // spans to go back to
    this.range = { hours: 8 }; // { hours } up to now, or { fromMs, toMs }
    this.createControls();
    this.status = h('span', { class: 's mut', role: 'status' });
    this.charts = this.createCharts();
    this.ribbon = new EventRibbon(assetHash('alarms', page.assets.length > 1 ? asset.id : null));
    this.rows = this.names.map((name) => this.createRow(name));
    this.runsPlace = h('div', { class: 'runs-place', hidden: true });
    put(box, h('h1', { class: 'vh' }, 'History'),
      h('section', { class: 'panel p-hctl', 'aria-label': 'Selection' }, this.controls),
      this.runsPlace,
      h('section', { class: 'panel p-past' },
        h('header', {}, h('h2', {}, `History of ${asset.id}`), this.status,
          h('span', { class: 'sp' }), h('span', { class: 's mut hint' },
            'drag to zoom')),
        this.charts.map(({ box: one }) => one), this.ribbon.element),
      h('section', { class: 'panel p-hval' }, h('header', {}, h('h2', {}, 'Channels')),
        h('table', {}, h('thead', {}, h('tr', {}, ['Channel', 'min', 'mean', 'max']
          .map((title, i) => h('th', { scope: 'col', class: i ? 'r' : null }, title)))),
        h('tbody', {}, this.rows.map(({ element }) => element)))));
    this.timer = setInterval(() => this.range.hours && !document.hidden && this.load(), REFRESH_MS);
    this.ending = page.store.on(['link'], () => !this.shown && this.load(), 500);
    this.load();
  }

  destroy() {
    clearInterval(this.timer);
    this.ending();
    this.asking?.abort();
    this.charts.forEach(({ chart }) => chart.destroy());
    this.runs?.destroy();
    this.ended = true;
  }

  createControls() {
    const button = (text, label, onclick) =>
      h('button', { class: 'btn sm', type: 'button', 'aria-label': label, onclick }, text);
    this.spanButtons = SPANS.map(([hours, text]) => h('button', {
      type: 'button', onclick: () => this.go(hours ? { hours } : { all: true }),
    }, text));
    const time = (label) => h('input', {
      type: 'datetime-local', step: 1, 'aria-label': label, onchange: () => this.useInputs(),
    });
    [this.from, this.to] = [time('From'), time('To')];
    this.back = button('Back', 'Previous range', () => this.goBack());
    this.resolutionButtons = RESOLUTIONS.map(([value, text]) => h('button', {
      type: 'button', onclick: () => this.chooseResolution(value),
    }, text));
    this.saves = ['csv', 'parquet'].map((format) => button(format === 'csv' ? 'CSV' : 'Parquet',
      `Save the shown data as ${format === 'csv' ? 'CSV' : 'Parquet'}`, () => this.save(format)));
    this.runsButton = button('Runs', 'Runs', () => this.openRuns());
    this.runsButton.setAttribute('aria-expanded', 'false');
    this.controls = [
      h('div', { class: 'row' },
        h('span', { class: 'seg', role: 'group', 'aria-label': 'Range up to now' }, this.spanButtons),
        button('◀', 'Earlier', () => this.shift(-0.5)), button('▶', 'Later', () => this.shift(0.5)),
        button('+', 'Zoom in', () => this.zoom(0.5)), button('−', 'Zoom out', () => this.zoom(2)),
        this.back),
      h('div', { class: 'row' }, h('span', { class: 's mut' }, 'from'), this.from,
        h('span', { class: 's mut' }, 'to'), this.to,
        h('span', { class: 's mut' }, timeZone(Date.now()))),
      h('div', { class: 'row' }, h('span', { class: 's mut' }, 'resolution'),
        h('span', { class: 'seg', role: 'group', 'aria-label': 'Resolution' },
          this.resolutionButtons),
        h('span', { class: 's mut' }, 'save'), this.saves, this.runsButton),
    ];
  }

  /** One channel: whether and how it is drawn, and its extremes within the span. */
  createRow(name) {
    const figures = [0, 1, 2].map(() => h('td', { class: 'r' }, '–'));
    const element = h('tr', {}, h('td', {}, h('label', { class: 'chk' },
      h('input', {
        type: 'checkbox', checked: this.chosen.has(name), value: name,
        onchange: (event) => this.tick(name, event.target.checked),
      }), this.swatch(name), h('span', {}, lineName(name), unit(unitOf(name))))), figures);
    return { name, element, figures };
  }

  swatch(name) {
    const group = this.names.filter((one) => unitOf(one) === unitOf(name));
    const { colour, dash } = lookOf(group, name);
    return h('i', { class: 'swatch', style: {
      borderTop: `2px ${styleOf(dash)} var(${colour})`,
    } });
  }

  createCharts() {
    const kinds = [['Temperature', '°C', 't'], ['Speed', 'rpm', 'lane'], ['Load', 'N', 'lane']];
    return kinds.map(([title, ofUnit, look]) => {
      const box = h('div', { class: `plot ${look}`, role: 'img', 'aria-label': `${title} over time` });
      const chart = new PastChart(box, {
        title, unit: ofUnit, syncKey: 'history',
        onZoom: (fromMs, toMs) => this.go({ fromMs, toMs }),
        onDrawn: () => this.showEvents(),
      });
      return { box, chart, unit: ofUnit };
    });
  }

  // ------------------------------------------------------------------ runs
  /** The list of runs, which is fetched when it is first opened. */
  async openRuns() {
    const { RunsPanel } = await import('../runs_panel.js');
    if (this.ended) return;
    this.runs ??= new RunsPanel(this.page, {
      names: this.names, unitOf, show: (run, notes) => this.showRun(run, notes),
      at: () => this.charts.map(({ chart }) => chart.at()).find((ms) => ms !== null) ?? null,
    });
    if (!this.runsPlace.firstChild) this.runsPlace.append(this.runs.element);
    this.runsPlace.hidden = !this.runsPlace.hidden;
    this.runsButton.setAttribute('aria-expanded', String(!this.runsPlace.hidden));
  }

  /** A run fills the charts, with marks where something was noted. */
  showRun({ start, end }, notes) {
    this.notes = notes.map(({ time, text }) => ({ ms: milliseconds(time), text }));
    const toMs = end ? milliseconds(end) : this.page.clock.now();
    this.go({ fromMs: milliseconds(start), toMs });
  }

  // ------------------------------------------------------------------ the span
  /** The span asked for: { fromMs, toMs }, null before the first message of the service. */
  asked() {
    const now = this.page.clock.now();
    const { hours, all, fromMs, toMs } = this.range;
    if (fromMs !== undefined) return { fromMs, toMs };
    if (now === null) return null;
    return { fromMs: all ? BEGINNING_MS : now - hours * HOUR_MS, toMs: now };
  }

  go(range) {
    if (range.fromMs !== undefined) {
      const span = Math.max(LEAST_SPAN_MS, range.toMs - range.fromMs);
      range = { fromMs: Math.max(0, range.fromMs), toMs: range.fromMs + span };
    }
    this.past.push(this.range);
    this.range = range;
    this.load();
  }

  goBack() {
    this.range = this.past.pop() ?? this.range;
    this.load();
  }

  shift(share) {
    if (!this.shown) return;
    const move = (this.shown.toMs - this.shown.fromMs) * share;
    this.go({ fromMs: this.shown.fromMs + move, toMs: this.shown.toMs + move });
  }

  zoom(factor) {
    if (!this.shown) return;
    const middle = (this.shown.toMs + this.shown.fromMs) / 2;
    const half = (this.shown.toMs - this.shown.fromMs) / 2 * factor;
    this.go({ fromMs: middle - half, toMs: middle + half });
  }

  useInputs() {
    const [fromMs, toMs] = [this.from, this.to].map((input) => new Date(input.value).getTime());
    if (Number.isFinite(fromMs) && Number.isFinite(toMs) && toMs > fromMs) this.go({ fromMs, toMs });
    else setText(this.status, 'expected “to” later than “from”');
  }

  chooseResolution(value) {
    this.resolution = value;
    this.load();
  }

  tick(name, on) {
    if (on) this.chosen.add(name);
    else this.chosen.delete(name);
    this.load();
  }

  // ------------------------------------------------------------------ data
  query({ fromMs, toMs }) {
    return {
      channel: this.names.filter((name) => this.chosen.has(name)), resolution: this.resolution,
      start: new Date(fromMs).toISOString(), end: new Date(toMs).toISOString(),
    };
  }

  async load() {
    const span = this.asked();
    this.showControls(span);
    if (!span || !this.chosen.size) {
      if (span) this.show(span, {}, '');
      return;
    }
    const query = this.query(span);
    // An earlier question is of no use any more, and keeps the service from this one.
    this.asking?.abort();
    const asking = new AbortController();
    this.asking = asking;
    try {
      let resolution = '';
      const items = await callPages(assetPath(this.page.live.assetId, '/measurements'),
        { ...query, limit: PAGE }, (answer) => { resolution = answer.resolution; },
        asking.signal);
      await this.ribbon.load(this.page.live.assetId, span, asking.signal);
      if (this.ended) return;
      this.queryShown = query;
      const bridgeMs = BRIDGE_WALL_MS * this.page.clock.rate;
      this.show(span, byChannel(items, resolution, bridgeMs), resolution, items.length);
    } catch (error) {
      if (asking.signal.aborted) return;
      if (!(error.status >= 0)) throw error;
      setText(this.status, `Loading failed: ${error.message}.`);
    }
  }

  show(span, lines, resolution, rows = 0) {
    const all = Object.values(lines);
    const first = Math.min(...all.map((line) => line.times[0] ?? Infinity));
    const fromMs = this.range.all && Number.isFinite(first) ? first : span.fromMs;
    this.shown = { fromMs, toMs: span.toMs };
    const named = this.charts.map((one) => ({
      ...one, names: this.names.filter((name) => this.chosen.has(name) && unitOf(name) === one.unit),
    }));
    const last = named.findLast(({ names }) => names.length);
    for (const { box, chart, names } of named) {
      box.hidden = !names.length;
      const showTime = chart === last?.chart;
      const limits = limitsOf(this.page.store.get('asset'), names);
      if (names.length) chart.update({ names, lines, showTime, limits, notes: this.notes, ...this.shown });
    }
    this.last = last?.chart;
    this.showEvents();
    const what = resolution === 'raw' ? 'raw samples'
      : `mean, minimum and maximum per ${resolution.replace(/(\d)(\D)/, '$1 $2')}`;
    setText(this.status, rows ? `${rows} values: ${what}` : 'no data in this range');
    for (const { name, figures } of this.rows) {
      const found = this.chosen.has(name) && lines[name] ? extremes(lines[name]) : null;
      const shownFigures = found ? [found.low, found.mean, found.high] : [];
      figures.forEach((cell, i) =>
        setText(cell, fixed(shownFigures[i], unitOf(name) === '°C' ? 1 : 0)));
    }
    this.showControls(this.shown);
  }

  /** Marks under the last chart; again when it is drawn, for its place may have changed. */
  showEvents() {
    if (this.shown) this.ribbon.show(this.shown, this.last?.area() ?? null);
  }

  showControls(span) {
    SPANS.forEach(([hours], i) => this.spanButtons[i].setAttribute('aria-pressed',
      String(hours ? this.range.hours === hours : this.range.all === true)));
    RESOLUTIONS.forEach(([value], i) =>
      this.resolutionButtons[i].setAttribute('aria-pressed', String(this.resolution === value)));
    this.back.disabled = !this.past.length;
    this.saves.forEach((one) => { one.disabled = !this.chosen.size || !this.shown; });
    if (!span || [this.from, this.to].includes(document.activeElement)) return;
    this.from.value = localInput(span.fromMs);
    this.to.value = localInput(span.toMs);
    this.from.title = `${wholeSpan((span.toMs - span.fromMs) / 1000)} are shown`;
  }

  /** What is seen, as a file. */
  async save(format) {
    const { assetId } = this.page.live;
    try {
      const blob = await fetchFile(assetPath(assetId, '/measurements'),
        { query: { ...this.queryShown, format } });
      saveBlob(`${assetId}-${this.queryShown.start.slice(0, 19).replaceAll(':', '')}.${format}`, blob);
    } catch (error) {
      if (!(error.status >= 0)) throw error;
      this.page.notify(`Not saved: ${error.message}.`);
    }
  }
}

const limitsOf = ({ limits }, names) => names.filter((name) => limits?.[name])
  .flatMap((name) => [['warning', 2], ['alarm', 1]].map(([level, priority]) =>
    ({ name, level, value: limits[name][level], priority })));

const styleOf = ([length]) => (length ? (length < 5 ? 'dotted' : 'dashed') : 'solid');

/** Measured channels, and the twin of those that have one. */
function selectable(asset) {
  const measured = channelNames(asset).filter((name) => unitOf(name));
  return measured.flatMap((name) =>
    (chartSensors(asset).includes(name) ? [name, `${name}.twin`] : [name]));
}

const defaults = (asset) => [...chartSensors(asset), 'speed_rpm', 'load_n']
  .filter((name) => channelNames(asset).includes(name));

function unitOf(name) {
  if (OPERATION.includes(name)) return UNITS[name];
  return /_c(\.twin)?$/.test(name) ? '°C' : null;
}
