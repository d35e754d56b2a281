// Runs from start to standstill: their list, names, notes and reports, and several over each other.
import { refuse } from './alarm_list.js';
import { assetPath, call, callPages, fetchFile } from './api.js';
import { openDialog } from './dialogs.js';
import { h, put, scrollable, setText } from './dom.js';
import { saveBlob } from './files.js';
import { dayTime, dayTimeSecond, milliseconds, timeElement, wholeSpan } from './format.js';
import { byChannel } from './past.js';
import { lineName } from './past_chart.js';
import { lookOfRun, MOST_RUNS, RunChart } from './run_chart.js';

const PAGE = 20;
const FORMATS = ['pdf', 'png', 'csv'];
const REPORT_MS = 180000;

const startOf = (run) => milliseconds(run.start);

export class RunsPanel {
  /**
   * names: channels to compare, with unitOf(name); show(run, notes) is called when a run is to be
   * seen in the charts, with what was noted of it; at() gives the time of their cursor, or null.
   */
  constructor(page, { names, unitOf, show, at }) {
    Object.assign(this, { page, names, unitOf, showRun: show, at });
    this.runs = [];
    this.chosen = [];
    this.shown = null; // { run, notes }
    this.note = h('span', { class: 's mut', role: 'status' });
    this.rows = h('tbody');
    this.more = h('button', { class: 'btn sm', type: 'button', onclick: () => this.load(true) }, 'More');
    this.channel = h('select', {
      'aria-label': 'Channel to compare', onchange: () => this.compare(),
    }, names.map((name) => h('option', { value: name }, lineName(name))));
    this.plot = h('div', { class: 'plot runs-plot', 'aria-label': 'Runs over each other' });
    this.legend = h('ul', { class: 'runs-legend', 'aria-label': 'Runs that are compared' });
    this.chart = new RunChart(this.plot);
    this.comparison = h('div', { hidden: true },
      h('div', { class: 'row' }, this.channel, this.legend), this.plot);
    this.notes = h('div', { hidden: true });
    this.element = h('section', { class: 'panel p-runs', 'aria-label': 'Runs' },
      h('header', {}, h('h2', {}, 'Runs'), this.note),
      scrollable('scroll', 'List of runs', h('table', {}, h('thead', {}, h('tr', {},
        ['Compare', 'Start', 'Length', 'Name', 'Ended by', ''].map((title) =>
          h('th', { scope: 'col' }, title || h('span', { class: 'vh' }, 'Actions'))))), this.rows),
      this.more),
      this.comparison, this.notes);
    this.load();
  }

  destroy() {
    this.chart.destroy();
    this.ended = true;
  }

  path(rest = '') {
    return assetPath(this.page.live.assetId, `/runs${rest}`);
  }

  /** Ask; what the service refuses is said. */
  async tried(action, said) {
    try {
      return await action();
    } catch (error) {
      if (!(error.status >= 0)) throw error;
      this.page.notify(`${said}: ${error.message}.`);
      return null;
    }
  }

  async load(further = false) {
    const query = { limit: PAGE, ...(further ? { cursor: this.next } : {}) };
    const answer = await this.tried(() => call(this.path(), { query }), 'Runs not loaded');
    if (!answer || this.ended) return;
    this.next = answer.next;
    this.runs = further ? [...this.runs, ...answer.items] : answer.items;
    this.more.hidden = !this.next;
    setText(this.note, this.runs.length ? '' : 'No run in the history: the machine never turned.');
    this.draw();
  }

  draw() {
    const at = document.activeElement?.dataset?.of;
    put(this.rows, this.runs.map((run) => this.row(run)));
    if (at) this.element.querySelector(`[data-of="${CSS.escape(at)}"]`)?.focus();
  }

  nameOf(run) {
    return run.name ?? dayTime(startOf(run));
  }

  row(run) {
    const name = this.nameOf(run);
    const button = (text, label, what, onclick, role = null) => {
      const made = h('button', {
        class: 'btn sm', type: 'button', 'aria-label': label, 'data-of': `${what} ${run.id}`, onclick,
      }, text);
      if (role) refuse(made, this.page.refusal(role));
      return made;
    };
    return h('tr', { 'aria-current': this.shown?.run.id === run.id ? 'true' : null },
      h('td', {}, h('input', {
        type: 'checkbox', 'aria-label': `Compare ${name}`, checked: this.chosen.includes(run.id),
        'data-of': `compare ${run.id}`,
        onchange: (event) => this.choose(run, event.target),
      })),
      h('td', {}, timeElement(startOf(run), dayTime(startOf(run)))),
      h('td', {}, run.duration_s === null ? 'goes on' : wholeSpan(run.duration_s)),
      h('td', { class: 'name', title: run.named_by ? `named by ${run.named_by}` : null }, run.name ?? '–'),
      h('td', {}, run.ended ?? '–'),
      h('td', {}, h('div', { class: 'row' },
        button('Show', `Show ${name}`, 'show', () => this.show(run)),
        button('Name…', `Name ${name}`, 'name', () => this.rename(run), 'operator'),
        h('span', { class: 's mut' }, 'report'),
        FORMATS.map((format) => button(format.toUpperCase(),
          `Report of ${name} as ${format.toUpperCase()}`, format, () => this.report(run, format))))));
  }

  async report(run, format) {
    setText(this.note, 'The report is being made …');
    const blob = await this.tried(() => fetchFile(this.path(`/${run.id}/report`),
      { query: { format }, timeoutMs: REPORT_MS }), 'No report');
    if (blob) saveBlob(`${this.page.live.assetId}-${run.id}.${format}`, blob);
    setText(this.note, blob ? 'The report is saved.' : '');
  }

  async rename(run) {
    const { value, data } = await openDialog({
      title: `Name the run of ${dayTime(startOf(run))}`,
      body: [h('label', { for: 'run-name' }, 'Name (empty: none)'),
        h('input', { id: 'run-name', name: 'name', maxlength: 100, value: run.name ?? '' })],
      buttons: [cancel(), h('button', { class: 'btn pri', value: 'ok' }, 'Save')],
    });
    if (value !== 'ok') return;
    const body = { name: data.name.trim() };
    const changed = await this.tried(() =>
      call(this.path(`/${run.id}`), { method: 'PATCH', body }), 'Not named');
    if (!changed) return;
    this.runs = this.runs.map((one) => (one.id === run.id ? changed : one));
    this.draw();
    this.compare();
  }

  // ------------------------------------------------------------------ one run in the charts
  async show(run) {
    const detail = await this.tried(() => call(this.path(`/${run.id}`)), 'Not shown');
    if (!detail || this.ended) return;
    this.shown = { run: detail, notes: detail.annotations };
    this.showRun(detail, detail.annotations);
    this.drawNotes();
    this.draw();
  }

  drawNotes() {
    const { run, notes } = this.shown;
    const add = h('button', { class: 'btn sm', type: 'button', 'data-of': 'note',
      onclick: () => this.annotate() }, 'Note…');
    refuse(add, this.page.refusal('operator'));
    this.notes.hidden = false;
    put(this.notes, h('div', { class: 'row' }, h('h3', {}, `Notes of ${this.nameOf(run)}`), add),
      h('ol', { class: 'notes', 'aria-label': 'Notes' }, notes.map((one) => {
        const gone = h('button', { class: 'btn sm', type: 'button',
          'aria-label': `Remove the note ${one.text}`, onclick: () => this.remove(one) }, 'Remove');
        refuse(gone, this.page.refusal('operator'));
        const ms = milliseconds(one.time);
        return h('li', {}, timeElement(ms, dayTimeSecond(ms)), ' ', h('span', {}, one.text), ' ',
          h('span', { class: 's mut' }, one.who), ' ', gone);
      })));
    if (!notes.length) this.notes.append(h('p', { class: 's mut' }, 'There are none.'));
  }

  async annotate() {
    const { run } = this.shown;
    const end = run.end ? milliseconds(run.end) : this.page.clock.now();
    const within = Math.min(Math.max(this.at() ?? end, startOf(run)), end);
    const { value, data } = await openDialog({
      title: `Note on ${this.nameOf(run)}`,
      body: [
        h('label', { for: 'note-time' }, 'Time (that of the mark in the chart, where you set one)'),
        h('input', { id: 'note-time', name: 'time', type: 'datetime-local', step: 1, required: true,
          value: localInput(within) }),
        h('label', { for: 'note-text' }, 'Note (everyone can read it)'),
        h('input', { id: 'note-text', name: 'text', required: true, maxlength: 500,
          pattern: '.*\\S.*', title: 'some words' })],
      buttons: [cancel(), h('button', { class: 'btn pri', value: 'ok' }, 'Add')],
    });
    if (value !== 'ok') return;
    // The input knows whole seconds; the run may begin or end between two of them.
    const asked = new Date(data.time).getTime();
    const ms = Math.abs(asked - within) < 1000 ? within : asked;
    const body = { time: new Date(ms).toISOString(), text: data.text.trim() };
    const made = await this.tried(() =>
      call(this.path(`/${run.id}/annotations`), { method: 'POST', body }), 'Not noted');
    if (made) await this.show(run);
  }

  async remove(one) {
    const { run } = this.shown;
    await this.tried(() => call(this.path(`/${run.id}/annotations/${one.id}`),
      { method: 'DELETE' }), 'Not removed');
    await this.show(run);
  }

  // ------------------------------------------------------------------ several over each other
  choose(run, box) {
    if (box.checked && this.chosen.length === MOST_RUNS) {
      box.checked = false;
      this.page.notify(`At most ${MOST_RUNS} runs can be compared.`);
      return;
    }
    this.chosen = box.checked ? [...this.chosen, run.id] : this.chosen.filter((id) => id !== run.id);
    this.compare();
  }

  async compare() {
    const runs = this.chosen.map((id) => this.runs.find((run) => run.id === id));
    this.comparison.hidden = !runs.length;
    if (!runs.length) return;
    const name = this.channel.value;
    const lines = await this.tried(() => Promise.all(runs.map((run) => this.lineOf(run, name))),
      'Not compared');
    if (!lines || this.ended || name !== this.channel.value || runs.length !== this.chosen.length) return;
    this.chart.update({
      title: `${lineName(name)} since the start`, unit: this.unitOf(name),
      runs: runs.map((run, place) => ({ text: this.nameOf(run), line: lines[place] })),
    });
    put(this.legend, runs.map((run, place) => {
      const { colour, dash } = lookOfRun(place);
      const look = dash.length ? (dash[0] < 5 ? 'dotted' : 'dashed') : 'solid';
      return h('li', {}, h('i', { class: 'swatch', style: { borderTop: `2px ${look} var(${colour})` } }),
        ` ${this.nameOf(run)}`);
    }));
  }

  /** A channel of a run; its times are ms since the start. */
  async lineOf(run, name) {
    const end = run.end ?? new Date(this.page.clock.now()).toISOString();
    let resolution = '';
    const items = await callPages(assetPath(this.page.live.assetId, '/measurements'), {
      channel: name, start: run.start, end, resolution: 'auto', limit: 10000,
    }, (answer) => { resolution = answer.resolution; });
    const line = byChannel(items, resolution, 1500 * this.page.clock.rate)[name] ?? EMPTY;
    return { ...line, times: line.times.map((time) => time - startOf(run)) };
  }
}

const EMPTY = { times: [], values: [], low: [], high: [], gaps: [] };

const cancel = () => h('button', {
  class: 'btn', type: 'button', onclick: ({ target }) => target.closest('dialog').close(''),
}, 'Cancel');

/** A local date and time for an input, to the second. */
function localInput(ms) {
  const date = new Date(ms);
  return new Date(ms - date.getTimezoneOffset() * 60000).toISOString().slice(0, 19);
}
