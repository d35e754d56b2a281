// All assets: which there are, where they are configured; add, edit, remove and import them.
// view: {"place": 90, "title": "Assets", "from": "engineer", "of": "none"}
import { assetHash } from '../app/route.js';
import { openDialog } from '../parts/dialogs.js';
import {
  button, gap, hasText, Panel, problem, quiet, search, section, table, tick, unless, v,
} from '../parts/panel.js';
import { AssetForm, AssetImport } from './form.js';
import { assetRows, loadConfiguration, loadProvisioning, plural, removeAssets } from './provisioning.js';
import { call } from '../app/api.js';
import { dayTimeSecond, fixed, moment, spanText } from '../parts/format.js';

const MOST_NIGHTS = 3;
const STATES = {
  running: 'running', ended: 'ended', stopped: 'stopped before the end', lost: 'lost: no sign of life',
};

/** loads: differs when it is time to ask again */
class NightsPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    this.items = [];
    this.load();
  }

  componentDidUpdate({ loads }) {
    if (loads !== this.props.loads) this.load();
  }

  /** Ask for the last nights; a site without fleet identification has none, and no panel. */
  async load() {
    const { items } = await call('/fleet/nights', { query: { limit: MOST_NIGHTS } }).catch(() => this);
    this.set({ items });
  }

  render() {
    const [last] = this.items;
    if (!last) return null;
    const looked = last.asked - last.left;
    const running = last.state === 'running';
    return section('p-nights', 'Nightly identification', null,
      v('p', { class: 'pad', role: 'status' }, running
        ? `The nightly run of ${last.night} is running (${last.assets}): ${looked} of ${plural(last.asked, 'asset')}, `
          + `on ${plural(last.workers, 'worker')}.`
        : last.left > 0 && `The nightly run of ${last.night} has ${plural(last.left, 'asset')} left. `
          + 'The next “bearing-twin fleet identify” continues with them.'),
      running && v('progress', { max: 1, value: last.asked ? looked / last.asked : 1,
        'aria-label': 'Progress of the nightly run' }),
      table('Nightly runs', COLUMNS, this.items,
        { look: 'at', attributesOf: ({ night }) => ({ 'data-night': night }) }),
      v('ul', { class: 's problem' }, Object.entries(last.problems).map(([asset, why]) =>
        v('li', {}, `${asset}: ${why}`))));
  }
}

const COLUMNS = [
  ['Run', ({ night, assets, began_at: at }) => [v('b', {}, night),
    v('span', { class: 'id mut' }, assets, ', since ', moment(at, dayTimeSecond))]],
  ...[['State', ({ state, workers_lost: lost }) => `${STATES[state]}${lost ? `, ${plural(lost, 'worker')} lost` : ''}`],
    ['Done', ({ done, asked }) => `${done} of ${asked}`], ['Refused', ({ refused }) => refused],
    ['Failed', ({ failed }) => failed],
    ['Skipped', ({ skipped, without_new_data: old }) => (old ? `${skipped} (${old} without new data)` : skipped)],
    ['Left', ({ left }) => left], ['Processor time', (night) => spanText(night.processor_seconds)],
    ['Per asset', ({ processor_seconds_per_machine: each }) => (each === null ? '–' : `${fixed(each, 2)} s`)],
  ].map((/** @type {any[]} */ [name, cell]) => [name, (night) =>
    [v('span', { class: 'lb' }, `${name}: `), String(cell(night))]]),
];

const REFRESH_MS = 10000;
const MOST_ROWS = 100;
const MOST_NAMED = 10; // of those that are to be removed

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { known: { templates: [], items: [] }, word: '', most: MOST_ROWS, chosen: new Set() });
    this.refused = unless(this.page.refusal('admin'));
    this.every(REFRESH_MS, () => this.load());
    this.assetsChanged = this.draw;
    this.first = this.load();
  }

  async load() {
    await this.tried('Loading failed', async () =>
      this.set({ known: await loadProvisioning(), loads: (this.loads ?? 0) + 1, problem: '' }),
    (problem) => this.set({ problem }));
  }

  /** Show the form or the import; focus comes back to the button that opened it. */
  open(shown) {
    this.opener = document.activeElement;
    this.set({ shown, status: '' });
  }

  close() {
    this.set({ shown: null });
    this.opener?.focus();
  }

  async done(status) {
    this.status = status;
    this.close();
    await this.page.connection.guarded(() => this.page.reloadAssets());
    await this.load();
  }

  render() {
    const { page, chosen, refused } = this;
    const { assets: listed, feeds } = page.connection;
    const rows = assetRows([...listed].map(([id, asset]) => feeds.get(id)?.store.get('asset') ?? asset),
      this.known.items);
    const found = rows.filter((row) => hasText([row.id, row.name, row.group, row.template, row.state], this.word));
    const stored = rows.filter(({ origin }) => origin === 'provisioned').length;
    const own = found.filter(({ origin }) => origin === 'provisioned').map(({ id }) => id);
    this.names = new Map(rows.map(({ id, name }) => [id, name]));
    for (const id of chosen) if (!this.names.has(id)) chosen.delete(id);
    const cancel = () => this.close();
    return [
      v('h1', { class: 'vh' }, 'Assets'),
      this.shown?.form && v(AssetForm, { ...this.shown, cancel, key: this.shown.asset?.id ?? '',
        done: (id, answer, isNew) => this.done(answer.not_running
          ? `Asset ${id} is saved, but it does not run: ${answer.not_running}.`
          : `Asset ${id} ${isNew ? 'added' : 'changed'}.`) }),
      this.shown?.csv && v(AssetImport, { cancel, done: (answer) => this.done(importedText(answer)) }),
      section('p-assets', 'Assets', [quiet(`${plural(rows.length, 'asset')}: ${rows.length - stored} in the `
        + `configuration file, ${stored} provisioned${this.word.trim() ? `; ${found.length} found` : ''}`), gap(),
      v('span', { class: 'row filters' },
        search('Search assets', (word) => this.set({ most: MOST_ROWS, word })),
        chosen.size > 0 && button(`Remove ${chosen.size} selected…`, () => this.remove([...chosen]),
          { class: 'btn' }),
        button('Import CSV…', () => this.open({ csv: true }),
          { class: 'btn', 'aria-expanded': Boolean(this.shown?.csv), ...refused }),
        button('Add asset…', () => this.edit(null), { class: 'btn', ...refused, ref: (add) => { this.add = add; },
          'aria-expanded': Boolean(this.shown?.form && !this.shown.asset) }),
        page.may('admin') && v('a', { class: 'btn', href: '#commissioning' }, 'Commission an asset'))],
      v('p', { class: 'pad', role: 'status' }, this.status), this.problem && problem(this.problem, ' pad'),
      table('All assets', this.columns(own), found.slice(0, this.most), { look: 'at',
        attributesOf: ({ id }) => ({ 'data-asset': id, key: id }),
        empty: rows.length ? 'No asset matches the search.' : ['No asset is configured yet. ',
          page.may('admin') && v('a', { href: '#commissioning' },
            'Commission an asset: from its address to the first live value.')] },
      found.length > this.most && button(`Show ${MOST_ROWS} more`, () => this.set({ most: this.most + MOST_ROWS })))),
      v(NightsPanel, { loads: this.loads }),
    ];
  }

  choose(ids, isChosen) {
    ids.forEach((id) => (isChosen ? this.chosen.add(id) : this.chosen.delete(id)));
    this.draw();
  }

  /** own: ids of those found that can be chosen. */
  columns(own) {
    const { chosen, refused } = this;
    const isAll = own.length > 0 && own.every((id) => chosen.has(id));
    const box = (label, ids, isChosen, isSome) => tick(label, isChosen, (is) => this.choose(ids, is),
      { indeterminate: isSome && !isChosen, ...refused });
    const follows = ({ state }) => state !== 'not running';
    const isOwn = ({ origin }) => origin === 'provisioned';
    // With its heading, which the narrow page shows next to the value.
    const labelled = (title, cell) => [title, (row) => [v('span', { class: 'lb' }, `${title}: `), cell(row)]];
    return [
      [v('th', { class: 'tick' }, box('Select all assets found', own, isAll, own.some((id) => chosen.has(id)))),
      (row) => isOwn(row) && box(`Select ${row.name}`, [row.id], chosen.has(row.id), false), 'tick'],
      ['Asset', (row) => [
        v('b', {}, follows(row) ? v('a', { href: assetHash('operator', row.id) }, row.name) : row.name),
        row.name !== row.id && v('span', { class: 'id mut' }, row.id)]],
      labelled('Group', ({ group }) => group || '–'),
      labelled('Template', ({ template }) => (template === null ? 'see file' : template || 'none')),
      labelled('Configured in', (row) => (isOwn(row) ? 'provisioned' : 'configuration file')),
      labelled('State', (row) => [v('span', { class: follows(row) ? '' : 'chip dash' }, row.state),
        row.why && v('span', { class: 'why' }, row.why)]),
      ['Actions', (row) => isOwn(row) && [
        button('Edit…', () => this.edit(row.id), { 'aria-label': `Edit ${row.name}`, ...refused }),
        button('Remove…', () => this.remove([row.id]), { 'aria-label': `Remove ${row.name}`, ...refused })], 'ac'],
    ];
  }

  /**
   * The form is filled with what the service has now, not with what the list says; it has a field
   * for each hole of a template, and waits until the templates are known.
   */
  async edit(id) {
    await this.tried('Not opened', async () => {
      await this.first;
      const asset = id && await loadConfiguration(id);
      this.open({ form: true, templates: this.known.templates, asset });
    });
  }

  async remove(ids) {
    const { value } = await openDialog(removalQuestion(ids, this.names));
    if (value !== 'ok') return;
    await this.tried('Not removed', async () => {
      await removeAssets(ids);
      this.opener = this.add; // the rows and their buttons are gone
      this.chosen.clear();
      await this.done(ids.length === 1 ? `Asset ${ids[0]} removed. Its history is kept.`
        : `${ids.length} assets removed. Their history is kept.`);
    });
  }
}

function removalQuestion(ids, names) {
  const [one, its] = ids.length === 1 ? [true, 'Its'] : [false, 'Their'];
  const labels = ids.map((id) => (names.get(id) === id ? id : `${names.get(id)} (${id})`));
  const rest = ids.length - MOST_NAMED;
  return {
    title: one ? `Remove the asset ${labels[0]}?` : `Remove ${ids.length} assets?`,
    body: [
      !one && v('ul', {}, labels.slice(0, MOST_NAMED).map((label) => v('li', {}, label)),
        rest > 0 && v('li', {}, `and ${rest} more`)),
      v('p', {}, `${its} ${one ? 'twin stops and its alarms end' : 'twins stop and their alarms end'}. `
        + `${its} measurements, models and alarm journal stay in the database. An asset that is added `
        + 'later with the same id continues with them.'),
    ],
    confirm: one ? 'Remove asset' : `Remove ${ids.length} assets`,
  };
}

function importedText({ created, changed, rejected, not_running: waiting }) {
  const parts = [`${plural(created, 'asset')} added`, `${changed} changed`];
  if (rejected.length) parts.push(plural(rejected.length, 'row not imported', 'rows not imported'));
  const lines = Object.entries(waiting).map(([id, why]) => `${id} does not run: ${why}.`);
  return [`${parts.join(', ')}.`, ...lines.slice(0, 3),
    lines.length > 3 ? `${lines.length - 3} more do not run.` : ''].filter(Boolean).join(' ');
}
