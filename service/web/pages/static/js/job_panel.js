// Re-identification: start, follow, cancel; what became of the jobs before.
import { assetPath, call } from './api.js';
import { ConvergenceChart } from './convergence.js';
import { h, put, scrollable, setText } from './dom.js';
import { counted, dayTime, fixed, milliseconds, significant, spanText, timeElement } from './format.js';
import { icon } from './icons.js';
import { gateList } from './models.js';

const METHODS = {
  'noa+refine': 'NOA, then refinement',
  refine: 'refinement only',
  noa: 'NOA only',
};
const PHASES = {
  search: 'NOA search', refinement: 'refinement', sampling: 'posterior sampling',
  gates: 'gate checks',
};
/** What every version is asked, in the order of the answers. */
const GATES = {
  fit: 'Training fit',
  ranges: 'Parameter ranges',
  residuals: 'Residual whiteness',
  extrapolation: 'Extrapolation hold-out',
  latest: 'Time hold-out',
};
const JOBS_LISTED = 6;
const PATIENCE_MS = 30000; // days of minutes are looked through before a job is queued
const WAIT_WORDS = { queued: 'Queued', running: 'Starting' };

const isUnfinished = (job) => job?.status === 'running' || job?.status === 'queued';

/** Seconds as text: 12 s, 4 min. */
const leftText = (seconds) => (seconds < 100 ? `${Math.max(1, Math.round(seconds))} s`
  : spanText(seconds));

export class JobPanel {
  /** actions: { windows() for the request, problem(), changed() after anything was done }. */
  constructor(page, actions) {
    this.page = page;
    this.actions = actions;
    this.jobs = [];
    this.models = [];
    this.shown = null; // id of the job that is looked at; null: the latest
    this.points = new Map(); // job id -> [[evaluations, fitness], …]
    this.element = this.create();
    this.chart = new ConvergenceChart(this.plot);
    this.ending = page.store.on(['jobs', 'link'], () => this.hear(), 250);
  }

  destroy() {
    this.ending();
    this.chart.destroy();
  }

  create() {
    this.title = h('h2', {}, 'Re-identification');
    this.phase = h('span', { class: 'chip' }, 'loading …');
    this.attempt = h('span', { class: 'chip dash', hidden: true });
    this.method = h('select', { class: 'btn sm', 'aria-label': 'Method' },
      Object.entries(METHODS).map(([value, text]) => h('option', { value }, text)));
    this.seed = h('input', { type: 'number', min: 0, max: 2 ** 32 - 1, step: 1, value: 0,
      required: true, 'aria-label': 'Seed' });
    this.budget = h('input', { type: 'number', min: 100, max: 5e6, step: 1, placeholder: 'auto',
      'aria-label': 'Budget in evaluations' });
    this.method.addEventListener('change', () => {
      this.budget.disabled = this.method.value === 'refine';
    });
    this.start = h('button', { class: 'btn pri', type: 'submit', disabled: true }, 'Start');
    this.cancel = h('button', {
      class: 'btn', type: 'button', disabled: true, onclick: () => this.stop(),
    }, 'Cancel');
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.text = h('p', { class: 's', role: 'status' });
    this.fill = h('i', {});
    this.bar = h('div', { class: 'bar', role: 'progressbar', 'aria-label': 'Progress',
      'aria-valuemin': 0, 'aria-valuemax': 100 }, this.fill);
    this.plot = h('div', { class: 'plot cv' });
    this.caption = h('p', { class: 'xs mut' }, 'Best sum of squared residuals by evaluation');
    this.gates = h('div', { class: 'gatebox' });
    this.history = scrollable('jh', 'Earlier jobs');
    const form = h('form', {
      class: 'jf',
      onsubmit: (event) => {
        event.preventDefault();
        this.begin();
      },
    }, h('div', { class: 'row' }, this.start, this.cancel, this.method,
      h('label', {}, 'seed ', this.seed), h('label', {}, 'budget ', this.budget)));
    return h('section', { class: 'panel e-job' },
      h('header', {}, this.title, h('span', { class: 'sp' }), this.attempt, this.phase), form,
      this.problem, this.bar, this.text, this.caption, this.plot, this.gates, this.history);
  }

  path(rest = '') {
    return assetPath(this.page.live.assetId, `/identifications${rest}`);
  }

  // ---------------------------------------------------------------- messages of the service
  /** All jobs and versions, as the service has them now. */
  async update(jobs, models) {
    this.jobs = jobs;
    this.models = models;
    this.loaded = true;
    await this.fetchPoints(this.current());
    this.show();
  }

  /** News from the stream. */
  hear() {
    let isNew = false;
    let ended = false;
    for (const message of this.page.store.get('jobs').values()) {
      const index = this.jobs.findIndex((one) => one.id === message.id);
      if (index < 0) {
        this.jobs = [message, ...this.jobs];
        isNew = true;
      } else {
        ended ||= isUnfinished(this.jobs[index]) && !isUnfinished(message);
        this.jobs = this.jobs.with(index, { ...this.jobs[index], ...message });
      }
      const points = this.points.get(message.id) ?? [];
      const further = message.evaluations > (points.at(-1)?.[0] ?? 0);
      if (message.best_fitness > 0 && further) {
        this.points.set(message.id, [...points, [message.evaluations, message.best_fitness]]);
      }
    }
    if (isNew) this.shown = null;
    this.show();
    if (ended) this.actions.changed();
  }

  current() {
    return this.jobs.find((job) => job.id === this.shown) ?? this.jobs[0] ?? null;
  }

  /** The progress of a job before this page was opened. */
  async fetchPoints(job) {
    if (!job || this.points.get(job.id)?.whole) return;
    const { convergence, ...known } = await call(this.path(`/${encodeURIComponent(job.id)}`));
    const later = this.points.get(job.id) ?? [];
    const last = convergence.at(-1)?.[0] ?? 0;
    const points = [...convergence, ...later.filter(([count]) => count > last)];
    points.whole = !isUnfinished(job);
    this.points.set(job.id, points);
    this.jobs = this.jobs.map((one) => (one.id === job.id ? { ...one, ...known } : one));
  }

  async look(job) {
    this.shown = job.id;
    try {
      await this.fetchPoints(job);
    } catch (error) {
      this.page.notify(`Loading failed: ${error.message}.`);
    }
    this.show();
  }

  // ---------------------------------------------------------------- doing
  async begin() {
    const { value: budget, disabled } = this.budget;
    const body = {
      windows: this.actions.windows(), method: this.method.value, seed: Number(this.seed.value),
      ...(budget && !disabled ? { budget: Number(budget) } : {}),
    };
    const request = {
      method: 'POST', body, timeoutMs: PATIENCE_MS,
      headers: { 'Idempotency-Key': crypto.randomUUID?.() ?? String(Math.random()) },
    };
    await this.change('Not started', async () => {
      try {
        return await call(this.path(), request);
      } catch (error) {
        if (error.status !== 0) throw error;
        // It is not known whether the request arrived: repeated with its key it is the same job.
        return call(this.path(), request);
      }
    });
  }

  async stop() {
    const job = this.jobs.find(isUnfinished);
    if (!job) return;
    await this.change('Not cancelled', () =>
      call(this.path(`/${encodeURIComponent(job.id)}`), { method: 'DELETE' }));
  }

  /** Do something that the service must confirm, then show what has become of it. */
  async change(failure, action) {
    this.busy = true;
    setText(this.problem, '');
    this.show();
    try {
      const job = await action();
      if (job?.id) this.page.live.takeJob(job);
    } catch (error) {
      setText(this.problem, `${failure}: ${error.message}.`);
    } finally {
      this.busy = false;
    }
    this.hear();
    this.actions.changed();
  }

  // ---------------------------------------------------------------- showing
  show() {
    const job = this.current();
    const running = this.jobs.find(isUnfinished);
    const away = this.page.store.get('link').status !== 'live';
    const why = running ? 'An identification is running.' : this.actions.problem();
    this.start.disabled = Boolean(why) || away || this.busy;
    this.start.title = why;
    this.cancel.disabled = !running || away || this.busy;
    setText(this.title, this.titleFor(job));
    setText(this.phase, job ? this.stateText(job) : this.loaded ? 'none yet' : 'loading …');
    this.phase.className = `chip${job?.status === 'failed' ? ' warn' : ''}`;
    this.attempt.hidden = !(job?.attempts > 1);
    setText(this.attempt, `attempt ${job?.attempts}`);
    this.attempt.title = 'An earlier attempt ended early. This attempt continued from its last '
      + 'checkpoint.';
    const share = Math.round((job?.progress ?? 0) * 100);
    this.fill.style.width = `${share}%`;
    this.bar.setAttribute('aria-valuenow', share);
    put(this.text, job ? this.describe(job) : why || 'Runs in the background.');
    const active = this.models.find((model) => model.status === 'active');
    const made = this.models.find((model) => model.version === job?.model_version);
    const points = this.points.get(job?.id) ?? [];
    this.plot.hidden = !points.length && !isUnfinished(job);
    this.caption.hidden = this.plot.hidden;
    this.chart.update(points, job && {
      fitness: job.active_fitness,
      label: isUnfinished(job) ? `active v${active?.version ?? '?'}` : 'active version at the time',
    });
    this.showGates(job, made);
    this.showHistory();
  }

  titleFor(job) {
    if (job?.model_version) return `Re-identification, became v${job.model_version}`;
    const next = Math.max(0, ...this.models.map((model) => model.version)) + 1;
    return isUnfinished(job) ? `Re-identification, becomes v${next}` : 'Re-identification';
  }

  stateText(job) {
    return (job.status === 'running' && PHASES[job.phase]) || job.status;
  }

  describe(job) {
    const counted = `${job.evaluations} evaluations, best ${significant(job.best_fitness)}`;
    const when = job.evaluations ? `after ${counted}` : 'before the first evaluation';
    if (job.status === 'failed') {
      return [icon(2, 'hollow'), ` Failed ${when}: ${job.error ?? 'no reason given'}.`];
    }
    if (job.status === 'cancelled') return `Cancelled ${when}.`;
    if (job.status === 'succeeded') return `${counted}.`;
    if (!job.evaluations) return `${WAIT_WORDS[job.status]}.`;
    const left = job.seconds_left;
    const rest = job.phase === 'gates' ? ', gate checks running'
      : left ? `, ${leftText(left)} left` : '';
    const all = job.budget && job.phase === 'search' ? ` of ${job.budget}` : '';
    return `${job.evaluations}${all} evaluations, best ${significant(job.best_fitness)}${rest}`;
  }

  showGates(job, made) {
    const look = made ? `v${made.version}` : isUnfinished(job) ? 'pending' : '';
    if (look === this.gatesLook) return;
    this.gatesLook = look;
    if (made?.gates) {
      put(this.gates, h('h3', {}, made.gates.accepted ? `v${made.version} passed all gates`
        : `v${made.version} failed at least one gate`), gateList(made));
    } else if (look === 'pending') {
      put(this.gates, h('ul', { class: 'gates' }, Object.values(GATES).map((text) =>
        h('li', { class: 'mut' }, h('span', {}, '·'), h('span', {}, text)))));
    } else {
      put(this.gates);
    }
  }

  showHistory() {
    const look = JSON.stringify([this.shown, this.jobs.map((job) =>
      [job.id, job.status, job.attempts])]);
    if (look === this.historyLook) return;
    this.historyLook = look;
    const shown = this.current();
    const row = (job) => {
      const ms = milliseconds(job.started_at ?? job.created_at);
      const made = job.model_version ? `v${job.model_version}` : job.status;
      return h('tr', { class: job === shown ? 'chosen' : null },
        h('td', { class: 'nw' }, timeElement(ms, dayTime(ms))),
        h('td', {}, `${job.method}, seed ${fixed(job.seed, 0)}`,
          job.budget ? `, budget ${job.budget}` : ''),
        h('td', { class: 'nw' }, counted(job.windows.length, 'window')),
        h('td', {}, job.requested_by),
        h('td', { class: job.status === 'failed' ? 'b' : null, title: job.error ?? '' }, made,
          job.attempts > 1 && `, attempt ${job.attempts}`),
        h('td', { class: 'r' }, h('button', {
          class: 'btn sm', type: 'button', 'aria-pressed': String(job === shown),
          'aria-label': `Show the job of ${dayTime(ms)}`, onclick: () => this.look(job),
        }, 'Show')));
    };
    const more = this.jobs.length - JOBS_LISTED;
    put(this.history, this.jobs.length > 0 && h('details', { class: 's', open: this.isOpen },
      h('summary', {}, `Jobs: ${this.jobs.length}`),
      h('table', {}, h('tbody', {}, this.jobs.slice(0, JOBS_LISTED).map(row),
        more > 0 && h('tr', {}, h('td', { class: 'mut', colspan: 6 }, `and ${more} older`))))));
    const details = this.history.firstElementChild;
    details?.addEventListener('toggle', () => { this.isOpen = details.open; });
  }
}
