// Make or change one asset, by the holes of its template as fields or by its configuration as JSON; many from CSV.
import { form, options, Panel, table, v } from '../parts/panel.js';
import { addAsset, holeValue, importCsv, patchAsset, plural, wrongField } from './provisioning.js';

const ID = '[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}';
const ID_HINT = 'Letters, digits, dot, hyphen, underscore; at most 64. It cannot be changed later.';
const JSON_HINT = 'The keys of an [[assets]] section of the configuration file.';
const EXAMPLE = `{
  "bearing": "6311",
  "low_risk": { "speed_rpm_max": 4300, "load_n_max": 3400 },
  "channels": {
    "t_inner_ring_c": { "source": "push" }
  }
}`;

const holeText = (value) => (typeof value === 'string' ? value : JSON.stringify(value));

/**
 * templates: [{ name, asks_for, values }]; asset: { id, table } to be changed, null for a new one;
 * done(id, answer, isNew), cancel()
 */
export class AssetForm extends Panel {
  constructor(attributes) {
    super(attributes);
    const { asset, templates } = attributes;
    // An asset keeps its template here; as JSON everything can be changed.
    this.templates = asset ? templates.filter(({ name }) => name === asset.table.template) : templates;
    [this.template = null] = this.templates;
    this.others = [];
    this.faults = new Map(); // reason by what the service calls the field
  }

  componentDidMount() {
    this.form.elements.template.focus();
    this.form.scrollIntoView({ block: 'nearest' });
  }

  componentDidUpdate() {
    if (this.isRefused) this.form.querySelector('[aria-invalid]')?.focus();
    this.isRefused = false;
  }

  render({ asset, cancel }) {
    const { template } = this;
    const table = asset?.table ?? {};
    this.shown = new Set();
    const choose = ({ target }) => this.set({ faults: new Map(), others: [],
      template: this.templates.find(({ name }) => name === target.value) ?? null });
    return form({ class: 'panel p-add', 'aria-labelledby': 'add-title', ref: (one) => { this.form = one; } },
      (filled) => this.submit(new FormData(filled)),
    v('header', {}, v('h2', { id: 'add-title' }, asset ? `Edit the asset ${asset.id}` : 'Add an asset')),
    v('div', { class: 'fields' }, v('div', { class: 'field' }, v('label', { for: 'asset-template' }, 'Template'),
      v('select', { id: 'asset-template', name: 'template', onchange: choose },
        options([...this.templates.map(({ name }) => [name, name]),
          ['', asset ? 'whole configuration as JSON' : 'none (configuration as JSON)']], template?.name ?? '')))),
    v('div', { class: 'fields' },
      !asset && this.field('id', 'Id', ['input', { required: true, pattern: ID, title: ID_HINT }], ID_HINT),
      template ? [
        this.field('name', 'Name (optional)', ['input', { maxlength: 200, defaultValue: table.name ?? '' }]),
        this.field('group', 'Group (optional)', ['input', { maxlength: 200, defaultValue: table.group ?? '' }]),
        template.asks_for.map((name) => this.hole(name, template.values[name], table.values?.[name])),
      ] : this.field('json', 'Configuration', ['textarea', {
        rows: asset ? 18 : 9, required: true, spellcheck: false, placeholder: EXAMPLE,
        defaultValue: asset ? JSON.stringify(table, null, 2) : '',
      }], JSON_HINT)),
    v('div', { class: 'problem', role: 'alert' },
      this.faults.size + this.others.length > 0
        && v('p', {}, asset ? 'The asset was not changed.' : 'The asset was not added.'),
      this.others.map((line) => v('p', {}, line))),
    v('div', { class: 'row' },
      v('button', { class: 'btn pri', disabled: this.isSending }, asset ? 'Save asset' : 'Add asset'),
      v('button', { class: 'btn', type: 'button', onclick: cancel }, 'Cancel')));
  }

  hole(name, value, own) {
    const given = value !== undefined;
    return this.field(`values.${name}`, name, ['input', {
      required: !given, defaultValue: own === undefined ? '' : holeText(own),
    }], given ? `Empty: ${JSON.stringify(value)}, from the template.` : '');
  }

  field(name, label, [tag, given], hint = '') {
    const id = `asset-${name.replaceAll('.', '-')}`;
    const reason = this.faults.get(name);
    this.shown.add(name);
    return v('div', { class: name === 'json' ? 'field whole' : 'field', key: `${this.template?.name} ${name}` },
      v('label', { for: id }, label), v(tag, { id, name, autocomplete: 'off', ...given,
        'aria-invalid': reason ? 'true' : null, 'aria-describedby': `${hint ? `${id}-hint ` : ''}${id}-wrong` }),
      hint && v('p', { class: 'xs mut', id: `${id}-hint` }, hint),
      v('p', { class: 'problem', id: `${id}-wrong`, hidden: !reason }, reason));
  }

  table(data) {
    const { template } = this;
    const text = (key) => data.get(key).trim();
    if (!template) {
      const table = JSON.parse(text('json'));
      if (table === null || typeof table !== 'object' || Array.isArray(table)) {
        throw new SyntaxError('expected an object, in braces');
      }
      return table;
    }
    const { name, group, values: before = {}, ...others } = this.props.asset?.table ?? {};
    const table = { ...others, template: template.name };
    for (const key of ['name', 'group']) if (text(key)) table[key] = text(key);
    const values = { ...before };
    for (const hole of template.asks_for) {
      const typed = text(`values.${hole}`);
      if (!typed) delete values[hole];
      // What was not touched stays what it was, also a text of digits alone.
      else if (!(hole in before) || typed !== holeText(before[hole])) values[hole] = holeValue(typed);
    }
    if (Object.keys(values).length) table.values = values;
    return table;
  }

  async submit(data) {
    const { asset, done } = this.props;
    const id = asset?.id ?? data.get('id').trim();
    this.refuse([]);
    let table;
    try {
      table = this.table(data);
    } catch (error) {
      this.refuse([{ field: 'json', reason: `Not valid JSON: ${error.message}` }]);
      return;
    }
    this.set({ isSending: true });
    try {
      await done(id, await (asset ? patchAsset(id, asset.table, table) : addAsset(id, table)), !asset);
    } catch (error) {
      const wrong = error.status === 412
        ? [{ field: 'id', reason: `There is an asset ${id} already. “Edit…” in its row changes it.` }]
        : error.errors?.map(wrongField) ?? [];
      this.refuse(wrong.length ? wrong : [{ field: '', reason: error.message }]);
    }
    this.set({ isSending: false });
  }

  refuse(faults) {
    const named = faults.map(({ field, reason }) => [field === 'asset_id' ? 'id' : field, reason]);
    this.set({
      isRefused: faults.length > 0,
      faults: new Map(named.filter(([field]) => this.shown.has(field))),
      others: named.filter(([field]) => !this.shown.has(field)).map(([field, reason]) =>
        (field && !reason.startsWith(field) ? `${field}: ${reason}` : reason)),
    });
  }
}

const MOST_ROWS = 200;

export class AssetImport extends Panel {
  componentDidMount() {
    this.input.focus();
    this.input.closest('section').scrollIntoView({ block: 'nearest' });
  }

  render({ cancel }) {
    const { good, rejected = [] } = this;
    return v('section', { class: 'panel p-import', 'aria-labelledby': 'import-title' },
      v('header', {}, v('h2', { id: 'import-title' }, 'Import a CSV file')),
      v('div', { class: 'field' }, v('label', { for: 'asset-file' }, 'CSV file'),
        v('input', { type: 'file', id: 'asset-file', accept: '.csv,text/csv', 'aria-describedby': 'asset-file-hint',
          onchange: ({ target }) => this.check(target.files[0]), ref: (input) => { this.input = input; } }),
        v('p', { class: 'xs mut', id: 'asset-file-hint' }, 'One asset per row. Columns: id, template, '
          + 'name, group; each other column is a value for the template. The file is checked first. '
          + 'Nothing is changed until you import.')),
      v('p', { class: 'b', role: 'status' }, this.summary), rejected.length > 0 && faultTable(rejected),
      v('div', { class: 'row' },
        good > 0 && v('button', { class: 'btn pri', type: 'button', disabled: this.isSending,
          onclick: () => this.import() }, rejected.length ? `Import the ${plural(good, 'good row')}`
          : `Import ${plural(good, 'asset')}`),
        v('button', { class: 'btn', type: 'button', onclick: cancel }, 'Cancel')));
  }

  async check(file) {
    this.set({ file, good: 0, rejected: [], summary: file && `Checking ${file.name} …` });
    if (!file) return;
    const say = (summary) => this.file === file && this.set({ summary });
    await this.tried(`${file.name} cannot be imported`, async () => {
      const { created, changed, unchanged, rejected } = await importCsv(file, { dry_run: true, partial: true });
      if (this.file !== file) return;
      const good = created + changed;
      const parts = [`${created} new`, `${changed} changed`, `${unchanged} unchanged`,
        plural(rejected.length, 'row with errors', 'rows with errors')];
      this.set({ good, rejected });
      say(`${file.name}: ${parts.join(', ')}.${good ? '' : ' Nothing to import.'}`);
    }, say);
  }

  async import() {
    const { file, rejected } = this;
    this.set({ isSending: true, summary: `Importing ${file.name} …` });
    await this.tried(`${file.name} was not imported`, async () =>
      this.props.done(await importCsv(file, { partial: rejected.length > 0 })),
    (summary) => this.set({ isSending: false, summary }));
  }
}

function faultTable(rejected) {
  const faults = rejected.flatMap(({ row, id, detail, errors }) =>
    (errors.length ? errors.map(wrongField) : [{ field: '', reason: detail }])
      .map((fault) => ({ row, id, ...fault })));
  const rest = faults.length - MOST_ROWS;
  return [
    table('Rows with errors', [['Line', ({ row }) => [v('span', { class: 'lb' }, 'Line '), row], 'b'],
      ['Asset', ({ id }) => id ?? '–'], ['Field', ({ field }) => field || '–'], ['Reason', ({ reason }) => reason]],
    faults.slice(0, MOST_ROWS), { look: 'ft' }),
    rest > 0 && v('p', { class: 's mut' }, `${plural(rest, 'more error')} not shown.`),
  ];
}
