// Make or change one asset: by the holes of its template as fields, or by its configuration as JSON.
import { h, put, setText } from './dom.js';
import { addAsset, holeValue, patchAsset, wrongField } from './provisioning.js';

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

/** A value in a field, as `holeValue` reads it. */
const holeText = (value) => (typeof value === 'string' ? value : JSON.stringify(value));

export class AssetForm {
  /** actions: { done(id, answer, isNew), cancel() } */
  constructor(page, actions) {
    this.page = page;
    this.actions = actions;
    this.templates = [];
    this.asset = null; // { id, table } of the one that is changed
    this.fields = new Map(); // by what the service calls them
    this.choice = h('select', { id: 'asset-template', onchange: () => this.showFields() });
    this.body = h('div', { class: 'fields' });
    this.problem = h('div', { class: 'problem', role: 'alert' });
    this.send = h('button', { class: 'btn pri' }, 'Add asset');
    this.title = h('h2', { id: 'add-title' });
    this.element = h('form', { class: 'panel p-add', 'aria-labelledby': 'add-title', hidden: true,
      onsubmit: (event) => { event.preventDefault(); this.submit(); } },
    h('header', {}, this.title),
    h('div', { class: 'fields' }, h('div', { class: 'field' },
      h('label', { for: 'asset-template' }, 'Template'), this.choice)),
    this.body, this.problem,
    h('div', { class: 'row' }, this.send,
      h('button', { class: 'btn', type: 'button', onclick: () => actions.cancel() }, 'Cancel')));
  }

  /** templates: [{ name, asks_for, values }]; asset: { id, table } to be changed, absent for a new one */
  open(templates, asset = null) {
    this.asset = asset;
    // An asset keeps its template here; as JSON everything can be changed.
    this.templates = asset ? templates.filter(({ name }) => name === asset.table.template) : templates;
    setText(this.title, asset ? `Edit the asset ${asset.id}` : 'Add an asset');
    setText(this.send, asset ? 'Save asset' : 'Add asset');
    put(this.choice, this.templates.map(({ name }) => h('option', { value: name }, name)),
      h('option', { value: '' }, asset ? 'whole configuration as JSON' : 'none (configuration as JSON)'));
    this.element.reset();
    this.showFields();
    this.element.hidden = false;
    this.choice.focus();
  }

  get template() {
    return this.templates.find(({ name }) => name === this.choice.value) ?? null;
  }

  showFields() {
    const { template, asset } = this;
    const table = asset?.table ?? {};
    this.fields.clear();
    put(this.problem);
    put(this.body, !asset && this.field('id', 'Id',
      h('input', { required: true, pattern: ID, title: ID_HINT }), ID_HINT),
    template ? [
      this.field('name', 'Name (optional)', h('input', { maxlength: 200, value: table.name ?? '' })),
      this.field('group', 'Group (optional)', h('input', { maxlength: 200, value: table.group ?? '' })),
      template.asks_for.map((name) => this.hole(name, template.values[name], table.values?.[name])),
    ] : this.field('json', 'Configuration', h('textarea', {
      rows: asset ? 18 : 9, required: true, spellcheck: 'false', placeholder: EXAMPLE,
    }, asset ? JSON.stringify(table, null, 2) : ''), JSON_HINT));
  }

  /** value: what the template gives; own: what the asset itself does */
  hole(name, value, own) {
    const given = value !== undefined;
    return this.field(`values.${name}`, name, h('input', {
      required: !given, value: own === undefined ? '' : holeText(own),
    }), given ? `Empty: ${JSON.stringify(value)}, from the template.` : '');
  }

  /** A label, its control, a hint, and a place for what is wrong with it. */
  field(key, label, control, hint = '') {
    const id = `asset-${key.replaceAll('.', '-')}`;
    const wrong = h('p', { class: 'problem', id: `${id}-wrong`, hidden: true });
    Object.entries({ id, name: key, autocomplete: 'off', 'aria-describedby':
      `${hint ? `${id}-hint ` : ''}${id}-wrong` }).forEach(([name, one]) => control.setAttribute(name, one));
    this.fields.set(key, { control, wrong });
    return h('div', { class: key === 'json' ? 'field whole' : 'field' }, h('label', { for: id }, label),
      control, hint && h('p', { class: 'xs mut', id: `${id}-hint` }, hint), wrong);
  }

  text(key) {
    return this.fields.get(key).control.value.trim();
  }

  /** The table of the asset as the configuration file would hold it. */
  table() {
    const { template } = this;
    if (!template) {
      const table = JSON.parse(this.text('json'));
      if (table === null || typeof table !== 'object' || Array.isArray(table)) {
        throw new SyntaxError('expected an object, in braces');
      }
      return table;
    }
    const { name, group, values: before = {}, ...others } = this.asset?.table ?? {};
    const table = { ...others, template: template.name };
    for (const key of ['name', 'group']) if (this.text(key)) table[key] = this.text(key);
    const values = { ...before };
    for (const hole of template.asks_for) {
      const text = this.text(`values.${hole}`);
      if (!text) delete values[hole];
      // What was not touched stays what it was, also a text of digits alone.
      else if (!(hole in before) || text !== holeText(before[hole])) values[hole] = holeValue(text);
    }
    if (Object.keys(values).length) table.values = values;
    return table;
  }

  async submit() {
    this.showWrong([]);
    const { asset } = this;
    const id = asset?.id ?? this.text('id');
    let table;
    try {
      table = this.table();
    } catch (error) {
      this.showWrong([{ field: 'json', reason: `Not valid JSON: ${error.message}` }]);
      return;
    }
    this.send.disabled = true;
    try {
      const answer = await (asset ? patchAsset(id, asset.table, table) : addAsset(id, table));
      await this.actions.done(id, answer, !asset);
    } catch (error) {
      const wrong = error.status === 412
        ? [{ field: 'id', reason: `There is an asset ${id} already. “Edit…” in its row changes it.` }]
        : error.errors?.map(wrongField) ?? [];
      this.showWrong(wrong.length ? wrong : [{ field: '', reason: error.message }]);
    } finally {
      this.send.disabled = false;
    }
  }

  /** Each fault beside its field; the others below the form. */
  showWrong(faults) {
    for (const { control, wrong } of this.fields.values()) {
      wrong.hidden = true;
      control.removeAttribute('aria-invalid');
    }
    const others = [];
    for (const { field, reason } of faults) {
      const known = this.fields.get(field === 'asset_id' ? 'id' : field);
      if (!known) {
        others.push(field && !reason.startsWith(field) ? `${field}: ${reason}` : reason);
        continue;
      }
      setText(known.wrong, reason);
      known.wrong.hidden = false;
      known.control.setAttribute('aria-invalid', 'true');
    }
    const refused = this.asset ? 'The asset was not changed.' : 'The asset was not added.';
    put(this.problem, faults.length > 0 && h('p', {}, refused),
      others.map((line) => h('p', {}, line)));
    this.element.querySelector('[aria-invalid]')?.focus();
  }

  close() {
    this.element.hidden = true;
  }
}
