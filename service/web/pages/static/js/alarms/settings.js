// Alarm settings: every alarm that can be raised, edited in place, as a sheet, with its history.
import { call, callPages, fetchFile, saveBlob } from '../app/api.js';
import { notify } from '../parts/dialogs.js';
import { counted, isNumber, moment, spanText } from '../parts/format.js';
import { button, form, hasText, Panel, quiet, search, select, table, unless, v } from '../parts/panel.js';
import { askSettings, confirmChange, differenceTable, named, shown, silencesNote } from './setting_form.js';

const PATH = '/alarm-settings';
const UPLOAD_MS = 120000;

export class AlarmSettings extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { asset: this.page.live.assetId, rows: [], word: '', count: 'Loading …', history: null });
    this.refused = unless(this.page.refusal('engineer'));
    this.load();
  }

  async load(asset = this.asset) {
    this.set({ asset, count: 'Loading …' });
    await this.page.connection.guarded(async () => {
      const rows = await callPages(PATH, { asset, limit: 1000 });
      if (asset !== this.asset) return;
      this.set({ rows, count: '' });
      if (this.history) await this.loadHistory();
    });
  }

  render() {
    const rows = this.rows.filter((row) => hasText(Object.values(row), this.word));
    return [
      v('p', { class: 's mut' }, 'The configuration file is the base; what is changed here lies over it '
        + 'and is in effect at once. Time to respond: from the twin’s kept forecasts.'),
      v('div', { class: 'row filters' },
        this.page.assets.length > 1 && select('Asset of the settings',
          this.page.assets.map(({ id }) => [id, this.page.nameOf(id)]), this.asset, (asset) => this.load(asset)),
        search('Filter alarms', (word) => this.set({ word })), button('Export CSV', () => this.export()),
        v('label', { for: 'settings-file' }, 'Import CSV'),
        v('input', { type: 'file', id: 'settings-file', accept: '.csv,text/csv', ...this.refused,
          onchange: ({ target }) => this.check(target) }),
        button('History', () => this.toggleHistory(), { 'aria-expanded': Boolean(this.history) }),
        quiet(this.count || `${counted(rows.length, 'alarm')} of ${this.rows.length}`, 'status')),
      v('p', { class: 'b say', role: 'status' }, this.say), v('div', {}, this.preview),
      this.history && v('div', {}, v('h3', {}, 'Latest changes'), this.history.length
        ? v('ul', { class: 'notices' }, this.history.map((one) => this.change(one)))
        : v('p', { class: 'mut' }, 'No setting was changed yet.')),
      table('Alarm settings', this.columns(), rows,
        { look: 'st', attributesOf: (row) => ({ key: Object.values(named(row)).join(' ') }) }),
    ];
  }

  columns() {
    return [
      ['Alarm', (row) => [v('b', {}, row.description), !row.enabled && v('span', { class: 'chip' }, 'disabled'),
        row.changed.length > 0 && quiet(` changed here: ${row.changed.join(', ').replaceAll('_', ' ')}`)]],
      ['Setpoint', (row) => `${shown(row.setpoint)}${row.setpoint === null ? '' : ` ${row.unit}`}`, 'num'],
      ['On-delay', (row) => `${row.on_delay_s} s`, 'num'], ['Priority', (row) => row.priority, 'num'],
      ['Time to respond (5 %, median)', (row) => v('td', { title: row.time_basis }, timeText(row))],
      ['Operator action', (row) => row.operator_action, 'why s'], ['Status', (row) => row.status],
      ['', (row) => button('Edit…', () => this.edit(row),
        { 'aria-label': `Edit ${row.description}`, ...this.refused })],
    ];
  }

  async edit(row) {
    const body = await askSettings(row);
    if (body) await this.send(body, 'Not changed');
  }

  async send(body, failure) {
    await this.tried(failure, async () => {
      const { mistakes, ...tried } = await call(PATH, { method: 'PATCH', body, query: { dry_run: true } });
      if (mistakes.length) notify(mistakes.map(({ column, detail }) => `${column}: ${detail}`).join('; '));
      else if (!tried.differences.length) notify('Nothing is changed.');
      else if (await confirmChange(tried)) await this.takeChange(await call(PATH, { method: 'PATCH', body }));
    });
  }

  takeChange({ changed, in_effect: now }) {
    this.say = `${counted(changed, 'alarm')} changed${now ? ', in effect now'
      : '; the cell is offline and takes it over when it is back'}.`;
    return this.load();
  }

  async export() {
    const file = await this.tried('Not exported', () => fetchFile(PATH, { query: { format: 'csv' } }));
    if (file) saveBlob('alarm-settings.csv', file);
  }

  upload(file, query) {
    return call(`${PATH}/import`, { method: 'POST', query, timeoutMs: UPLOAD_MS,
      file: new Blob([file], { type: 'text/csv' }) });
  }

  async check(input) {
    const [file] = input.files;
    this.set({ preview: null, ...(file && { say: `Checking ${file.name} …` }) });
    if (!file) return;
    await this.tried(`${file.name} cannot be imported`, async () =>
      this.offer(input, await this.upload(file, { dry_run: true })), (say) => { this.say = say; });
    this.draw();
  }

  offer(input, { mistakes, differences, silences, changed }) {
    const [file] = input.files;
    if (mistakes.length) {
      this.say = `${file.name}: ${counted(mistakes.length, 'mistake')}, nothing can be imported.`;
      this.preview = v('ul', { class: 'problem' }, mistakes.slice(0, 100).map(({ row, column, detail }) =>
        v('li', {}, `Line ${row}, ${column}: ${detail}`)));
      return;
    }
    this.say = differences.length ? `${file.name}: ${counted(changed, 'alarm')} would change.`
      : `${file.name}: nothing would change.`;
    if (!differences.length) return;
    const take = ({ reason }, submitter) => {
      if (reason.value.trim()) this.import(input, reason.value.trim(), submitter);
      else reason.focus();
    };
    this.preview = [silencesNote(silences), differenceTable(differences),
      form({ class: 'row filters', novalidate: true }, take,
        v('label', { for: 'settings-reason' }, 'Reason'),
        v('input', { id: 'settings-reason', name: 'reason', maxlength: 500, required: true }),
        v('button', { class: 'btn pri' }, `Import ${counted(changed, 'alarm')}`))];
  }

  async import(input, comment, submitter) {
    const [file] = input.files;
    submitter.disabled = true;
    await this.tried(`${file.name} was not imported`, async () => {
      const done = await this.upload(file, { comment });
      this.preview = null;
      input.value = '';
      await this.takeChange(done);
    }, (say) => {
      submitter.disabled = false;
      this.set({ say });
    });
  }

  async toggleHistory() {
    if (this.history) this.set({ history: null });
    else await this.page.connection.guarded(() => this.loadHistory());
  }

  async loadHistory() {
    const { items } = await call(`${PATH}/history`, { query: { asset: this.asset, limit: 50 } });
    this.set({ history: items });
  }

  change(one) {
    const fields = [...new Set([...Object.keys(one.before), ...Object.keys(one.after)])]
      .filter((field) => shown(one.before[field] ?? null) !== shown(one.after[field] ?? null));
    const text = fields.map((field) => `${field.replaceAll('_', ' ')}: ${
      field in one.after ? shown(one.after[field]) : 'as configured'}`).join('; ');
    const undo = () => this.send({ ...named(one), comment: `Undo of change ${one.revision}`,
      ...Object.fromEntries(fields.map((field) => [field, one.before[field] ?? null])) }, 'Not undone');
    return v('li', { key: one.revision },
      v('div', {}, v('b', {}, [one.kind, one.tag, one.level].filter(Boolean).join(', ')), text),
      v('div', { class: 's' }, moment(one.time), ` ${one.who}: ${one.comment}`),
      button('Undo…', undo, { 'aria-label': `Undo ${text}`, ...this.refused }));
  }
}

function timeText({ time_to_respond_p05_s: sooner, time_to_respond_p50_s: median, time_basis: basis }) {
  if (basis.startsWith('not ')) return 'not known';
  const text = (seconds) => (isNumber(seconds) ? spanText(seconds) : 'never within the horizon');
  return sooner === median ? text(sooner) : `${text(sooner)}, ${text(median)}`;
}
