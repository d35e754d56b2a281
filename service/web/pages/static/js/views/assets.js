// All assets: which there are, where they are configured; add, remove and import them.
import { refuse } from '../alarm_list.js';
import { AssetForm } from '../asset_form.js';
import { AssetImport } from '../asset_import.js';
import { openDialog } from '../dialogs.js';
import { h, put, scrollable, setText } from '../dom.js';
import { assetRows, deleteAsset, loadProvisioning, plural } from '../provisioning.js';
import { assetHash } from '../route.js';

const REFRESH_MS = 10000;
const MOST_ROWS = 100;
const HEAD = ['Asset', 'Group', 'Template', 'Configured in', 'State', 'Actions'];

export class AssetsView {
  constructor(box, page) {
    this.page = page;
    this.known = { templates: [], items: [] };
    this.most = MOST_ROWS;
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
    this.form = new AssetForm(page, {
      done: (id, answer) => this.done(answer.not_running
        ? `Asset ${id} is saved, but it does not run: ${answer.not_running}.` : `Asset ${id} added.`),
      cancel: () => this.close(),
    });
    this.file = new AssetImport({
      done: (answer) => this.done(importedText(answer)), cancel: () => this.close(),
    });
    this.status = h('p', { class: 'pad', role: 'status' });
    this.problem = h('p', { class: 'problem pad', role: 'alert', hidden: true });
    this.body = h('tbody', {});
    this.more = h('button', { class: 'btn sm', type: 'button', hidden: true,
      onclick: () => { this.most += MOST_ROWS; this.show(); } }, `Show ${MOST_ROWS} more`);
    put(box, h('h1', { class: 'vh' }, 'Assets'), this.form.element, this.file.element,
      h('section', { class: 'panel p-assets' },
        h('header', {}, h('h2', {}, 'Assets'), this.count, h('span', { class: 'sp' }),
          h('span', { class: 'row filters' }, this.search, this.importing, this.add)),
        this.status, this.problem,
        scrollable('scroll', 'All assets', h('table', { class: 'at' },
          h('thead', {}, h('tr', {}, HEAD.map((text) => h('th', { scope: 'col' }, text)))),
          this.body), this.more)));
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
    this.opener.setAttribute('aria-expanded', 'true');
  }

  /** Close what is open; the button that opened it has the focus again. */
  close(focus = true) {
    this.form.close();
    this.file.close();
    this.opener?.setAttribute('aria-expanded', 'false');
    if (focus) this.opener?.focus();
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
    const stored = rows.filter(({ origin }) => origin === 'provisioned').length;
    setText(this.count, `${plural(rows.length, 'asset')}: ${rows.length - stored} in the configuration `
      + `file, ${stored} provisioned${word ? `; ${found.length} found` : ''}`);
    this.more.hidden = found.length <= this.most;
    const shown = found.slice(0, this.most);
    const look = JSON.stringify(shown);
    if (look === this.look) return;
    this.look = look;
    const at = document.activeElement?.closest('tr')?.dataset.asset;
    put(this.body, shown.map((row) => this.row(row)));
    if (!shown.length) {
      put(this.body, h('tr', {}, h('td', { colspan: HEAD.length, class: 'mut pad' },
        rows.length ? 'No asset matches the search.' : 'No asset is configured yet.')));
    }
    if (at) this.body.querySelector(`[data-asset="${CSS.escape(at)}"] :is(a, button)`)?.focus();
  }

  row(row) {
    const { id, name, group, template, origin, state, why } = row;
    const followed = state !== 'not running';
    return h('tr', { 'data-asset': id },
      h('td', {}, h('b', {}, followed ? h('a', { href: assetHash('operator', id) }, name) : name),
        name !== id && h('span', { class: 'id mut' }, id)),
      cell('Group', group || '–'), cell('Template', template === null ? 'see file' : template || 'none'),
      cell('Configured in', origin === 'file' ? 'configuration file' : 'provisioned'),
      cell('State', h('span', { class: followed ? '' : 'chip dash' }, state),
        why && h('span', { class: 'why' }, why)),
      h('td', { class: 'ac' }, origin === 'provisioned' && this.removeButton(row)));
  }

  removeButton(row) {
    const button = h('button', {
      class: 'btn sm', type: 'button', 'aria-label': `Remove ${row.name}`, onclick: () => this.remove(row),
    }, 'Remove…');
    refuse(button, this.page.refusal('admin'));
    return button;
  }

  async remove({ id, name }) {
    const { value } = await openDialog({
      title: `Remove the asset ${name === id ? id : `${name} (${id})`}?`,
      body: h('p', {}, 'Its twin and its alarms stop. Its measurements, models and alarm journal stay '
        + 'in the database. An asset that is added later with the same id continues with them.'),
      buttons: [h('button', { class: 'btn', value: '' }, 'Cancel'),
        h('button', { class: 'btn pri', value: 'ok' }, 'Remove asset')],
    });
    if (value !== 'ok') return;
    try {
      await deleteAsset(id);
      this.opener = this.add; // the row and its button are gone
      await this.done(`Asset ${id} removed. Its history is kept.`);
    } catch (error) {
      this.page.notify(`Not removed: ${error.message}.`);
    }
  }
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
