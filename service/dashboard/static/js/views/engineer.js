// Engineer: windows -> identification -> versions; what to measure next.
import { AdvicePanel } from '../advice.js';
import { assetPath, call, callPages } from '../api.js';
import { ConvergenceChart } from '../convergence.js';
import { askReason } from '../dialogs.js';
import { h, put, setText } from '../dom.js';
import { dayTime, milliseconds, spanText, timeElement } from '../format.js';
import { currentJob, jobText } from '../frame.js';
import { gateList, parameterTable, scoreTable, statusChip } from '../models.js';
import { drawWindows, isUsed, pointText } from '../windows.js';

const REFRESH_MS = 20000;
const WINDOWS_LISTED = 6;

const key = (look, text) => h('span', { class: 'key' }, h('i', { class: look }), text);

export class EngineerView {
  constructor(box, page) {
    this.page = page;
    this.windows = [];
    this.models = [];
    this.chosen = null;
    this.lastJob = null;
    put(box, h('h1', { class: 'vh' }, 'Engineer'), this.createWindows(), this.createJob(),
      this.createVersions(), new AdvicePanel(page).element);
    this.chart = new ConvergenceChart(this.plot);
    this.endings = [
      page.store.on(['jobs', 'link'], () => this.showJob(), 250),
      page.store.on(['asset'], () => this.noticeModel(), 500),
    ];
    this.timer = setInterval(() => this.load(), REFRESH_MS);
    this.load();
  }

  destroy() {
    clearInterval(this.timer);
    this.endings.forEach((end) => end());
    this.chart.destroy();
  }

  path(rest) {
    return assetPath(this.page.live.assetId, rest);
  }

  /** Windows, jobs and versions as the service has them now. */
  async load() {
    try {
      const [windows, models, jobs] = await Promise.all([
        callPages(this.path('/windows'), {}), callPages(this.path('/models'), {}),
        callPages(this.path('/identifications'), {}),
      ]);
      this.windows = windows;
      this.models = models.sort((a, b) => b.version - a.version);
      this.lastJob = jobs[0] ?? null;
      setText(this.problem, '');
    } catch (error) {
      setText(this.problem, `Cannot be shown now: ${error.message}.`);
      return;
    }
    this.showWindows();
    this.showVersions();
    this.showJob();
  }

  noticeModel() {
    const version = this.page.store.get('asset')?.active_model?.version;
    const known = this.models.find((model) => model.status === 'active')?.version;
    if (known !== undefined && version !== known) this.load();
  }

  // ---------------------------------------------------------------- windows
  createWindows() {
    this.windowText = h('span', { class: 's mut' });
    this.windowPlot = h('div', { class: 'wtl' });
    this.windowTable = h('div', { class: 'wt' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    return h('section', { class: 'panel e-win' },
      h('header', {}, h('h2', {}, 'Low-risk windows'), this.windowText,
        h('span', { class: 'keys' }, key('box chosen', 'in the active model'),
          key('box', 'not yet used'))),
      this.windowPlot, this.windowTable, this.problem);
  }

  showWindows() {
    const { low_risk: region } = this.page.store.get('asset') ?? {};
    setText(this.windowText, region ? `up to ${region.speed_rpm_max} rpm and `
      + `${region.load_n_max} N; nothing beyond is ever learned from` : '');
    const active = this.models.find((model) => model.status === 'active');
    const used = active?.windows ?? [];
    drawWindows(this.windowPlot, this.windows, used, this.page.clock.now() ?? Date.now());
    const latest = [...this.windows].sort((a, b) => milliseconds(b.start) - milliseconds(a.start));
    put(this.windowTable, latest.length > 0 && h('table', {},
      h('thead', {}, h('tr', {}, ['From', 'Length', 'Operating points', 'Score', '']
        .map((text) => h('th', {}, text)))),
      h('tbody', {}, latest.slice(0, WINDOWS_LISTED).map((window) => h('tr', {},
        h('td', { class: 'nw' }, timeElement(milliseconds(window.start),
          dayTime(milliseconds(window.start)))),
        h('td', { class: 'nw' },
          spanText((milliseconds(window.end) - milliseconds(window.start)) / 1000)),
        h('td', {}, window.operating_points.map(pointText).join(' · ')),
        h('td', {}, window.score.toFixed(2)),
        h('td', { class: 'mut' }, isUsed(window, used) ? 'in the active model' : ''))))));
  }

  // ---------------------------------------------------------------- job
  createJob() {
    this.start = h('button', { class: 'btn pri', type: 'button', onclick: () => this.startJob() },
      'Start');
    this.cancel = h('button', { class: 'btn', type: 'button', onclick: () => this.cancelJob() },
      'Cancel');
    this.phase = h('span', { class: 'chip' });
    this.jobText = h('p', { class: 's', role: 'status' });
    this.fill = h('i', {});
    this.plot = h('div', { class: 'plot cv' });
    this.gates = h('div', { class: 'gatebox' });
    return h('section', { class: 'panel e-job' },
      h('header', {}, h('h2', {}, 'Re-identification'), h('span', { class: 'sp' }), this.phase),
      h('div', { class: 'row' }, this.start, this.cancel),
      h('div', { class: 'bar' }, this.fill), this.jobText, this.plot, this.gates);
  }

  showJob() {
    const job = currentJob(this.page.store.get('jobs')) ?? this.lastJob;
    const away = this.page.store.get('link').status !== 'live';
    const runs = job?.status === 'running' || job?.status === 'queued';
    this.start.disabled = runs || away || this.busy;
    this.cancel.disabled = !runs || away || this.busy;
    setText(this.phase, job?.phase ?? job?.status ?? 'none yet');
    this.fill.style.width = `${Math.round((job?.progress ?? 0) * 100)}%`;
    setText(this.jobText, job ? this.describe(job)
      : 'Takes all low-risk windows of the store; runs in the background.');
    if (job) this.chart.update(job.trace ?? [[], []]);
    const ended = job && !runs && this.wasRunning === job.id;
    this.wasRunning = runs ? job.id : null;
    if (ended) this.load();
  }

  describe(job) {
    const ended = milliseconds(job.ended_at);
    return `${jobText(job)}${Number.isFinite(ended) ? `, ${dayTime(ended)}` : ''}`;
  }

  async startJob() {
    await this.change(() => call(this.path('/identifications'), {
      method: 'POST', body: { windows: 'auto' },
      headers: { 'Idempotency-Key': crypto.randomUUID?.() ?? String(Math.random()) },
    }), 'Not started');
  }

  async cancelJob() {
    const job = currentJob(this.page.store.get('jobs')) ?? this.lastJob;
    await this.change(() => call(this.path(`/identifications/${encodeURIComponent(job.id)}`),
      { method: 'DELETE' }), 'Not cancelled');
  }

  /** Do something that the service must confirm, then show what has become of it. */
  async change(action, failure) {
    this.busy = true;
    this.showJob();
    try {
      const answer = await action();
      if (answer?.id) this.page.live.takeJob(answer);
    } catch (error) {
      this.page.notify(`${failure}: ${error.message}.`);
    } finally {
      this.busy = false;
    }
    await this.load();
  }

  // ---------------------------------------------------------------- versions
  createVersions() {
    this.versionTable = h('div', { class: 'vl' });
    this.comparison = h('div', { class: 'vc' });
    return h('section', { class: 'panel e-ver' },
      h('header', {}, h('h2', {}, 'Model versions')), this.versionTable, this.comparison);
  }

  showVersions() {
    const active = this.models.find((model) => model.status === 'active');
    const others = this.models.filter((model) => model !== active);
    if (!others.some((model) => model.version === this.chosen)) {
      this.chosen = others[0]?.version ?? null;
    }
    const other = others.find((model) => model.version === this.chosen);
    put(this.versionTable, h('table', {},
      h('thead', {}, h('tr', {}, ['Version', 'Status', 'Made', 'Why', '']
        .map((text) => h('th', {}, text)))),
      h('tbody', {}, this.models.map((model) => this.versionRow(model)))));
    put(this.comparison, active && parameterTable(active, other),
      active && scoreTable(active, other));
    const judged = other ?? active;
    put(this.gates, judged?.gates && h('h2', {}, `Gates of v${judged.version}`),
      judged?.gates && gateList(judged));
  }

  versionRow(model) {
    const activate = h('button', {
      class: 'btn sm', type: 'button', onclick: () => this.activate(model),
    }, 'Activate…');
    const compare = h('button', {
      class: 'btn sm', type: 'button', 'aria-pressed': String(model.version === this.chosen),
      onclick: () => {
        this.chosen = model.version;
        this.showVersions();
      },
    }, 'Compare');
    const isActive = model.status === 'active';
    const made = milliseconds(model.created_at);
    return h('tr', { class: model.version === this.chosen ? 'chosen' : null },
      h('td', { class: 'b' }, `v${model.version}`), h('td', {}, statusChip(model.status)),
      h('td', { class: 'nw' }, Number.isFinite(made) && timeElement(made, dayTime(made))),
      h('td', {}, model.reason ?? ''),
      h('td', { class: 'r nw' }, !isActive && [compare, ' ', activate]));
  }

  async activate(model) {
    const rejected = model.status === 'rejected';
    const comment = await askReason({
      title: `Activate model v${model.version}?`,
      text: rejected ? `This version was rejected: ${model.reason}. The live twin switches to it `
        + 'all the same and goes on from its present state.'
        : 'The live twin switches to this version and goes on from its present state.',
      action: rejected ? 'Activate against the gates' : 'Activate',
    });
    if (comment === null) return;
    try {
      await call(this.path(`/models/${model.version}/activate`),
        { method: 'POST', body: { comment, force: rejected } });
    } catch (error) {
      this.page.notify(`Not activated: ${error.message}.`);
    }
    await this.load();
  }
}
