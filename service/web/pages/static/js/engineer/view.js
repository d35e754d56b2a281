// Engineer: windows -> identification -> versions -> drift; what to measure next.
// view: {"place": 50, "title": "Engineer", "from": "engineer"}
import { assetPath, callPages } from '../app/api.js';
import { Panel, v } from '../parts/panel.js';
import { AdvicePanel } from './advice_panel.js';
import { DriftPanel } from './drift_panel.js';
import { JobPanel } from './job_panel.js';
import { versionJournal, VersionPanel } from './version_panel.js';
import { kept, OperationMinutes, refusalOf, requestOf, WindowPanel } from './windows.js';

const REFRESH_MS = 20000;

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { models: [], journal: [], jobs: [], drift: null, windows: null, byHand: null,
      minutes: new OperationMinutes(this.page.live.assetId) });
    this.follow(this.page.store, ['asset'], 500, () => this.noticeModel());
    this.poll(REFRESH_MS, () => this.load());
  }

  render({ page }) {
    const { models, journal, windows, byHand } = this;
    const active = models.find((model) => model.status === 'active');
    const changed = () => this.load();
    return [
      v('h1', { class: 'vh' }, 'Engineer'),
      this.problem && v('p', { class: 'panel problem wholly', role: 'alert' }, this.problem),
      v(WindowPanel, { windows, byHand, used: active?.windows ?? [], minutes: this.minutes, nowMs: this.nowMs,
        region: page.store.get('asset')?.low_risk, choose: (chosen) => this.set({ byHand: chosen }) }),
      v(JobPanel, { page, models, jobs: this.jobs, changed, windows: requestOf(byHand),
        refusal: refusalOf(windows, byHand) }),
      v(VersionPanel, { page, models, journal, changed }),
      v(DriftPanel, { items: this.drift, models }),
      v(AdvicePanel, { page, isReady: Boolean(active?.windows.length) }),
      versionJournal({ models, journal }),
    ];
  }

  /** Everything as the service has it now; asked again while it is on its way, once more after. */
  async load() {
    if (this.loading) {
      this.again = true;
      return;
    }
    this.loading = true;
    this.set({ problem: '' });
    await this.tried('Loading failed', () => this.fetch(), (problem) => this.set({ problem }));
    this.loading = false;
    if (this.again && !this.ended) {
      this.again = false;
      await this.load();
    }
  }

  /** Every panel is shown as soon as its own answers are there. */
  async fetch() {
    const signal = this.newSignal();
    const ask = (rest) => callPages(assetPath(this.page.live.assetId, rest), {}, undefined, signal);
    this.nowMs = this.page.clock.now() ?? Date.now();
    const versions = Promise.all([ask('/models'), ask('/models/activations')]);
    const take = async (answer, name) => this.set({ [name]: await answer });
    await Promise.all([
      versions.then(([models, journal]) =>
        this.set({ models: models.sort((a, b) => b.version - a.version), journal })),
      ask('/windows').then((windows) => this.set({ windows, byHand: kept(this.byHand, this.windows, windows) })),
      this.minutes.load(this.nowMs).then(this.draw),
      take(ask('/identifications'), 'jobs'), take(ask('/drift'), 'drift'),
    ]);
  }

  noticeModel() {
    const version = this.page.store.get('asset')?.active_model?.version;
    const known = this.models.find((model) => model.status === 'active')?.version;
    if (known !== undefined && version !== known) this.load();
  }
}
