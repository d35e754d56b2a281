// Two model versions side by side; which one is active, and how to change that.
import { assetPath, call } from './api.js';
import { askReason } from './dialogs.js';
import { h, put, scrollable, setText } from './dom.js';
import { dayTime, milliseconds, timeElement } from './format.js';
import { icon } from './icons.js';
import {
  combinationList, parameterTable, plainText, scoreTable, sisterList, statusChip, trainingText, windowList,
} from './models.js';

/**
 * The version that a roll-back leads to, null where there is none: the one that was active before
 * the present one was first made active. `journal` is newest first.
 */
export function versionBefore(journal) {
  const way = [];
  for (const { version } of journal.toReversed()) {
    const known = way.indexOf(version);
    if (known >= 0) way.length = known + 1;
    else way.push(version);
  }
  return way.at(-2) ?? null;
}

/** { offered, text }: whether a version may be activated as it is, and why. */
export function offer(model) {
  const v = `v${model.version}`;
  const checks = model.gates?.checks ?? [];
  const failed = checks.filter((check) => !check.passed);
  if (model.status === 'active') return { offered: false, text: `${v} is the active version.` };
  if (model.status === 'rejected') {
    const why = failed.length ? failed.map((check) => check.detail).join('; ') : model.reason;
    return {
      offered: false, kept: true,
      text: `${v} is stored, not offered: ${checks.length - failed.length} of ${checks.length} gates `
        + `passed. ${why}.`,
    };
  }
  if (!checks.length) return { offered: true, text: `${v} contains the priors only, before any data.` };
  const passed = failed.length ? `passed ${checks.length - failed.length} of ${checks.length} gates`
    : 'passed all gates';
  return { offered: true, text: `${v} ${passed}${model.reason ? `; ${model.reason}` : ''}.` };
}

export class VersionPanel {
  /** actions: { changed() after an activation }. */
  constructor(page, actions) {
    this.page = page;
    this.actions = actions;
    this.models = [];
    this.journal = [];
    this.whole = new Map(); // version -> the version with its combinations
    this.left = this.right = null; // chosen by the user, else null
    this.choice = ['compare', 'with'].map((text) =>
      h('select', { class: 'btn sm', 'aria-label': text, onchange: (event) => {
        this[text === 'compare' ? 'left' : 'right'] = Number(event.target.value);
        this.show();
      } }));
    this.tables = h('div', { class: 'vc' }, h('p', { class: 's mut' }, 'loading …'));
    this.verdict = h('p', { class: 's grow' });
    this.back = h('button', { class: 'btn', type: 'button', onclick: () => this.rollBack() });
    this.force = h('button', { class: 'btn', type: 'button', onclick: () => this.activate(true) },
      'Activate despite failed gates…');
    this.take = h('button', { class: 'btn pri', type: 'button', onclick: () => this.activate(false) });
    this.element = h('section', { class: 'panel e-ver' },
      h('header', {}, h('h2', {}, 'Compare model versions'), h('span', { class: 'sp' }),
        h('label', { class: 's mut' }, 'compare ', this.choice[0]),
        h('label', { class: 's mut' }, 'with ', this.choice[1])),
      this.tables, h('div', { class: 'row act' }, this.verdict, this.back, this.force, this.take));
    [this.back, this.force, this.take].forEach((button) => { button.hidden = true; });
    this.journalBox = h('div', {});
    this.journalElement = h('section', { class: 'panel e-jou' },
      h('header', {}, h('h2', {}, 'Versions and activations')), this.journalBox);
    this.ending = page.store.on(['link'], () => this.showActions(), 250);
  }

  destroy() {
    this.ending();
  }

  /** models newest first, journal newest first. */
  async update(models, journal) {
    this.models = models;
    this.journal = journal;
    await this.show();
  }

  of(version) {
    return this.models.find((model) => model.version === version);
  }

  /** The two that are compared: by default the active one and the newest other. */
  pair() {
    const active = this.models.find((model) => model.status === 'active') ?? this.models[0];
    const left = this.of(this.left) ?? active;
    const right = this.of(this.right)
      ?? this.models.find((model) => model !== left) ?? null;
    return [left, right];
  }

  async show() {
    if (!this.models.length) return;
    const [left, right] = this.pair();
    const options = (chosen) => this.models.map((model) => h('option', {
      value: model.version, selected: model === chosen,
    }, `v${model.version}, ${model.status}`));
    put(this.choice[0], options(left));
    put(this.choice[1], options(right));
    this.choice[1].parentElement.hidden = !right;
    this.showActions();
    this.showJournal();
    const both = [left, right === left ? null : right].filter(Boolean);
    const wholes = await Promise.all(both.map((model) => this.combinations(model)));
    // Another choice may have been made meanwhile.
    if (this.pair().some((model, i) => model !== [left, right][i])) return;
    this.showTables(both, wholes);
  }

  async combinations(model) {
    const known = this.whole.get(model.version);
    if (known) return known;
    try {
      const whole = await call(this.path(`/${model.version}`));
      this.whole.set(model.version, whole);
      return whole;
    } catch {
      return model; // the count of combinations is known all the same
    }
  }

  path(rest) {
    return assetPath(this.page.live.assetId, `/models${rest}`);
  }

  showTables(models, wholes) {
    const look = JSON.stringify(models.map((model) => [model.version, model.status]));
    if (look === this.tablesLook) return;
    this.tablesLook = look;
    const open = [...this.tables.querySelectorAll('details')].map((one) => one.open);
    const more = (title, parts, i) => h('details', { class: 's', open: open[i] },
      h('summary', {}, title), h('div', { class: 'two' }, parts));
    put(this.tables, scrollable('wide', 'Parameters', parameterTable(...models)),
      scrollable('wide', 'Scores', scoreTable(models)),
      models.map((model) => h('p', { class: 's mut' }, `v${model.version}, ${trainingText(model)}`)),
      more('Identifiability', wholes.map(combinationList), 0),
      more('Windows used', models.map(windowList), 1),
      models.some((model) => model.sisters) ? more('Sisters', models.map(sisterList), 2) : '');
  }

  showActions() {
    if (!this.models.length) return;
    const [left, right] = this.pair();
    const model = right ?? left;
    const { offered, kept, text } = offer(model);
    const away = this.page.store.get('link').status !== 'live';
    put(this.verdict, kept ? [icon(2, 'hollow'), ' '] : '', plainText(text));
    setText(this.take, `Activate v${model.version}…`);
    this.take.hidden = model.status === 'active';
    this.take.disabled = !offered || away;
    this.take.title = offered ? '' : text;
    this.force.hidden = !kept;
    this.force.disabled = away;
    this.target = versionBefore(this.journal);
    this.back.hidden = this.target === null || !this.of(this.target);
    this.back.disabled = away;
    setText(this.back, `Roll back to v${this.target}…`);
  }

  showJournal() {
    const look = JSON.stringify([this.models.map((model) => [model.version, model.status,
      model.reason]), this.journal.length]);
    if (look === this.journalLook) return;
    this.journalLook = look;
    const time = (text) => {
      const ms = milliseconds(text);
      return h('td', { class: 'nw' }, Number.isFinite(ms) && timeElement(ms, dayTime(ms)));
    };
    const head = (...texts) => h('thead', {}, h('tr', {}, texts.map((text) => h('th', {}, text))));
    put(this.journalBox, h('div', { class: 'two' },
      scrollable('wide', 'Versions', h('table', {}, head('Version', 'Status', 'Created', 'Method', 'Reason'),
        h('tbody', {}, this.models.map((model) => h('tr', {},
          h('td', { class: 'b' }, `v${model.version}`), h('td', {}, statusChip(model.status)),
          time(model.created_at), h('td', { class: 'nw' }, model.method ?? '–'),
          h('td', {}, plainText(model.reason ?? ''))))))),
      scrollable('wide', 'Activations', h('table', {}, head('Activated', 'Version', 'By', 'Reason'),
        h('tbody', {}, this.journal.map((line) => h('tr', {}, time(line.time),
          h('td', { class: 'b' }, `v${line.version}`), h('td', {}, line.who),
          h('td', {}, plainText(line.comment)))))))));
  }

  // ---------------------------------------------------------------- changing the active version
  async activate(force) {
    const [left, right] = this.pair();
    const model = right ?? left;
    const v = `v${model.version}`;
    const comment = await askReason({
      title: force ? `Activate ${v} despite failed gates?` : `Activate model ${v}?`,
      text: force ? `${offer(model).text} The live twin switches to it anyway and continues `
        + 'from its present state.'
        : 'The live twin switches to this version and continues from its present state.',
      action: force ? 'Activate despite failed gates' : 'Activate',
    });
    await this.send(model.version, comment, force, 'Not activated');
  }

  async rollBack() {
    const model = this.of(this.target);
    const made = milliseconds(model.created_at);
    const comment = await askReason({
      title: `Roll back to model v${model.version}?`,
      text: 'The live twin continues from its present state with the parameters of '
        + `${Number.isFinite(made) ? dayTime(made) : `v${model.version}`}.`,
      action: 'Roll back',
    });
    // It was active once: whoever goes back to it knows it.
    await this.send(model.version, comment, model.status === 'rejected', 'Not rolled back');
  }

  async send(version, comment, force, failure) {
    if (comment === null) return;
    try {
      await call(this.path(`/${version}/activate`), { method: 'POST', body: { comment, force } });
      this.left = this.right = null;
    } catch (error) {
      this.page.notify(`${failure}: ${error.message}.`);
    }
    await this.actions.changed();
  }
}
