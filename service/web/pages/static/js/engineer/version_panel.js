// Two model versions side by side; which one is active, and how to change that.
import { assetPath, call } from '../app/api.js';
import { askReason } from '../parts/dialogs.js';
import { dayTime, milliseconds, moment } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { button, gap, Panel, scrolled, section, select, table, v } from '../parts/panel.js';
import {
  combinationList, lawList, parameterTable, plainText, scoreTable, sisterList, statusChip, trainingText,
  windowList,
} from './model_tables.js';

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

/** models: newest first; journal: of activations, newest first; changed() is called after one. */
export class VersionPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    this.whole = new Map(); // version -> the version with its combinations
    this.left = this.right = null; // chosen by the user, else null
    this.follow(this.page.store, ['link'], 250);
  }

  /** The two that are compared: by default the active one and the newest other. */
  pair() {
    const { models } = this.props;
    const of = (version) => models.find((model) => model.version === version);
    const left = of(this.left) ?? models.find((model) => model.status === 'active') ?? models[0];
    return [left, of(this.right) ?? models.find((model) => model !== left) ?? null];
  }

  path(rest) {
    return assetPath(this.page.live.assetId, `/models${rest}`);
  }

  /** The combinations of those that are compared; the count of them is known all the same. */
  async fetchCombinations(models) {
    for (const { version } of models.filter((model) => !this.whole.has(model.version))) {
      this.whole.set(version, null);
      call(this.path(`/${version}`)).then((whole) => {
        this.whole.set(version, whole);
        this.draw();
      }, () => this.whole.delete(version));
    }
  }

  componentDidUpdate() {
    this.fetchCombinations(this.pair().filter(Boolean));
  }

  render({ models, journal }) {
    if (!models.length) {
      return v('section', { class: 'panel e-ver' }, this.header(), v('p', { class: 's mut' }, 'loading …'));
    }
    const [left, right] = this.pair();
    const shown = right && right !== left ? [left, right] : [left];
    const model = right ?? left;
    const { offered, kept, text } = offer(model);
    const disabled = this.page.store.get('link').status !== 'live';
    const target = models.find(({ version }) => version === versionBefore(journal));
    return v('section', { class: 'panel e-ver' }, this.header(left, right),
      v('div', { class: 'vc' }, this.tables(shown)),
      v('div', { class: 'row act' }, v('p', { class: 's grow' }, kept && [icon(2, 'hollow'), ' '], plainText(text)),
        target && button(`Roll back to v${target.version}…`, () => this.rollBack(target), { class: 'btn', disabled }),
        kept && button('Activate despite failed gates…', () => this.activate(model, true),
          { class: 'btn', disabled }),
        model.status !== 'active' && button(`Activate v${model.version}…`, () => this.activate(model, false),
          { class: 'btn pri', disabled: !offered || disabled, title: offered ? '' : text })));
  }

  header(left, right) {
    const choice = (name, side, chosen) => v('label', { class: 's mut', hidden: !chosen }, `${name} `,
      select(name, this.props.models.map(({ version, status }) => [version, `v${version}, ${status}`]), chosen?.version,
        (version) => this.set({ [side]: Number(version) }), { class: 'btn sm' }));
    return v('header', {}, v('h2', {}, 'Compare model versions'), gap(),
      choice('compare', 'left', left), choice('with', 'right', right));
  }

  tables(models) {
    const more = (title, parts) =>
      v('details', { class: 's' }, v('summary', {}, title), v('div', { class: 'two' }, parts));
    return [
      scrolled('Parameters', 'wide', parameterTable(...models)), scrolled('Scores', 'wide', scoreTable(models)),
      models.map((model) => v('p', { class: 's mut' }, `v${model.version}, ${trainingText(model)}`)),
      more('Identifiability', models.map((model) => combinationList(this.whole.get(model.version) ?? model))),
      more('Windows used', models.map(windowList)),
      more('Laws', models.map(lawList)),
      models.some((model) => model.sisters) && more('Sisters', models.map(sisterList)),
    ];
  }

  // -- changing the active version
  async activate(model, force) {
    const name = `v${model.version}`;
    const comment = await askReason({
      title: force ? `Activate ${name} despite failed gates?` : `Activate model ${name}?`,
      text: force ? `${offer(model).text} The live twin switches to it anyway and continues `
        + 'from its present state.'
        : 'The live twin switches to this version and continues from its present state.',
      action: force ? 'Activate despite failed gates' : 'Activate',
    });
    await this.send(model.version, comment, force, 'Not activated');
  }

  async rollBack(model) {
    const made = milliseconds(model.created_at);
    const comment = await askReason({
      title: `Roll back to model v${model.version}?`,
      text: 'The live twin continues from its present state with the parameters of '
        + `${Number.isFinite(made) ? dayTime(made) : `v${model.version}`}.`,
      action: 'Roll back',
    });
    // It was active once: who goes back to it knows it.
    await this.send(model.version, comment, model.status === 'rejected', 'Not rolled back');
  }

  async send(version, comment, force, failure) {
    if (comment === null) return;
    await this.tried(failure, async () => {
      await call(this.path(`/${version}/activate`), { method: 'POST', body: { comment, force } });
      this.left = this.right = null;
    });
    await this.props.changed();
  }
}

export const versionJournal = ({ models, journal }) => section('e-jou', 'Versions and activations', null,
  models.length > 0 && v('div', { class: 'two' },
    table('Versions', [['Version', ({ version }) => `v${version}`, 'b'], ['Status', ({ status }) => statusChip(status)],
      ['Created', ({ created_at: at }) => moment(at), 'nw'], ['Method', ({ method }) => method ?? '–', 'nw'],
      ['Reason', ({ reason }) => plainText(reason ?? '')]], models, { boxLook: 'wide' }),
    table('Activations', [['Activated', ({ time }) => moment(time), 'nw'],
      ['Version', ({ version }) => `v${version}`, 'b'], ['By', ({ who }) => who],
      ['Reason', ({ comment }) => plainText(comment)]], journal, { boxLook: 'wide' })));
