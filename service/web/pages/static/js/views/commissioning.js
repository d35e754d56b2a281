// From an empty service to the first live value: one step below the other, each with its check.
import { refuse } from '../alarm_list.js';
import { assetPath, call } from '../api.js';
import {
  assetTable, checkChange, draftOf, isTemperature, labelOf, limitFaults, limitsOf, loadCommissioning, loadVersions,
  missing, placeOf, restoreVersion, saveChange, shortNumber, unitOf,
} from '../commissioning.js';
import { field, options, RegisterPanel, SignalPanel, SourceForm } from '../commissioning_sources.js';
import { openDialog } from '../dialogs.js';
import { h, put, scrollable, setText } from '../dom.js';
import { LimitScales } from '../limit_scales.js';
import { RegionPlane } from '../region_plane.js';
import { assetHash } from '../route.js';

const LOOK_EVERY_MS = 1000;
const STEPS = {
  sources: 'Sources', channels: 'Channels', bearing: 'Bearing', limits: 'Limits and low-risk region',
  check: 'Check', save: 'Save and look',
};
const GOOD = 192;
// Kept when the view is left or its theme changes.
let work = null;

export class CommissioningView {
  constructor(box, page) {
    this.page = page;
    this.marks = {};
    this.bodies = {};
    this.notice = h('p', { class: 'pad', role: 'status' });
    this.problem = h('p', { class: 'problem pad', role: 'alert' });
    this.history = h('div', {});
    const steps = Object.entries(STEPS).map(([key, title], number) => this.step(key, title, number + 1));
    put(box, h('h1', {}, 'Commissioning'), this.notice, this.problem, h('ol', { class: 'steps' }, steps),
      h('section', { class: 'panel' },
        h('header', {}, h('h2', {}, 'Versions of the configuration file')), this.history));
    this.load();
  }

  destroy() {
    this.ended = true;
    clearTimeout(this.looking);
    for (const panel of this.panels?.values() ?? []) panel.stop();
  }

  step(key, title, number) {
    this.marks[key] = h('span', { class: 'mark', role: 'status' });
    this.bodies[key] = h('div', { class: 'stepbody' });
    return h('li', { class: 'panel', 'data-step': key },
      h('header', {}, h('span', { class: 'no' }, number), h('h2', {}, title), h('span', { class: 'sp' }),
        this.marks[key]), this.bodies[key]);
  }

  /** A step is done, with a word about it, or still lacks something. */
  mark(key, done, text) {
    const mark = this.marks[key];
    const look = `${done ? '✓' : '○'} ${text}`;
    setText(mark, look);
    mark.classList.toggle('done', done);
  }

  async load() {
    const refusal = this.page.refusal('admin');
    if (refusal) {
      setText(this.problem, refusal);
      return;
    }
    try {
      this.known = await loadCommissioning();
      if (this.ended) return;
      setText(this.problem, this.known.why_not ? `Nothing can be saved here: ${this.known.why_not}.` : '');
      if (!work || work.file !== this.known.file) {
        work = { file: this.known.file, sources: [], values: {}, draft: draftOf(this.known.assets[0]) };
      }
      this.show();
      await this.showVersions();
    } catch (error) {
      setText(this.problem, `Loading failed: ${error.message}.`);
    }
  }

  show() {
    this.showSources();
    this.showChannels();
    this.showBearing();
    this.showLimits();
    this.showCheck();
    this.showSave();
    this.update();
  }

  /** Sources of the file, and those that are not saved yet. */
  get sources() {
    const added = new Set(work.sources.map(({ name }) => name));
    return [...this.known.sources.filter(({ name }) => !added.has(name)), ...work.sources];
  }

  showSources() {
    const before = this.panels ?? new Map();
    this.panels = new Map();
    const form = new SourceForm((source) => {
      work.sources = [...work.sources.filter(({ name }) => name !== source.name), source];
      this.showSources();
      this.changed();
      this.bodies.sources.querySelector(`[data-source="${CSS.escape(source.name)}"] button`)?.focus();
    });
    const shown = this.sources.map((source) => this.source(source, before.get(source.name)));
    for (const panel of before.values()) if (![...this.panels.values()].includes(panel)) panel.stop();
    put(this.bodies.sources, shown,
      h('details', { open: this.sources.length === 0 }, h('summary', {}, 'Add a source'), form.element));
  }

  /** panel: what shows a source of this name already; it goes on if the source is the same */
  source(source, before) {
    const actions = {
      taken: () => Object.keys(work.draft.channels),
      use: (name, channel, value) => this.use(name, channel, value),
    };
    const Panel = source.driver === 'can' ? SignalPanel : /^modbus/.test(source.driver) ? RegisterPanel : null;
    const same = before && JSON.stringify(before.source) === JSON.stringify(source);
    const panel = same ? before : Panel && new Panel(source, actions);
    if (panel) this.panels.set(source.name, panel);
    const isNew = work.sources.includes(source);
    return h('section', { class: 'source', 'data-source': source.name, 'aria-label': `Source ${source.name}` },
      h('h3', {}, source.name, h('span', { class: 'mut s' },
        ` ${[source.driver, source.interface, source.host ?? source.device, source.port, source.channel]
          .filter(Boolean).join(' ')}${isNew ? ' (not saved yet)' : ''}`)),
      panel?.element,
      isNew && h('button', { class: 'btn sm', type: 'button', 'aria-label': `Drop source ${source.name}`,
        onclick: () => {
          work.sources = work.sources.filter((one) => one !== source);
          this.showSources();
          this.changed();
        } }, 'Drop this source'));
  }

  use(name, channel, value) {
    work.draft.channels[name] = channel;
    work.values[name] = value;
    this.showChannels();
    this.showLimits();
    this.changed();
    setText(this.notice, `${labelOf(name)} comes from ${placeOf(channel)} of ${channel.source}.`);
  }

  showChannels() {
    const { channels } = work.draft;
    const rows = Object.entries(channels).map(([name, channel]) => h('tr', { 'data-channel': name },
      h('td', {}, h('b', {}, labelOf(name))), h('td', {}, channel.source), h('td', {}, placeOf(channel)),
      h('td', {}, work.values[name] == null ? '–' : `${shortNumber(work.values[name])} ${unitOf(name)}`),
      h('td', { class: 'r' }, h('button', { class: 'btn sm', type: 'button', 'aria-label': `Remove ${labelOf(name)}`,
        onclick: () => {
          delete channels[name];
          this.showChannels();
          this.showLimits();
          this.changed();
        } }, 'Remove'))));
    put(this.bodies.channels, rows.length ? scrollable('scroll', 'Channels', h('table', {},
      h('thead', {}, h('tr', {}, ['Channel', 'Source', 'Where', 'Last seen', 'Remove'].map((text) =>
        h('th', { scope: 'col' }, text)))), h('tbody', {}, rows)))
      : h('p', { class: 'mut' }, 'None yet. Show the registers or signals of a source above, and choose values: speed, '
        + 'load, and one temperature at least; better both rings and ambient.'));
  }

  showBearing() {
    const { draft } = work;
    const { assets, bearings } = this.known;
    const which = h('select', { onchange: () => {
      work.draft = draftOf(assets.find(({ id }) => id === which.value));
      work.values = {};
      this.show();
    } }, options([['', 'a new bench'], ...assets.map(({ id }) => [id, `${id} (in the file)`])],
      draft.known ? draft.id : ''));
    const text = (key, extra) => h('input', { value: draft[key], autocomplete: 'off', ...extra,
      oninput: (event) => { draft[key] = event.target.value; this.changed(); } });
    const catalogue = h('select', { onchange: () => {
      draft.catalogue = catalogue.value !== '';
      if (draft.catalogue) draft.bearing = catalogue.value;
      this.showBearing();
      this.changed();
    } }, options([...draft.catalogue && !draft.bearing ? [['?', 'choose …']] : [], ...bearings.map((one) =>
      [one.designation, `${one.designation} (${one.bore_mm} × ${one.outer_mm} × ${one.width_mm} mm)`]),
    ['', 'dimensions of my own']], draft.catalogue ? draft.bearing || '?' : ''));
    const size = (key, label) => field(label, h('input', { type: 'number', step: 'any', min: 0, required: true,
      value: draft.dimensions[key] ?? '', oninput: (event) => {
        draft.dimensions[key] = Number(event.target.value);
        this.changed();
      } }));
    put(this.bodies.bearing, h('div', { class: 'fields' },
      assets.length > 0 && field('Bench', which),
      !draft.known && field('Id of the bench', text('id', { pattern: '[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}' }),
        'Letters, digits, dot, hyphen. It cannot be changed later.'),
      field('Name for people (optional)', text('name', { maxlength: 64 })), field('Bearing', catalogue),
      !draft.catalogue && [size('bore_mm', 'Bore in mm'), size('outer_mm', 'Outside diameter in mm'),
        size('width_mm', 'Width in mm')]));
  }

  showLimits() {
    const { draft, values } = work;
    draft.limits = { ...draft.limits, ...limitsOf(draft) };
    this.plane = new RegionPlane((low) => {
      draft.low = low;
      speed.value = low.speed_rpm_max;
      load.value = low.load_n_max;
      this.changed();
    });
    const edge = (key) => h('input', { type: 'number', min: 1, step: 'any', value: draft.low[key], required: true,
      oninput: (event) => {
        const value = Number(event.target.value);
        if (!(value > 0)) return;
        draft.low = { ...draft.low, [key]: value };
        this.plane.show(draft.low);
        this.changed();
      } });
    const [speed, load] = [edge('speed_rpm_max'), edge('load_n_max')];
    const present = values.speed_rpm == null || values.load_n == null ? null
      : { speed: values.speed_rpm, load: values.load_n };
    this.plane.show(draft.low, present);
    const limited = Object.keys(draft.channels).filter(isTemperature);
    const agreed = h('input', { type: 'checkbox', checked: Boolean(draft.agreed), onchange: () => {
      draft.agreed = agreed.checked;
      this.update();
    } });
    this.scales = new LimitScales((name, limits) => {
      draft.limits[name] = limits;
      this.changed();
    });
    this.scales.show(limited.map((name) => [name, draft.limits[name], values[name]]));
    put(this.bodies.limits, h('p', { class: 's mut' }, 'Inside the region the twin learns from what is measured. '
      + 'Beyond it every step is forecast first. Choose what the bench bears without any doubt.'),
    h('div', { class: 'two' }, this.plane.element, h('div', { class: 'fields' },
      field('Low risk up to this speed in rpm', speed), field('Low risk up to this load in N', load))),
    limited.length ? this.scales.element
      : h('p', { class: 'mut' }, 'Temperature limits appear when a temperature is among the channels.'),
    h('label', { class: 'row agree' }, agreed, 'Region and limits are right for this bench'));
  }

  showCheck() {
    this.checker = h('button', { class: 'btn pri', type: 'button', onclick: () => this.check() }, 'Check everything');
    this.results = h('ul', { class: 'checks', 'aria-live': 'polite' });
    put(this.bodies.check, h('p', { class: 's mut' }, 'Reads every source once, as “bearing-twin check” does. '
      + 'Nothing is saved.'), h('div', { class: 'row' }, this.checker), this.results);
  }

  showSave() {
    const { why_not: whyNot, takes_effect: takes, file } = this.known;
    this.saver = h('button', { class: 'btn pri', type: 'button', onclick: () => this.save() }, 'Save');
    refuse(this.saver, whyNot ?? '');
    this.live = h('div', { 'aria-live': 'polite' });
    put(this.bodies.save, h('p', { class: 's mut' }, `Writes ${file ?? 'the configuration file'}, as a person would; `
      + `comments stay. It takes effect ${takes === 'at once' ? 'at once: the service starts again by itself'
        : 'after a restart of the service'}.`), h('div', { class: 'row' }, this.saver), this.live);
  }

  change() {
    return { revision: this.known.revision, sources: work.sources, assets: [assetTable(work.draft)] };
  }

  /** Something of the draft is other than it was: a check of before says nothing any more. */
  changed() {
    work.checked = false;
    work.saved = false;
    put(this.results);
    put(this.live);
    this.update();
  }

  update() {
    const { draft } = work;
    const names = this.sources.map(({ name }) => name);
    this.mark('sources', names.length > 0, names.length ? names.join(', ') : 'add one');
    const lacks = missing(draft);
    const many = Object.keys(draft.channels).length;
    this.mark('channels', !lacks.length, lacks.length ? `missing: ${lacks.join(', ')}`
      : `${many} channels${'ambient_c' in draft.channels ? '' : '; ambient is assumed'}`);
    const { bore_mm: bore, outer_mm: outer, width_mm: width } = draft.dimensions;
    const own = bore && outer && width && `${bore}x${outer}x${width}`;
    const bearing = (draft.catalogue ? draft.bearing : own) || draft.rest.network;
    this.mark('bearing', Boolean(bearing && draft.id.trim()), bearing
      || (draft.catalogue ? 'choose one' : 'give bore, outside and width'));
    const faults = limitFaults(draft);
    const bounded = !faults.length && !lacks.includes('a temperature') && Boolean(draft.agreed);
    this.mark('limits', bounded, faults[0] ?? `${draft.agreed ? '' : 'look and confirm: '}low risk up to `
      + `${draft.low.speed_rpm_max} rpm and ${draft.low.load_n_max} N`);
    const waits = [lacks.length > 0 && 'channels', !bearing && 'the bearing', !bounded && 'limits']
      .filter(Boolean).join(', ');
    refuse(this.saver, this.known.why_not ?? (waits && `First: ${waits}.`));
    this.mark('check', Boolean(work.checked), work.checked ? 'every source and channel answers' : 'not checked yet');
    this.mark('save', Boolean(work.saved), work.saved ? 'saved' : 'not saved yet');
  }

  async check() {
    this.checker.disabled = true;
    put(this.results, h('li', {}, 'Reading every source once …'));
    try {
      const found = await checkChange(this.change());
      work.checked = found.ok;
      for (const { asset, channel, value } of found.channels) {
        if (asset === work.draft.id) work.values[channel] = value;
      }
      const line = (good, text) => h('li', { class: good ? 'good' : 'wrong' }, `${good ? '✓' : '✕'} ${text}`);
      const shown = found.channels.filter(({ asset }) => asset === work.draft.id);
      put(this.results,
        found.sources.map(({ name, up, detail }) => line(up, `source ${name}: ${up ? 'answers' : detail}`)),
        shown.map(({ channel, value, unit, quality, detail }) => line(quality >= GOOD,
          `${labelOf(channel)}: ${value === null ? detail : `${shortNumber(value)} ${unit}`}`
          + `${value !== null && detail ? ` (${detail})` : ''}`)),
        found.errors.map((text) => line(false, text)),
        found.warnings.map((text) => h('li', {}, `Note: ${text}`)));
      this.showChannels();
    } catch (error) {
      this.fail(this.results, error);
    } finally {
      this.checker.disabled = false;
      this.update();
    }
  }

  /** Why something was refused, all of it. */
  fail(list, error) {
    const lines = error.errors?.length ? error.errors.map(({ detail }) => detail) : [error.message];
    put(list, lines.map((text) => h(list.tagName === 'UL' ? 'li' : 'p', { class: 'wrong' }, `✕ ${text}`)));
  }

  async save() {
    this.saver.disabled = true;
    try {
      const { revision, takes_effect: takes, changed } = await saveChange(this.change());
      this.known.revision = revision;
      work.saved = true;
      put(this.live, h('p', {}, !changed ? 'The file was so already.' : takes === 'at once'
        ? 'Saved. The service starts again with it; the first values come in some seconds …'
        : 'Saved. Restart the service to have it take effect.'));
      this.update();
      if (takes === 'at once') this.lookFor(work.draft.id, Object.keys(work.draft.channels));
    } catch (error) {
      this.fail(this.live, error);
    } finally {
      this.update();
    }
  }

  /** Wait for the first live values of the new bench; the service is away for a moment. */
  async lookFor(id, names) {
    try {
      const { tags } = await call(assetPath(id, '/snapshot'));
      const rows = names.map((name) => [name, tags[name]]);
      const live = rows.filter(([, tag]) => tag?.value != null && tag.quality >= GOOD);
      put(this.live, h('p', { class: live.length === rows.length ? 'good' : '' },
        `${live.length === rows.length ? '✓ Live: ' : ''}${live.length} of ${rows.length} channels are live.`),
      h('ul', { class: 'livevalues' }, rows.map(([name, tag]) => h('li', {}, `${labelOf(name)} `,
        h('b', {}, tag?.value == null ? '–' : `${shortNumber(tag.value)} ${unitOf(name)}`)))),
      h('p', {}, h('a', { class: 'btn', href: assetHash('operator', id) }, 'Open the operator’s page')));
      if (!this.told) {
        this.told = true;
        this.page.connection.stream?.tryNow();
        this.page.connection.guarded(() => this.page.reloadAssets());
        this.refresh();
      }
      if (live.length === rows.length) return;
    } catch {
      // Not there yet.
    }
    if (!this.ended) this.looking = setTimeout(() => this.lookFor(id, names), LOOK_EVERY_MS);
  }

  /** What the file holds now; what is shown of the draft stays. */
  async refresh() {
    this.known = await loadCommissioning();
    work.sources = [];
    this.showSources();
    await this.showVersions();
  }

  async showVersions() {
    const { items } = this.known.why_not ? { items: [] } : await loadVersions();
    if (this.ended) return;
    put(this.history, items.length ? scrollable('scroll', 'Versions', h('table', {},
      h('thead', {}, h('tr', {}, ['No.', 'Saved', 'By', 'What', 'Undo'].map((text) =>
        h('th', { scope: 'col' }, text)))),
      h('tbody', {}, items.map(({ number, saved_at: at, who, what, current }) => h('tr', {},
        h('td', {}, number), h('td', {}, new Date(at).toLocaleString()), h('td', {}, who), h('td', {}, what),
        h('td', {}, current ? 'in the file now' : h('button', { class: 'btn sm', type: 'button',
          'aria-label': `Have version ${number} again`, onclick: () => this.restore(number) }, 'Have it again…')))))))
      : h('p', { class: 'mut' }, 'None yet. Each save is kept here, and can be undone.'));
  }

  async restore(number) {
    const { value } = await openDialog({
      title: `Have version ${number} of the configuration file again?`,
      body: h('p', {}, 'The file is written as it was then, and the service follows it. The present one stays in this '
        + 'list. Measurements are not touched.'),
      buttons: [h('button', { class: 'btn', value: '' }, 'Cancel'),
        h('button', { class: 'btn pri', value: 'ok' }, 'Have it again')],
    });
    if (value !== 'ok') return;
    try {
      await restoreVersion(number, this.known.revision);
      work = null;
      setText(this.notice, `Version ${number} is in the file again.`);
      this.told = false;
      await this.load();
      this.page.connection.guarded(() => this.page.reloadAssets());
    } catch (error) {
      this.page.notify(`Not restored: ${error.message}.`);
    }
  }
}
