// Many assets from a CSV file: it is checked first, and only the button imports.
import { h, put, scrollable, setText } from './dom.js';
import { importCsv, plural, wrongField } from './provisioning.js';

const MOST_ROWS = 200;

export class AssetImport {
  /** actions: { done(answer), cancel() } */
  constructor(actions) {
    this.actions = actions;
    this.input = h('input', {
      type: 'file', id: 'asset-file', accept: '.csv,text/csv', onchange: () => this.check(),
      'aria-describedby': 'asset-file-hint',
    });
    this.summary = h('p', { class: 'b', role: 'status' });
    this.faults = h('div', {});
    this.take = h('button', { class: 'btn pri', type: 'button', hidden: true, onclick: () => this.import() });
    this.element = h('section', { class: 'panel p-import', 'aria-labelledby': 'import-title', hidden: true },
      h('header', {}, h('h2', { id: 'import-title' }, 'Import a CSV file')),
      h('div', { class: 'field' }, h('label', { for: 'asset-file' }, 'CSV file'), this.input,
        h('p', { class: 'xs mut', id: 'asset-file-hint' }, 'One asset per row. Columns: id, template, '
          + 'name, group; each other column is a value for the template. The file is checked first. '
          + 'Nothing is changed until you import.')),
      this.summary, this.faults,
      h('div', { class: 'row' }, this.take,
        h('button', { class: 'btn', type: 'button', onclick: () => actions.cancel() }, 'Cancel')));
  }

  open() {
    this.clear();
    this.input.value = '';
    this.element.hidden = false;
    this.input.focus();
  }

  close() {
    this.element.hidden = true;
    this.file = null;
  }

  clear() {
    setText(this.summary, '');
    put(this.faults);
    this.take.hidden = true;
  }

  /** Have the service judge the file; nothing is written. */
  async check() {
    const [file] = this.input.files;
    this.file = file ?? null;
    this.clear();
    if (!file) return;
    setText(this.summary, `Checking ${file.name} …`);
    try {
      const answer = await importCsv(file, { dry_run: true, partial: true });
      if (this.file === file) this.show(answer);
    } catch (error) {
      if (this.file === file) setText(this.summary, `${file.name} cannot be imported: ${error.message}.`);
    }
  }

  show({ created, changed, unchanged, rejected }) {
    const good = created + changed;
    const parts = [`${created} new`, `${changed} changed`, `${unchanged} unchanged`,
      plural(rejected.length, 'row with errors', 'rows with errors')];
    setText(this.summary, `${this.file.name}: ${parts.join(', ')}.${good ? '' : ' Nothing to import.'}`);
    this.partial = rejected.length > 0;
    this.take.hidden = !good;
    setText(this.take, rejected.length ? `Import the ${plural(good, 'good row')}`
      : `Import ${plural(good, 'asset')}`);
    put(this.faults, rejected.length > 0 && faultTable(rejected));
  }

  async import() {
    const { file } = this;
    this.take.disabled = true;
    setText(this.summary, `Importing ${file.name} …`);
    try {
      const answer = await importCsv(file, { partial: this.partial });
      this.close();
      await this.actions.done(answer);
    } catch (error) {
      setText(this.summary, `${file.name} was not imported: ${error.message}.`);
    } finally {
      this.take.disabled = false;
    }
  }
}

/** Each fault on a line: where it is in the file, and what was expected. */
function faultTable(rejected) {
  const faults = rejected.flatMap(({ row, id, detail, errors }) =>
    (errors.length ? errors.map(wrongField) : [{ field: '', reason: detail }])
      .map((fault) => ({ row, id, ...fault })));
  const head = ['Line', 'Asset', 'Field', 'Reason'];
  const rest = faults.length - MOST_ROWS;
  return [
    scrollable('scroll', 'Rows with errors', h('table', { class: 'ft' },
      h('thead', {}, h('tr', {}, head.map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, faults.slice(0, MOST_ROWS).map(({ row, id, field, reason }) => h('tr', {},
        h('td', { class: 'b' }, h('span', { class: 'lb' }, 'Line '), String(row)),
        h('td', {}, id ?? '–'), h('td', {}, field || '–'), h('td', {}, reason)))))),
    rest > 0 && h('p', { class: 's mut' }, `${plural(rest, 'more error')} not shown.`),
  ];
}
