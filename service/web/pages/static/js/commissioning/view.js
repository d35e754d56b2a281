// From an empty service to the first live value: one step below the other, each with its check.
// view: {"place": 100, "title": "Commissioning", "from": "admin", "of": "none", "hidden": true}
import { assetPath, call } from '../app/api.js';
import { assetHash } from '../app/route.js';
import { openDialog } from '../parts/dialogs.js';
import { field, NumberField } from '../parts/number_field.js';
import { button, gap, Panel, problem, section, select, table, tick, unless, v } from '../parts/panel.js';
import {
  assetTable, checkChange, draftOf, isTemperature, isUnsaved, keepDraft, keptDraft, labelOf,
  limitFaults, limitsOf, loadCommissioning, loadVersions, missing, newDraft, placeOf,
  restoreVersion, saveChange, shortNumber, unitOf,
} from './configuration.js';
import { limitScales, RegionPlane } from './limits.js';
import { RegisterPanel, SignalPanel, SourceForm } from './sources.js';

const LOOK_EVERY_MS = 1000;
const GOOD = 192;
// Kept when the view is left or its theme changes, and in this tab when the page is loaded again.
let work = null;

window.addEventListener('beforeunload', (event) => {
  if (isUnsaved(work)) event.preventDefault();
});

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    this.known = null;
    this.versions = [];
    this.load();
  }

  async load() {
    this.problem = this.page.refusal('admin');
    if (this.problem) return;
    await this.tried('Loading failed', async () => {
      const known = await loadCommissioning();
      if (this.ended) return;
      if (!work) this.continueDraft(known);
      if (!work || work.file !== known.file) work = newDraft(known);
      this.set({ known, problem: known.why_not ? `Nothing can be saved here: ${known.why_not}.` : '' });
      await this.loadVersions();
    }, (problem) => this.set({ problem }));
  }

  async loadVersions() {
    if (!this.known.why_not) this.set({ versions: (await loadVersions()).items });
  }

  continueDraft(known) {
    work = keptDraft(known.file);
    if (!work) return;
    this.notice = [`What you had entered before the page was loaded again is here${work.revision === known.revision
      ? '' : ', but the configuration file has changed since: compare before you save'}. It is not saved yet. `,
    button('Discard it', () => {
      work = newDraft(this.known);
      this.set({ notice: '' });
    })];
  }

  get sources() {
    const added = new Set(work.sources.map(({ name }) => name));
    return [...this.known.sources.filter(({ name }) => !added.has(name)), ...work.sources];
  }

  /** Something of the draft is other than it was: a check of before says nothing any more. */
  changed() {
    Object.assign(work, { checked: false, saved: false, touched: true });
    this.set({ results: null, live: null });
  }

  render() {
    if (this.known) {
      work.draft.limits = { ...work.draft.limits, ...limitsOf(work.draft) };
      keepDraft(work);
    }
    const steps = [
      ['sources', 'Sources', 'sourcesStep'], ['channels', 'Channels', 'channelsStep'],
      ['bearing', 'Bearing', 'bearingStep'], ['limits', 'Limits and low-risk region', 'limitsStep'],
      ['check', 'Check', 'checkStep'], ['save', 'Save and look', 'saveStep'],
    ];
    const marks = this.known ? this.marks() : {};
    return [
      v('h1', {}, 'Commissioning'), v('p', { class: 'pad', role: 'status' }, this.notice),
      problem(this.problem, ' pad'),
      v('ol', { class: 'steps' }, steps.map(([key, title, show], number) => {
        const [done, text] = marks[key] ?? [];
        return v('li', { class: 'panel', 'data-step': key },
          v('header', {}, v('span', { class: 'no' }, number + 1), v('h2', {}, title), gap(),
            v('span', { class: `mark${done ? ' done' : ''}`, role: 'status' },
              text && `${done ? '✓' : '○'} ${text}`)),
          v('div', { class: 'stepbody' }, this.known && this[show]()));
      })),
      section('', 'Versions of the configuration file', null, this.known && this.versionList()),
    ];
  }

  marks() {
    const { draft } = work;
    const names = this.sources.map(({ name }) => name);
    const lacks = missing(draft);
    const many = Object.keys(draft.channels).length;
    const { bore_mm: bore, outer_mm: outer, width_mm: width } = draft.dimensions;
    const own = bore && outer && width && `${bore}x${outer}x${width}`;
    const bearing = (draft.catalogue ? draft.bearing : own) || draft.rest.network;
    const [fault] = limitFaults(draft);
    const bounded = !fault && !lacks.includes('a temperature') && Boolean(draft.agreed);
    this.waits = [lacks.length > 0 && 'channels', !bearing && 'the bearing', !bounded && 'limits']
      .filter(Boolean).join(', ');
    return {
      sources: [names.length > 0, names.join(', ') || 'add one'],
      channels: [!lacks.length, lacks.length ? `missing: ${lacks.join(', ')}`
        : `${many} channels${'ambient_c' in draft.channels ? '' : '; ambient is assumed'}`],
      bearing: [bearing && draft.id.trim(), bearing
        || (draft.catalogue ? 'choose one' : 'give bore, outside and width')],
      limits: [bounded, fault ?? `${draft.agreed ? '' : 'look and confirm: '}low risk up to `
        + `${draft.low.speed_rpm_max} rpm and ${draft.low.load_n_max} N`],
      check: [work.checked, work.checked ? 'every source and channel answers' : 'not checked yet'],
      save: [work.saved, work.saved ? 'saved' : 'not saved yet'],
    };
  }

  sourcesStep() {
    const done = (source) => {
      work.sources = [...work.sources.filter(({ name }) => name !== source.name), source];
      this.added = source;
      this.changed();
    };
    const { sources } = this;
    return [sources.map((source) => this.source(source)),
      v('details', { open: !sources.length, key: JSON.stringify(sources) }, v('summary', {}, 'Add a source'),
        v(SourceForm, { done }))];
  }

  source(source) {
    const Values = source.driver === 'can' ? SignalPanel : /^modbus/.test(source.driver) ? RegisterPanel : null;
    const isNew = work.sources.includes(source);
    return v('section', { class: 'source', 'data-source': source.name, 'aria-label': `Source ${source.name}`,
      key: JSON.stringify(source) },
    v('h3', {}, source.name, v('span', { class: 'mut s' },
      ` ${[source.driver, source.interface, source.host ?? source.device, source.port, source.channel]
        .filter(Boolean).join(' ')}${isNew ? ' (not saved yet)' : ''}`)),
    Values && v(Values, { source, added: this.added === source, taken: Object.keys(work.draft.channels),
      use: (name, channel, value) => this.use(name, channel, value) }),
    isNew && button('Remove source', () => {
      work.sources = work.sources.filter((one) => one !== source);
      this.changed();
    }, { 'aria-label': `Remove source: ${source.name}` }));
  }

  use(name, channel, value) {
    work.draft.channels[name] = channel;
    work.values[name] = value;
    this.notice = `${labelOf(name)} comes from ${placeOf(channel)} of ${channel.source}.`;
    this.changed();
  }

  channelsStep() {
    const { channels } = work.draft;
    const names = Object.keys(channels);
    return names.length ? table('Channels', [
      ['Channel', (name) => v('b', {}, labelOf(name))], ['Source', (name) => channels[name].source],
      ['Where', (name) => placeOf(channels[name])],
      ['Last seen', (name) =>
        (work.values[name] == null ? '–' : `${shortNumber(work.values[name])} ${unitOf(name)}`)],
      ['Remove', (name) => button('Remove', () => {
        delete channels[name];
        this.changed();
      }, { 'aria-label': `Remove ${labelOf(name)}` }), 'r']], names,
    { attributesOf: (name) => ({ 'data-channel': name, key: name }) })
      : v('p', { class: 'mut' }, 'None yet. Show the registers or signals of a source above, and choose values: speed, '
        + 'load, and one temperature at least; better both rings and ambient.');
  }

  bearingStep() {
    const { draft } = work;
    const { assets, bearings } = this.known;
    const choose = (asset) => {
      work.draft = draftOf(assets.find(({ id }) => id === asset));
      work.values = {};
      this.draw();
    };
    const text = (key, more) => v('input', { value: draft[key], autocomplete: 'off', ...more,
      oninput: ({ target }) => { draft[key] = target.value; this.changed(); } });
    const chooseBearing = (bearing) => {
      draft.catalogue = bearing !== '';
      if (draft.catalogue) draft.bearing = bearing;
      this.changed();
    };
    const unknown = draft.catalogue && !draft.bearing ? [['?', 'choose …']] : [];
    const catalogue = [...unknown, ...bearings.map((one) =>
      [one.designation, `${one.designation} (${one.bore_mm} × ${one.outer_mm} × ${one.width_mm} mm)`]),
    ['', 'dimensions of my own']];
    const size = (key, label) => field(label, v(NumberField, { least: 0, unit: 'mm', required: true,
      value: draft.dimensions[key],
      oninput: (value) => { draft.dimensions[key] = value || 0; this.changed(); } }));
    return v('div', { class: 'fields' },
      assets.length > 0 && field('Bench', select(null, [['', 'New asset'],
        ...assets.map(({ id }) => [id, `${id} (in the file)`])], draft.known ? draft.id : '', choose)),
      !draft.known && field('Asset id', text('id', { pattern: '[A-Za-z0-9][A-Za-z0-9._\\-]{0,63}' }),
        'Letters, digits, dot, hyphen. It cannot be changed later.'),
      field('Display name (optional)', text('name', { maxlength: 64 })),
      field('Bearing', select(null, catalogue, draft.catalogue ? draft.bearing || '?' : '', chooseBearing)),
      !draft.catalogue && [size('bore_mm', 'Bore in mm'), size('outer_mm', 'Outside diameter in mm'),
        size('width_mm', 'Width in mm')]);
  }

  limitsStep() {
    const { draft, values } = work;
    const edge = (label, key, unit) => field(label, v(NumberField, { least: 1, step: 100, unit, required: true,
      value: draft.low[key], oninput: (value) => {
        draft.low = { ...draft.low, [key]: value ?? NaN };
        this.changed();
      } }));
    const limited = Object.keys(draft.channels).filter(isTemperature);
    return [v('p', { class: 's mut' }, 'Inside the region the twin learns from what is measured. '
      + 'Beyond it every step is forecast first. Enter the largest speed and load that are known to be safe.'),
    v('div', { class: 'two' }, v(RegionPlane, { low: draft.low,
      present: values.speed_rpm == null || values.load_n == null ? null
        : { speed: values.speed_rpm, load: values.load_n },
      onchange: (low) => { draft.low = low; this.changed(); } }),
    v('div', { class: 'fields' }, edge('Low risk up to this speed in rpm', 'speed_rpm_max', 'rpm'),
      edge('Low risk up to this load in N', 'load_n_max', 'N'))),
    limited.length ? limitScales(limited.map((name) => [name, draft.limits[name], values[name]]),
      (name, limits) => { draft.limits[name] = limits; this.changed(); })
      : v('p', { class: 'mut' }, 'Temperature limits appear when a temperature is among the channels.'),
    v('label', { class: 'row agree' }, tick(null, Boolean(draft.agreed), (isAgreed) => {
      draft.agreed = isAgreed;
      work.touched = true;
      this.draw();
    }), 'I confirm region and limits')];
  }

  checkStep() {
    return [v('p', { class: 's mut' }, 'Reads every source once, as “bearing-twin check” does. Nothing is saved.'),
      v('div', { class: 'row' }, button('Check everything', () => this.check(),
        { class: 'btn pri', disabled: this.checking })),
      v('ul', { class: 'checks', 'aria-live': 'polite' }, this.results)];
  }

  saveStep() {
    const { why_not: whyNot, takes_effect: takes, file } = this.known;
    return [v('p', { class: 's mut' }, `Saves to ${file ?? 'the configuration file'}; `
      + `comments stay. It takes effect ${takes === 'at once' ? 'at once: the service restarts automatically'
        : 'after a restart of the service'}.`),
    v('div', { class: 'row' }, button('Save', () => this.save(), { class: 'btn pri',
      ...unless(this.saving ? 'Saving …' : whyNot ?? (this.waits && `First: ${this.waits}.`)) })),
    v('div', { 'aria-live': 'polite' }, this.live)];
  }

  change() {
    return { revision: this.known.revision, sources: work.sources, assets: [assetTable(work.draft)] };
  }

  async check() {
    this.set({ checking: true, results: v('li', {}, 'Reading every source once …') });
    try {
      const found = await checkChange(this.change());
      work.checked = found.ok;
      const channels = found.channels.filter(({ asset }) => asset === work.draft.id);
      for (const { channel, value } of channels) work.values[channel] = value;
      const line = (good, text) => v('li', { class: good ? 'good' : 'wrong' }, `${good ? '✓' : '✕'} ${text}`);
      this.results = [
        found.sources.map(({ name, up, detail }) => line(up, `source ${name}: ${up ? 'answers' : detail}`)),
        channels.map(({ channel, value, unit, quality, detail }) => line(quality >= GOOD,
          `${labelOf(channel)}: ${value === null ? detail : `${shortNumber(value)} ${unit}`}`
          + `${value !== null && detail ? ` (${detail})` : ''}`)),
        found.errors.map((text) => line(false, text)),
        found.warnings.map((text) => v('li', {}, `Note: ${text}`)),
      ];
    } catch (error) {
      this.results = faultsOf(error, 'li');
    } finally {
      this.set({ checking: false });
    }
  }

  async save() {
    this.set({ saving: true });
    try {
      const { revision, takes_effect: takes, changed } = await saveChange(this.change());
      this.known.revision = revision;
      Object.assign(work, { revision, saved: true });
      this.live = v('p', {}, !changed ? 'No change.' : takes === 'at once'
        ? 'Saved. The service starts again with it; the first values come in some seconds …'
        : 'Saved. Restart the service to have it take effect.');
      if (takes === 'at once') this.lookFor(work.draft.id, Object.keys(work.draft.channels));
    } catch (error) {
      this.live = faultsOf(error, 'p');
    } finally {
      this.set({ saving: false });
    }
  }

  /** Wait for the first live values of the new bench; the service is offline for a moment. */
  async lookFor(id, names) {
    try {
      const { tags } = await call(assetPath(id, '/snapshot'));
      const rows = names.map((name) => [name, tags[name]]);
      const live = rows.filter(([, tag]) => tag?.value != null && tag.quality >= GOOD);
      const whole = live.length === rows.length;
      this.set({ live: [v('p', { class: whole ? 'good' : '' },
        `${whole ? '✓ Live: ' : ''}${live.length} of ${rows.length} channels are live.`),
      v('ul', { class: 'livevalues' }, rows.map(([name, tag]) => v('li', {}, `${labelOf(name)} `,
        v('b', {}, tag?.value == null ? '–' : `${shortNumber(tag.value)} ${unitOf(name)}`)))),
      v('p', {}, v('a', { class: 'btn', href: assetHash('operator', id) }, 'Open the operator’s page'))] });
      if (!this.isListed) {
        this.isListed = true;
        this.page.connection.stream?.tryNow();
        this.page.connection.guarded(() => this.page.reloadAssets());
        this.refresh();
      }
      if (whole) return;
    } catch {
      // Not there yet.
    }
    this.after(LOOK_EVERY_MS, () => this.lookFor(id, names));
  }

  async refresh() {
    const known = await loadCommissioning();
    work.sources = [];
    this.set({ known });
    await this.loadVersions();
  }

  versionList() {
    return this.versions.length ? table('Versions', [['No.', ({ number }) => number],
      ['Saved', ({ saved_at: at }) => new Date(at).toLocaleString()], ['By', ({ who }) => who],
      ['What', ({ what }) => what],
      ['Undo', ({ number, current }) => (current ? 'current' : button('Restore…', () => this.restore(number),
        { 'aria-label': `Restore…, version ${number}` }))]], this.versions)
      : v('p', { class: 'mut' }, 'None yet. Each save is kept here, and can be undone.');
  }

  async restore(number) {
    const { value } = await openDialog({
      title: `Restore version ${number} of the configuration file?`,
      body: v('p', {}, 'The file is written as it was then, and the service follows it. The present one stays in this '
        + 'list. Measurements are not touched.'),
      confirm: 'Restore',
    });
    if (value !== 'ok') return;
    await this.tried('Not restored', async () => {
      await restoreVersion(number, this.known.revision);
      work = null;
      keepDraft(work);
      this.isListed = false;
      await this.load();
      this.set({ notice: `Version ${number} is restored.` });
      this.page.connection.guarded(() => this.page.reloadAssets());
    });
  }
}

const faultsOf = (error, tag) => (error.errors?.length ? error.errors.map(({ detail }) => detail) : [error.message])
  .map((text) => v(tag, { class: 'wrong' }, `✕ ${text}`));
