// Runs from start to standstill: their list, names, notes and reports, and several over each other.
import { assetPath, call, fetchFile, saveBlob } from '../app/api.js';
import { EMPTY_LINE, fetchLines, joined } from '../charts/measured.js';
import { lineName, swatch } from '../charts/measured_chart.js';
import { openDialog, reasonField } from '../parts/dialogs.js';
import {
  dayTime, dayTimeSecond, isNumber, localInput, milliseconds, moment, spanText, wholeSpan,
} from '../parts/format.js';
import { button, Hosted, Panel, quiet, section, select, table, tick, unless, v } from '../parts/panel.js';
import { Chart } from '../charts/chart.js';
import { rem, token } from '../parts/dom.js';
import { CLEAR, lineOf, stroke, timeAxis, valueAxis } from '../charts/paint.js';

const PER_LINE = 3;
const HOUR_S = 3600;
// Measured values are never in the colours of alarms; what is alike in colour differs in its dashes.
const LOOKS = [
  ['--ink', []], ['--twin', []], ['--ink-3', [10, 5]], ['--twin-2', [3, 4]], ['--ink', [12, 4, 3, 4]],
];

const MOST_RUNS = LOOKS.length;
const lookOfRun = (place) => ({ colour: LOOKS[place][0], dash: LOOKS[place][1] });

class RunChart extends Chart {
  constructor(box) {
    super(box, { isRead: true });
  }

  /** model: { title, unit, runs: [{ text, line }] }; times of a line are ms since the run's start. */
  update(model) {
    this.model = model;
    this.show(joined(model.runs.map(({ line }) => line)), model);
  }

  options() {
    return {
      scales: { x: { time: false } },
      axes: [timeAxis(true, {
        size: rem() * 2, space: stroke(80), values: (_, splits) => splits.map(elapsed),
        incrs: [60, 300, 600, 1200, 1800, ...[1, 2, 4, 8, 12, 24, 48, 96, 240].map((hours) => hours * HOUR_S)],
      }), valueAxis()],
      series: [{}, ...this.model.runs.flatMap((_, place) => {
        const { colour, dash } = lookOfRun(place);
        return [lineOf(token(colour), 2, { dash }), lineOf(CLEAR, 0), lineOf(CLEAR, 0)];
      })],
    };
  }

  paint(pen) {
    this.reading.paintMark(pen);
    pen.title(`${this.model.title}, ${this.model.unit}`);
  }

  /** What all runs measured so long after their start; between two readings the one before. */
  readAt(index) {
    const [times, ...columns] = this.plot.data;
    const rows = this.model.runs.map(({ text }, place) => {
      const values = columns[PER_LINE * place];
      let at = index;
      while (at > 0 && values[at] === undefined) at -= 1;
      const ends = values.findLastIndex((value) => value !== undefined);
      return {
        name: text, value: index <= ends ? values[at] : null, unit: this.model.unit,
        digits: this.model.unit === '°C' ? 1 : 0,
      };
    });
    const seconds = times[index];
    return {
      ms: seconds * 1000, head: [`${spanText(seconds)} after the start`],
      rows: rows.filter((row) => isNumber(row.value)),
    };
  }
}

function elapsed(second) {
  const minutes = Math.round(second / 60);
  return `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, '0')}`;
}

const PAGE = 20;
const FORMATS = ['pdf', 'png', 'csv'];
const REPORT_MS = 180000;
const BRIDGE_WALL_MS = 1500;
const NO_MATPLOTLIB = 'matplotlib is not installed where the service runs: pip install "matplotlib>=3.10"';
const startOf = (run) => milliseconds(run.start);
const nameOf = (run) => run.name ?? dayTime(startOf(run));

/** show(run, notes): a run is to be seen in the charts; at(): the time of their cursor, or null. */
export class RunsPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { runs: [], chosen: [], channel: attributes.names[0] });
    this.operating = unless(this.page.refusal('operator'));
    this.load();
  }

  path(rest = '') {
    return assetPath(this.page.live.assetId, `/runs${rest}`);
  }

  async load(further = false) {
    const query = { limit: PAGE, ...(further ? { cursor: this.next } : {}) };
    const answer = await this.tried('Runs not loaded', () => call(this.path(), { query }));
    if (!answer) return;
    const { items, next, report_formats: formats } = answer;
    const runs = further ? [...this.runs, ...items] : items;
    this.set({ runs, next, formats, note: runs.length ? '' : 'No run in the history: the asset never turned.' });
  }

  render({ names }) {
    const { shown, model } = this;
    return section('p-runs', 'Runs', quiet(this.note, 'status'),
      table('List of runs', this.columns(), this.runs, { attributesOf: (run) => ({ key: run.id,
        'aria-current': shown?.id === run.id ? 'true' : null }) }, this.next && button('More', () => this.load(true))),
      this.chosen.length > 0 && v('div', {},
        v('div', { class: 'row' }, select('Channel to compare', names.map((name) => [name, lineName(name)]),
          this.channel, (channel) => {
            this.channel = channel;
            this.compare();
          }),
        v('ul', { class: 'runs-legend', 'aria-label': 'Runs that are compared' }, model?.runs.map(({ text }, place) => {
          const { colour, dash } = lookOfRun(place);
          return v('li', {}, swatch(colour, dash), ` ${text}`);
        }))),
        v(Hosted, { class: 'plot runs-plot', 'aria-label': 'Compared runs', make: (box) => new RunChart(box),
          show: (chart) => model && chart.model !== model && chart.update(model) })),
      shown && this.notes(shown));
  }

  columns() {
    return [
      ['Compare', (run) => tick(`Compare ${nameOf(run)}`, this.chosen.includes(run.id),
        (isChosen) => this.choose(run, isChosen))],
      ['Start', ({ start }) => moment(start)],
      ['Length', ({ duration_s: seconds }) => (seconds === null ? 'running' : wholeSpan(seconds))],
      ['Name', (run) => v('td', { class: 'name', title: run.named_by ? `named by ${run.named_by}` : null },
        run.name ?? '–')],
      ['Ended by', ({ ended }) => ended ?? '–'],
      ['', (run) => v('div', { class: 'row' },
        button('Show', () => this.show(run), { 'aria-label': `Show ${nameOf(run)}` }),
        button('Name…', () => this.rename(run), { 'aria-label': `Name ${nameOf(run)}`, ...this.operating }),
        quiet('report'), FORMATS.map((format) => button(format.toUpperCase(), () => this.report(run, format), {
          'aria-label': `Report of ${nameOf(run)} as ${format.toUpperCase()}`,
          ...unless(this.formats.includes(format) ? '' : NO_MATPLOTLIB),
        })))],
    ];
  }

  async report(run, format) {
    this.set({ note: 'The report is being made …' });
    const query = { format, time_zone: Intl.DateTimeFormat().resolvedOptions().timeZone };
    const blob = await this.tried('No report', () =>
      fetchFile(this.path(`/${run.id}/report`), { query, timeoutMs: REPORT_MS }));
    if (blob) saveBlob(`${this.page.live.assetId}-${run.id}.${format}`, blob);
    this.set({ note: blob ? 'The report is saved.' : '' });
  }

  async rename(run) {
    const { value, data } = await openDialog({
      title: `Name the run of ${dayTime(startOf(run))}`,
      body: [v('label', { for: 'run-name' }, 'Name (empty: none)'),
        v('input', { id: 'run-name', name: 'name', maxlength: 100, defaultValue: run.name ?? '' })],
      confirm: 'Save',
    });
    if (value !== 'ok') return;
    const body = { name: data.name.trim() };
    const changed = await this.tried('Not named', () => call(this.path(`/${run.id}`), { method: 'PATCH', body }));
    if (!changed) return;
    this.set({ runs: this.runs.map((one) => (one.id === run.id ? changed : one)) });
    this.compare();
  }

  // -- one run in the charts
  async show(run) {
    const shown = await this.tried('Not shown', () => call(this.path(`/${run.id}`)));
    if (!shown || this.ended) return;
    this.set({ shown });
    this.props.show(shown, shown.annotations);
  }

  notes(run) {
    const { annotations } = run;
    return v('div', {},
      v('div', { class: 'row' }, v('h3', {}, `Notes of ${nameOf(run)}`),
        button('Note…', () => this.annotate(run), this.operating)),
      v('ol', { class: 'notes', 'aria-label': 'Notes' }, annotations.map(({ id, time, text, who }) =>
        v('li', { key: id }, moment(time, dayTimeSecond), ' ', v('span', {}, text), ' ', quiet(who), ' ',
          button('Remove', () => this.remove(run, id), { 'aria-label': `Remove the note ${text}`,
            ...this.operating })))),
      !annotations.length && v('p', { class: 's mut' }, 'No notes.'));
  }

  async annotate(run) {
    const end = run.end ? milliseconds(run.end) : this.page.clock.now();
    const within = Math.min(Math.max(this.props.at() ?? end, startOf(run)), end);
    const { value, data } = await openDialog({
      title: `Note on ${nameOf(run)}`,
      body: [
        v('label', { for: 'note-time' }, 'Time (that of the mark in the chart, where you set one)'),
        v('input', { id: 'note-time', name: 'time', type: 'datetime-local', step: 1, required: true,
          defaultValue: localInput(within) }),
        reasonField('Note (everyone can read it)', 'note-text', 'text', 'some words')],
      confirm: 'Add',
    });
    if (value !== 'ok') return;
    // The input knows whole seconds; the run may begin or end between two of them.
    const asked = new Date(data.time).getTime();
    const ms = Math.abs(asked - within) < 1000 ? within : asked;
    const body = { time: new Date(ms).toISOString(), text: data.text.trim() };
    const made = await this.tried('Not noted', () =>
      call(this.path(`/${run.id}/annotations`), { method: 'POST', body }));
    if (made) await this.show(run);
  }

  async remove(run, id) {
    await this.tried('Not removed', () => call(this.path(`/${run.id}/annotations/${id}`), { method: 'DELETE' }));
    await this.show(run);
  }

  // -- several over each other
  choose(run, isChosen) {
    const isFull = isChosen && this.chosen.length === MOST_RUNS;
    if (isFull) this.page.notify(`At most ${MOST_RUNS} runs can be compared.`);
    else this.chosen = isChosen ? [...this.chosen, run.id] : this.chosen.filter((id) => id !== run.id);
    this.draw();
    this.compare();
  }

  async compare() {
    const { channel, chosen } = this;
    const runs = chosen.map((id) => this.runs.find((run) => run.id === id));
    const lines = runs.length > 0 && await this.tried('Not compared', () =>
      Promise.all(runs.map((run) => this.lineOf(run, channel))));
    if (!lines || channel !== this.channel || chosen !== this.chosen) return;
    this.set({ model: {
      title: `${lineName(channel)} since the start`, unit: this.props.unitOf(channel),
      runs: runs.map((run, place) => ({ text: nameOf(run), line: lines[place] })),
    } });
  }

  async lineOf(run, name) {
    const end = run.end ?? new Date(this.page.clock.now()).toISOString();
    const { lines: { [name]: line = EMPTY_LINE } } = await fetchLines(this.page,
      { channel: name, start: run.start, end, resolution: 'auto', limit: 10000 }, BRIDGE_WALL_MS);
    return { ...line, times: line.times.map((time) => time - startOf(run)) };
  }
}
