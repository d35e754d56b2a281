// All assets: which there are, where they are configured; add, edit, remove and import them.
import { refuse } from '../alarm_list.js';
import { AssetForm } from '../asset_form.js';
import { AssetImport } from '../asset_import.js';
import { openDialog } from '../dialogs.js';
import { h, put, scrollable, setText } from '../dom.js';
import { NightsPanel } from '../nights_panel.js';
import { assetRows, loadConfiguration, loadProvisioning, plural, removeAssets } from '../provisioning.js';
import { assetHash } from '../route.js';

const REFRESH_MS = 10000;
const MOST_ROWS = 100;
const MOST_NAMED = 10; // of those that are to be removed
const HEAD = ['Asset', 'Group', 'Template', 'Configured in', 'State', 'Actions'];

export class AssetsView {
  constructor(box, page) {
    this.page = page;
    this.known = { templates: [], items: [] };
    this.most = MOST_ROWS;
    this.chosen = new Set();
    this.count = h('span', { class: 's mut' });
    this.search = h('input', {
      type: 'search', placeholder: 'Search assets', 'aria-label': 'Search assets',
      oninput: () => { this.most = MOST_ROWS; this.show(); },
    });
    // The form has a field for each hole of a template: it waits until the templates are known.
    this.add = this.createButton('Add asset…', async () => {
      await this.first;
      if (!this.ended) this.open(this.form, this.known.templates);
    });
    this.importing = this.createButton('Import CSV…', () => this.open(this.file));
    this.removal = h('button', { class: 'btn', type: 'button', hidden: true,
      onclick: () => this.remove([...this.chosen]) });
    this.all = h('input', { type: 'checkbox', 'aria-label': 'Select all assets found',
      onchange: () => this.chooseAll() });
    refuse(this.all, page.refusal('admin'));
    this.form = new AssetForm(page, {
      done: (id, answer, isNew) => this.done(answer.not_running
        ? `Asset ${id} is saved, but it does not run: ${answer.not_running}.`
        : `Asset ${id} ${isNew ? 'added' : 'changed'}.`),
      cancel: () => this.close(),
    });
    this.file = new AssetImport({
      done: (answer) => this.done(importedText(answer)), cancel: () => this.close(),
    });
    this.nights = new NightsPanel();
    this.status = h('p', { class: 'pad', role: 'status' });
    this.problem = h('p', { class: 'problem pad', role: 'alert', hidden: true });
    this.body = h('tbody', {});
    this.more = h('button', { class: 'btn sm', type: 'button', hidden: true,
      onclick: () => { this.most += MOST_ROWS; this.show(); } }, `Show ${MOST_ROWS} more`);
    put(box, h('h1', { class: 'vh' }, 'Assets'), this.form.element, this.file.element,
      h('section', { class: 'panel p-assets' },
        h('header', {}, h('h2', {}, 'Assets'), this.count, h('span', { class: 'sp' }),
          h('span', { class: 'row filters' }, this.search, this.removal, this.importing, this.add,
            page.may('admin') && h('a', { class: 'btn', href: '#commissioning' }, 'Commission a bench'))),
        this.status, this.problem,
        scrollable('scroll', 'All assets', h('table', { class: 'at' },
          h('thead', {}, h('tr', {}, h('th', { class: 'tick' }, this.all),
            HEAD.map((text) => h('th', { scope: 'col' }, text)))),
          this.body), this.more)), this.nights.element);
    this.timer = setInterval(() => this.load(), REFRESH_MS);
    this.show();
    this.first = this.load();
  }

  destroy() {
    clearInterval(this.timer);
    this.ended = true;
  }

  createButton(text, act) {
    const button = h('button', { class: 'btn', type: 'button', 'aria-expanded': 'false', onclick: act }, text);
    refuse(button, this.page.refusal('admin'));
    return button;
  }

  open(panel, ...more) {
    this.close(false);
    setText(this.status, '');
    panel.open(...more);
    this.opener = panel === this.form ? this.add : this.importing;
    this.edited = panel === this.form ? this.form.asset?.id : null;
    if (!this.edited) this.opener.setAttribute('aria-expanded', 'true');
    panel.element.scrollIntoView({ block: 'nearest' });
  }

  /** Close what is open; the button that opened it has the focus again. */
  close(focus = true) {
    this.form.close();
    this.file.close();
    this.opener?.setAttribute('aria-expanded', 'false');
    if (focus) (this.editButton() ?? this.opener)?.focus();
  }

  editButton() {
    const row = this.edited && this.body.querySelector(`[data-asset="${CSS.escape(this.edited)}"]`);
    return row ? row.querySelector('.ac button') : null;
  }

  /** Something has changed: every list of the page shows it. */
  async done(text) {
    this.close();
    setText(this.status, text);
    await this.page.connection.guarded(() => this.page.reloadAssets());
    await this.load();
  }

  async load() {
    try {
      this.known = await loadProvisioning();
      await this.nights.load();
      this.problem.hidden = true;
    } catch (error) {
      setText(this.problem, `Loading failed: ${error.message}.`);
      this.problem.hidden = false;
    }
    if (!this.ended) this.show();
  }

  assetsChanged() {
    this.show();
  }

  show() {
    const { assets: listed, feeds } = this.page.connection;
    const assets = [...listed].map(([id, asset]) => feeds.get(id)?.store.get('asset') ?? asset);
    const rows = assetRows(assets, this.known.items);
    const word = this.search.value.trim().toLowerCase();
    const found = rows.filter((row) => !word || [row.id, row.name, row.group, row.template, row.state]
      .join(' ').toLowerCase().includes(word));
    this.names = new Map(rows.map(({ id, name }) => [id, name]));
    const stored = rows.filter(({ origin }) => origin === 'provisioned').length;
    setText(this.count, `${plural(rows.length, 'asset')}: ${rows.length - stored} in the configuration `
      + `file, ${stored} provisioned${word ? `; ${found.length} found` : ''}`);
    this.found = found.filter(({ origin }) => origin === 'provisioned').map(({ id }) => id);
    const present = new Set(rows.map(({ id }) => id));
    this.chosen = new Set([...this.chosen].filter((id) => present.has(id)));
    this.showChosen();
    this.more.hidden = found.length <= this.most;
    const shown = found.slice(0, this.most);
    const look = JSON.stringify(shown);
    if (look === this.look) return;
    this.look = look;
    const active = document.activeElement;
    const [at, name] = [active?.closest('tr')?.dataset.asset, active?.getAttribute('aria-label')];
    put(this.body, shown.map((row) => this.row(row)));
    if (!shown.length) {
      put(this.body, h('tr', {}, h('td', { colspan: HEAD.length + 1, class: 'mut pad' },
        rows.length ? 'No asset matches the search.' : ['No asset is configured yet. ',
          this.page.may('admin') && h('a', { href: '#commissioning' },
            'Commission a bench: from its address to the first live value.')])));
    }
    if (at) {
      const controls = [...this.body.querySelectorAll(
        `[data-asset="${CSS.escape(at)}"] :is(a, button, input)`)];
      (controls.find((one) => one.getAttribute('aria-label') === name) ?? controls[0])?.focus();
    }
  }

  /** Ticks, and the button for those that are ticked; also of rows that are not shown now. */
  showChosen() {
    const { chosen, found } = this;
    this.removal.hidden = !chosen.size;
    setText(this.removal, `Remove ${chosen.size} selected…`);
    this.all.checked = found.length > 0 && found.every((id) => chosen.has(id));
    this.all.indeterminate = !this.all.checked && found.some((id) => chosen.has(id));
    for (const tick of this.body.querySelectorAll('input')) {
      tick.checked = chosen.has(tick.closest('tr').dataset.asset);
    }
  }

  chooseAll() {
    for (const id of this.found) {
      if (this.all.checked) this.chosen.add(id);
      else this.chosen.delete(id);
    }
    this.showChosen();
  }

  row(row) {
    const { id, name, group, template, origin, state, why } = row;
    const followed = state !== 'not running';
    const own = origin === 'provisioned';
    return h('tr', { 'data-asset': id },
      h('td', { class: 'tick' }, own && this.tick(row)),
      h('td', {}, h('b', {}, followed ? h('a', { href: assetHash('operator', id) }, name) : name),
        name !== id && h('span', { class: 'id mut' }, id)),
      cell('Group', group || '–'), cell('Template', template === null ? 'see file' : template || 'none'),
      cell('Configured in', origin === 'file' ? 'configuration file' : 'provisioned'),
      cell('State', h('span', { class: followed ? '' : 'chip dash' }, state),
        why && h('span', { class: 'why' }, why)),
      h('td', { class: 'ac' }, own && [
        this.rowButton(`Edit ${name}`, 'Edit…', () => this.edit(id)),
        this.rowButton(`Remove ${name}`, 'Remove…', () => this.remove([id])),
      ]));
  }

  tick({ id, name }) {
    const tick = h('input', { type: 'checkbox', 'aria-label': `Select ${name}`, onchange: () => {
      if (tick.checked) this.chosen.add(id);
      else this.chosen.delete(id);
      this.showChosen();
    } });
    tick.checked = this.chosen.has(id);
    refuse(tick, this.page.refusal('admin'));
    return tick;
  }

  rowButton(label, text, act) {
    const button = h('button', { class: 'btn sm', type: 'button', 'aria-label': label,
      onclick: act }, text);
    refuse(button, this.page.refusal('admin'));
    return button;
  }

  /** The form is filled with what the service has now, not with what the list says. */
  async edit(id) {
    try {
      await this.first;
      const asset = await loadConfiguration(id);
      if (!this.ended) this.open(this.form, this.known.templates, asset);
    } catch (error) {
      this.page.notify(`Not opened: ${error.message}.`);
    }
  }

  async remove(ids) {
    const { value } = await openDialog(removalQuestion(ids, this.names));
    if (value !== 'ok') return;
    try {
      await removeAssets(ids);
      this.opener = this.add; // the rows and their buttons are gone
      this.chosen.clear();
      await this.done(ids.length === 1 ? `Asset ${ids[0]} removed. Its history is kept.`
        : `${ids.length} assets removed. Their history is kept.`);
    } catch (error) {
      this.page.notify(`Not removed: ${error.message}.`);
    }
  }
}

function removalQuestion(ids, names) {
  const [one, its] = ids.length === 1 ? [true, 'Its'] : [false, 'Their'];
  const labels = ids.map((id) => (names.get(id) === id ? id : `${names.get(id)} (${id})`));
  const rest = ids.length - MOST_NAMED;
  return {
    title: one ? `Remove the asset ${labels[0]}?` : `Remove ${ids.length} assets?`,
    body: [
      !one && h('ul', {}, labels.slice(0, MOST_NAMED).map((label) => h('li', {}, label)),
        rest > 0 && h('li', {}, `and ${rest} more`)),
      h('p', {}, `${its} ${one ? 'twin stops and its alarms end' : 'twins stop and their alarms end'}. `
        + `${its} measurements, models and alarm journal stay in the database. An asset that is added `
        + 'later with the same id continues with them.'),
    ],
    buttons: [h('button', { class: 'btn', value: '' }, 'Cancel'),
      h('button', { class: 'btn pri', value: 'ok' }, one ? 'Remove asset' : `Remove ${ids.length} assets`)],
  };
}

/** A cell with its heading, which the narrow page shows beside the value. */
const cell = (label, ...parts) => h('td', {}, h('span', { class: 'lb' }, `${label}: `), parts);

function importedText({ created, changed, rejected, not_running: waiting }) {
  const parts = [`${plural(created, 'asset')} added`, `${changed} changed`];
  if (rejected.length) parts.push(plural(rejected.length, 'row not imported', 'rows not imported'));
  const lines = Object.entries(waiting).map(([id, why]) => `${id} does not run: ${why}.`);
  return [`${parts.join(', ')}.`, ...lines.slice(0, 3),
    lines.length > 3 ? `${lines.length - 3} more do not run.` : ''].filter(Boolean).join(' ');
}
