// Alarm settings: every alarm that can be raised, edited in place, as a sheet, with its history.
import { refuse } from './alarm_list.js';
import {
  askSettings, confirmChange, differenceTable, named, shown, silencesNote,
} from './alarm_setting_form.js';
import { call, callPages, fetchFile } from './api.js';
import { notify } from './dialogs.js';
import { bold, h, put, scrollable, setText } from './dom.js';
import { saveBlob } from './files.js';
import { counted, dayTime, isNumber, milliseconds, spanText, timeElement } from './format.js';

const PATH = '/alarm-settings';
const HEAD = ['Alarm', 'Setpoint', 'On-delay', 'Priority', 'Time to respond (5 %, median)',
  'Operator action', 'Status', ''];
const UPLOAD_MS = 120000;

export class AlarmSettings {
  constructor(box, page) {
    this.page = page;
    this.rows = [];
    this.asset = h('select', { 'aria-label': 'Asset of the settings', onchange: () => this.load() },
      page.assets.map(({ id }) => h('option', { value: id, selected: id === page.live.assetId },
        page.nameOf(id))));
    this.search = h('input', { type: 'search', placeholder: 'Filter alarms',
      'aria-label': 'Filter alarms', oninput: () => this.show() });
    this.count = h('span', { class: 's mut', role: 'status' });
    this.save = h('button', { class: 'btn sm', type: 'button', onclick: () => this.export() },
      'Export CSV');
    this.file = h('input', { type: 'file', id: 'settings-file', accept: '.csv,text/csv',
      onchange: () => this.check() });
    this.past = h('button', { class: 'btn sm', type: 'button', 'aria-expanded': 'false',
      onclick: () => this.toggleHistory() }, 'History');
    this.say = h('p', { class: 'b say', role: 'status' });
    this.preview = h('div', {});
    this.history = h('div', { hidden: true });
    this.body = h('tbody', {});
    put(box,
      h('p', { class: 's mut' }, 'The configuration file is the base; what is changed here lies over it '
        + 'and is in effect at once. Time to respond: from the twin’s kept forecasts.'),
      h('div', { class: 'row filters' }, page.assets.length > 1 && this.asset, this.search, this.save,
        h('label', { for: 'settings-file' }, 'Import CSV'), this.file, this.past, this.count),
      this.say, this.preview, this.history,
      scrollable('scroll', 'Alarm settings', h('table', { class: 'st' },
        h('thead', {}, h('tr', {}, HEAD.map((text) => h('th', { scope: 'col' },
          text || h('span', { class: 'vh' }, 'Edit'))))), this.body)));
    refuse(this.file, page.refusal('engineer'));
    this.load();
  }

  async load() {
    const asset = this.asset.value;
    setText(this.count, 'Loading …');
    await this.page.connection.guarded(async () => {
      const rows = await callPages(PATH, { asset, limit: 1000 });
      if (asset !== this.asset.value) return;
      this.rows = rows;
      this.show();
      if (!this.history.hidden) await this.loadHistory();
    });
  }

  show() {
    const at = document.activeElement?.dataset?.of;
    const word = this.search.value.trim().toLowerCase();
    const rows = this.rows.filter((row) => !word
      || Object.values(row).join(' ').toLowerCase().includes(word));
    put(this.body, rows.map((row) => this.row(row)));
    setText(this.count, `${counted(rows.length, 'alarm')} of ${this.rows.length}`);
    if (at) this.body.querySelector(`[data-of="${CSS.escape(at)}"]`)?.focus();
  }

  row(row) {
    const edit = h('button', { class: 'btn sm', type: 'button', 'data-of': Object.values(named(row)).join(' '),
      'aria-label': `Edit ${row.description}`, onclick: () => this.edit(row) }, 'Edit…');
    refuse(edit, this.page.refusal('engineer'));
    const unit = row.setpoint === null ? '' : ` ${row.unit}`;
    return h('tr', {},
      h('td', {}, bold(row.description), !row.enabled && h('span', { class: 'chip' }, 'disabled'),
        row.changed.length > 0 && h('span', { class: 's mut' },
          ` changed here: ${row.changed.join(', ').replaceAll('_', ' ')}`)),
      h('td', { class: 'num' }, `${shown(row.setpoint)}${unit}`),
      h('td', { class: 'num' }, `${row.on_delay_s} s`), h('td', { class: 'num' }, String(row.priority)),
      h('td', { title: row.time_basis }, timeText(row)),
      h('td', { class: 'why s' }, row.operator_action), h('td', {}, row.status), h('td', {}, edit));
  }

  async edit(row) {
    const body = await askSettings(row);
    if (!body) return;
    try {
      const tried = await call(PATH, { method: 'PATCH', body, query: { dry_run: true } });
      if (tried.mistakes.length) {
        notify(tried.mistakes.map(({ column, detail }) => `${column}: ${detail}`).join('; '));
      } else if (!tried.differences.length) {
        notify('Nothing is changed.');
      } else if (await confirmChange(tried)) {
        this.told(await call(PATH, { method: 'PATCH', body }));
      }
    } catch (error) {
      notify(`Not changed: ${error.message}.`);
    }
  }

  told({ changed, in_effect: now }) {
    setText(this.say, `${counted(changed, 'alarm')} changed${now ? ', in effect now'
      : '; the cell is away and takes it up by itself'}.`);
    return this.load();
  }

  async export() {
    try {
      saveBlob('alarm-settings.csv', await fetchFile(PATH, { query: { format: 'csv' } }));
    } catch (error) {
      notify(`Not exported: ${error.message}.`);
    }
  }

  upload(file, query) {
    return call(`${PATH}/import`, { method: 'POST', query, timeoutMs: UPLOAD_MS,
      file: new Blob([file], { type: 'text/csv' }) });
  }

  /** Have the service judge the sheet; nothing is written. */
  async check() {
    const [file] = this.file.files;
    put(this.preview);
    if (!file) return;
    setText(this.say, `Checking ${file.name} …`);
    try {
      this.offer(file, await this.upload(file, { dry_run: true }));
    } catch (error) {
      setText(this.say, `${file.name} cannot be imported: ${error.message}.`);
    }
  }

  offer(file, { mistakes, differences, silences, changed }) {
    if (mistakes.length) {
      setText(this.say, `${file.name}: ${counted(mistakes.length, 'mistake')}, nothing can be imported.`);
      put(this.preview, h('ul', { class: 'problem' }, mistakes.slice(0, 100).map(({ row, column, detail }) =>
        h('li', {}, `Line ${row}, ${column}: ${detail}`))));
      return;
    }
    setText(this.say, differences.length ? `${file.name}: ${counted(changed, 'alarm')} would change.`
      : `${file.name}: nothing would change.`);
    if (!differences.length) return;
    const reason = h('input', { id: 'settings-reason', maxlength: 500, required: true });
    const take = h('button', { class: 'btn pri', type: 'button', onclick: () => {
      if (reason.value.trim()) this.import(file, reason.value.trim(), take);
      else reason.focus();
    } }, `Import ${counted(changed, 'alarm')}`);
    put(this.preview, silencesNote(silences), differenceTable(differences),
      h('div', { class: 'row filters' }, h('label', { for: 'settings-reason' }, 'Reason'), reason, take));
  }

  async import(file, comment, button) {
    button.disabled = true;
    try {
      const done = await this.upload(file, { comment });
      put(this.preview);
      this.file.value = '';
      await this.told(done);
    } catch (error) {
      setText(this.say, `${file.name} was not imported: ${error.message}.`);
      button.disabled = false;
    }
  }

  async toggleHistory() {
    this.history.hidden = !this.history.hidden;
    this.past.setAttribute('aria-expanded', String(!this.history.hidden));
    if (!this.history.hidden) await this.page.connection.guarded(() => this.loadHistory());
  }

  async loadHistory() {
    const { items } = await call(`${PATH}/history`, { query: { asset: this.asset.value, limit: 50 } });
    put(this.history, h('h3', {}, 'Latest changes'), items.length ? h('ul', { class: 'told' },
      items.map((one) => this.change(one))) : h('p', { class: 'mut' }, 'No setting was changed yet.'));
  }

  change(one) {
    const fields = [...new Set([...Object.keys(one.before), ...Object.keys(one.after)])]
      .filter((field) => shown(one.before[field] ?? null) !== shown(one.after[field] ?? null));
    const text = fields.map((field) => `${field.replaceAll('_', ' ')}: ${
      field in one.after ? shown(one.after[field]) : 'as configured'}`).join('; ');
    const undo = h('button', { class: 'btn sm', type: 'button', 'aria-label': `Undo ${text}`,
      onclick: () => this.undo(one, fields) }, 'Undo…');
    refuse(undo, this.page.refusal('engineer'));
    const at = milliseconds(one.time);
    return h('li', {},
      h('div', {}, bold([one.kind, one.tag, one.level].filter(Boolean).join(', ')), text),
      h('div', { class: 's' }, timeElement(at, dayTime(at)), ` ${one.who}: ${one.comment}`), undo);
  }

  async undo(one, fields) {
    const back = Object.fromEntries(fields.map((field) => [field, one.before[field] ?? null]));
    const body = { ...named(one), ...back, comment: `Undo of change ${one.revision}` };
    try {
      const tried = await call(PATH, { method: 'PATCH', body, query: { dry_run: true } });
      if (tried.mistakes.length) notify(tried.mistakes[0].detail);
      else if (await confirmChange(tried)) this.told(await call(PATH, { method: 'PATCH', body }));
    } catch (error) {
      notify(`Not undone: ${error.message}.`);
    }
  }
}

function timeText({ time_to_respond_p05_s: sooner, time_to_respond_p50_s: median, time_basis: basis }) {
  if (basis.startsWith('not ')) return 'not known';
  const text = (seconds) => (isNumber(seconds) ? spanText(seconds) : 'never within the horizon');
  return sooner === median ? text(sooner) : `${text(sooner)}, ${text(median)}`;
}
