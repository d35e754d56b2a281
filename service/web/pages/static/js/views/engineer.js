// Engineer: windows -> identification -> versions -> drift; what to measure next.
import { AdvicePanel } from '../advice.js';
import { assetPath, callPages } from '../api.js';
import { h, put, setText } from '../dom.js';
import { DriftPanel } from '../drift_panel.js';
import { JobPanel } from '../job_panel.js';
import { OperationMinutes } from '../minutes.js';
import { VersionPanel } from '../version_panel.js';
import { WindowPanel } from '../window_panel.js';

const REFRESH_MS = 20000;

export class EngineerView {
  constructor(box, page) {
    this.page = page;
    this.models = [];
    this.minutes = new OperationMinutes(page.live.assetId);
    const changed = () => this.load();
    this.windows = new WindowPanel(() => this.job.show());
    this.job = new JobPanel(page, {
      windows: () => this.windows.request(), problem: () => this.windows.problem(), changed,
    });
    this.versions = new VersionPanel(page, { changed });
    this.drift = new DriftPanel();
    this.advice = new AdvicePanel(page);
    this.problem = h('p', { class: 'panel problem wholly', role: 'alert', hidden: true });
    put(box, h('h1', { class: 'vh' }, 'Engineer'), this.problem, this.windows.element,
      this.job.element, this.versions.element, this.drift.element, this.advice.element,
      this.versions.journalElement);
    this.endings = [page.store.on(['asset'], () => this.noticeModel(), 500)];
    this.timer = setInterval(() => this.load(), REFRESH_MS);
    this.load();
  }

  destroy() {
    this.gone = true;
    clearInterval(this.timer);
    this.endings.forEach((end) => end());
    [this.windows, this.job, this.versions, this.drift].forEach((panel) => panel.destroy());
  }

  /** Everything as the service has it now; asked again while it is on its way, once more after. */
  async load() {
    if (this.loading) {
      this.again = true;
      return;
    }
    this.loading = true;
    try {
      await this.fetch();
      this.problem.hidden = true;
    } catch (error) {
      setText(this.problem, `Loading failed: ${error.message}.`);
      this.problem.hidden = false;
    } finally {
      this.loading = false;
    }
    if (this.again && !this.gone) {
      this.again = false;
      await this.load();
    }
  }

  /** Every panel is shown as soon as its own answers are there. */
  async fetch() {
    const ask = (rest) => callPages(assetPath(this.page.live.assetId, rest), {});
    const nowMs = this.page.clock.now() ?? Date.now();
    const [windows, jobs, drift, minutes] = [ask('/windows'), ask('/identifications'),
      ask('/drift'), this.minutes.load(nowMs)];
    const [models, journal] = await Promise.all([ask('/models'), ask('/models/activations')]);
    if (this.gone) return;
    this.models = models.sort((a, b) => b.version - a.version);
    const active = models.find((model) => model.status === 'active');
    if (active?.windows.length) this.advice.begin();
    const showWindows = async () => {
      const region = this.page.store.get('asset')?.low_risk;
      this.windows.update({
        windows: await windows, nowMs, minutes: this.minutes, active, region,
      });
    };
    await Promise.all([
      this.versions.update(this.models, journal),
      showWindows().then(() => minutes).then(showWindows),
      jobs.then((found) => this.job.update(found, this.models)),
      drift.then((items) => this.drift.update(items, this.models)),
    ]);
  }

  /** Another user changed the active version. */
  noticeModel() {
    const version = this.page.store.get('asset')?.active_model?.version;
    const known = this.models.find((model) => model.status === 'active')?.version;
    if (known !== undefined && version !== known) this.load();
  }
}
