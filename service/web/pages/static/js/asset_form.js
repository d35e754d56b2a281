// Make one asset: from a template, whose holes become fields, or from its configuration as JSON.
import { h, put, setText } from './dom.js';
import { holeValue, putAsset, wrongField } from './provisioning.js';

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

export class AssetForm {
  /** actions: { done(id, answer), cancel() } */
  constructor(page, actions) {
    this.page = page;
    this.actions = actions;
    this.templates = [];
    this.fields = new Map(); // by what the service calls them
    this.choice = h('select', { id: 'asset-template', onchange: () => this.showFields() });
    this.body = h('div', { class: 'fields' });
    this.problem = h('div', { class: 'problem', role: 'alert' });
    this.send = h('button', { class: 'btn pri' }, 'Add asset');
    this.element = h('form', { class: 'panel p-add', 'aria-labelledby': 'add-title', hidden: true,
      onsubmit: (event) => { event.preventDefault(); this.submit(); } },
    h('header', {}, h('h2', { id: 'add-title' }, 'Add an asset')),
    h('div', { class: 'fields' }, h('div', { class: 'field' },
      h('label', { for: 'asset-template' }, 'Template'), this.choice)),
    this.body, this.problem,
    h('div', { class: 'row' }, this.send,
      h('button', { class: 'btn', type: 'button', onclick: () => actions.cancel() }, 'Cancel')));
  }

  /** templates: [{ name, asks_for, values }] */
  open(templates) {
    this.templates = templates;
    put(this.choice, templates.map(({ name }) => h('option', { value: name }, name)),
      h('option', { value: '' }, 'none (configuration as JSON)'));
    this.element.reset();
    this.showFields();
    this.element.hidden = false;
    this.choice.focus();
  }

  get template() {
    return this.templates.find(({ name }) => name === this.choice.value) ?? null;
  }

  showFields() {
    const { template } = this;
    this.fields.clear();
    put(this.problem);
    put(this.body, this.field('id', 'Id', h('input', { required: true, pattern: ID, title: ID_HINT }), ID_HINT),
      template ? [
        this.field('name', 'Name (optional)', h('input', { maxlength: 200 })),
        this.field('group', 'Group (optional)', h('input', { maxlength: 200 })),
        template.asks_for.map((name) => this.hole(name, template.values[name])),
      ] : this.field('json', 'Configuration', h('textarea', {
        rows: 9, required: true, spellcheck: 'false', placeholder: EXAMPLE,
      }), JSON_HINT));
  }

  hole(name, value) {
    const given = value !== undefined;
    return this.field(`values.${name}`, name, h('input', { required: !given }),
      given ? `Empty: ${JSON.stringify(value)}, from the template.` : '');
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
    const table = { template: template.name };
    for (const key of ['name', 'group']) if (this.text(key)) table[key] = this.text(key);
    const values = template.asks_for.map((name) => [name, this.text(`values.${name}`)])
      .filter(([, text]) => text).map(([name, text]) => [name, holeValue(text)]);
    if (values.length) table.values = Object.fromEntries(values);
    return table;
  }

  async submit() {
    this.showWrong([]);
    const id = this.text('id');
    let table;
    try {
      table = this.table();
    } catch (error) {
      this.showWrong([{ field: 'json', reason: `Not valid JSON: ${error.message}` }]);
      return;
    }
    if (this.page.assets.some((asset) => asset.id === id)) {
      this.showWrong([{ field: 'id', reason: `There is an asset ${id} already.` }]);
      return;
    }
    this.send.disabled = true;
    try {
      await this.actions.done(id, await putAsset(id, table));
    } catch (error) {
      const wrong = error.errors?.map(wrongField) ?? [];
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
    put(this.problem, faults.length > 0 && h('p', {}, 'The asset was not added.'),
      others.map((line) => h('p', {}, line)));
    this.element.querySelector('[aria-invalid]')?.focus();
  }

  close() {
    this.element.hidden = true;
  }
}
