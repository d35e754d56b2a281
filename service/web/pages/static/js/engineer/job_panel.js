// Re-identification: start, follow, cancel; what became of the jobs before.
import { assetPath, call } from '../app/api.js';
import { counted, dayTime, fixed, isNumber, milliseconds, moment, significant, spanText } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { NumberField } from '../parts/number_field.js';
import { button, form, gap, Hosted, Panel, plainTable, problem, scrolled, section, select, v } from '../parts/panel.js';
import { gateList } from './model_tables.js';
import { Chart } from '../charts/chart.js';
import { token } from '../parts/dom.js';
import { lineOf, timeAxis, valueAxis } from '../charts/paint.js';

const METHODS = { 'noa+refine': 'NOA, then refinement', refine: 'refinement only', noa: 'NOA only' };
const PHASES = {
  search: 'NOA search', refinement: 'refinement', sampling: 'posterior sampling',
  gates: 'gate checks',
};
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

const leftText = (seconds) => (seconds < 100 ? `${Math.max(1, Math.round(seconds))} s` : spanText(seconds));

/**
 * jobs, models: as the service has them, null while they are asked for; windows: for the request;
 * refusal: why none can start, or ''; changed() is called after anything was done.
 */
export class JobPanel extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { jobs: [], method: 'noa+refine', seed: 0, budget: null,
      shown: null, // id of the job that is looked at; null: the latest
      points: new Map() }); // job id -> [[evaluations, fitness], …]
    this.follow(this.page.store, ['jobs', 'link'], 250, () => this.takeMessages());
  }

  path(rest = '') {
    return assetPath(this.page.live.assetId, `/identifications${rest}`);
  }

  // -- messages of the service
  componentDidUpdate({ jobs }) {
    if (jobs === this.props.jobs) return;
    this.jobs = this.props.jobs;
    this.isLoaded = true;
    this.draw();
    this.fetchPoints(this.current()).then(this.draw, () => {});
  }

  takeMessages() {
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
    this.set(isNew ? { shown: null } : {});
    if (ended) this.props.changed();
  }

  current() {
    return this.jobs.find((job) => job.id === this.shown) ?? this.jobs[0] ?? null;
  }

  async fetchPoints(job) {
    if (!job || this.points.get(job.id)?.whole) return;
    const { convergence, ...known } = await call(this.path(`/${encodeURIComponent(job.id)}`));
    const later = this.points.get(job.id) ?? [];
    const last = convergence.at(-1)?.[0] ?? 0;
    /** @type {any} */
    const points = [...convergence, ...later.filter(([count]) => count > last)];
    points.whole = !isUnfinished(job);
    this.points.set(job.id, points);
    this.jobs = this.jobs.map((one) => (one.id === job.id ? { ...one, ...known } : one));
  }

  async look(job) {
    this.shown = job.id;
    await this.tried('Loading failed', () => this.fetchPoints(job));
    this.draw();
  }

  // -- doing
  async begin() {
    const { method, seed, budget } = this;
    const body = { windows: this.props.windows, method, seed,
      ...(budget === null || method === 'refine' ? {} : { budget }) };
    /** @type {Page.Options} */
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
    this.set({ busy: true, problem: '' });
    const job = await this.tried(failure, action, (text) => { this.problem = text; });
    if (job?.id) this.page.live.takeJob(job);
    this.busy = false;
    this.takeMessages();
    this.props.changed();
  }

  // -- showing
  render({ models }) {
    const job = this.current();
    const running = this.jobs.find(isUnfinished);
    const halted = this.page.store.get('link').status !== 'live' || this.busy;
    const why = running ? 'An identification is running.' : this.props.refusal;
    const share = Math.round((job?.progress ?? 0) * 100);
    const points = this.points.get(job?.id) ?? [];
    const active = models.find((model) => model.status === 'active');
    const reference = job && { fitness: job.active_fitness,
      label: isUnfinished(job) ? `active v${active?.version ?? '?'}` : 'active version at the time' };
    const number = (name, given) => v('label', {}, `${name} `, v(NumberField, { whole: true, value: this[name],
      oninput: (value) => this.set({ [name]: value }), ...given }));
    return section('e-job', titleFor(job, models), [gap(),
      job?.attempts > 1 && v('span', { class: 'chip dash', title: 'An earlier attempt ended early. This attempt '
        + 'continued from its last checkpoint.' }, `attempt ${job.attempts}`),
      v('span', { class: `chip${job?.status === 'failed' ? ' warn' : ''}` },
        job ? (job.status === 'running' && PHASES[job.phase]) || job.status
          : this.isLoaded ? 'none yet' : 'loading …')],
    form({ class: 'jf' }, () => this.begin(), v('div', { class: 'row' },
      v('button', { class: 'btn pri', disabled: Boolean(why) || halted, title: why }, 'Start'),
      button('Cancel', () => this.stop(), { class: 'btn', disabled: !running || halted }),
      select('Method', Object.entries(METHODS), this.method, (method) => this.set({ method }), { class: 'btn sm' }),
      number('seed', { least: 0, most: 2 ** 32 - 1, required: true, 'aria-label': 'Seed' }),
      number('budget', { least: 100, most: 5e6, step: 100, placeholder: 'auto', disabled: this.method === 'refine',
        'aria-label': 'Budget in evaluations' }))),
    problem(this.problem),
    v('div', { class: 'bar', role: 'progressbar', 'aria-label': 'Progress', 'aria-valuemin': 0, 'aria-valuemax': 100,
      'aria-valuenow': share }, v('i', { style: { width: `${share}%` } })),
    v('p', { class: 's', role: 'status' }, job ? describe(job) : why || 'Runs in the background.'),
    (points.length > 0 || isUnfinished(job)) && [
      v('p', { class: 'xs mut' }, 'Best sum of squared residuals by evaluation'),
      v(Hosted, { class: 'plot cv', make: (box) => new ConvergenceChart(box),
        show: (chart) => chart.update(points, reference) })],
    v('div', { class: 'gatebox' }, gates(job, models.find((model) => model.version === job?.model_version))),
    scrolled('Earlier jobs', 'jh', this.history()));
  }

  history() {
    const shown = this.current();
    const more = this.jobs.length - JOBS_LISTED;
    const timeOf = (job) => job.started_at ?? job.created_at;
    const columns = [
      ['', (job) => moment(timeOf(job)), 'nw'],
      ['', (job) => [`${job.method}, seed ${fixed(job.seed, 0)}`, job.budget && `, budget ${job.budget}`]],
      ['', (job) => counted(job.windows.length, 'window'), 'nw'], ['', (job) => job.requested_by],
      ['', (job) => v('td', { class: job.status === 'failed' ? 'b' : null, title: job.error ?? '' },
        job.model_version ? `v${job.model_version}` : job.status, job.attempts > 1 && `, attempt ${job.attempts}`)],
      ['', (job) => button('Show', () => this.look(job), { 'aria-pressed': job === shown,
        'aria-label': `Show the job of ${dayTime(milliseconds(timeOf(job)))}` }), 'r'],
    ];
    return this.jobs.length > 0 && v('details', { class: 's' }, v('summary', {}, `Jobs: ${this.jobs.length}`),
      plainTable(columns, this.jobs.slice(0, JOBS_LISTED), {
        attributesOf: (job) => ({ class: job === shown ? 'chosen' : null, key: job.id }),
        last: more > 0 && v('tr', {}, v('td', { class: 'mut', colspan: 6 }, `and ${more} older`)) }));
  }
}

function titleFor(job, models) {
  if (job?.model_version) return `Re-identification, became v${job.model_version}`;
  const next = Math.max(0, ...models.map((model) => model.version)) + 1;
  return isUnfinished(job) ? `Re-identification, becomes v${next}` : 'Re-identification';
}

function describe(job) {
  const figures = `${job.evaluations} evaluations, best ${significant(job.best_fitness)}`;
  const when = job.evaluations ? `after ${figures}` : 'before the first evaluation';
  if (job.status === 'failed') return [icon(2, 'hollow'), ` Failed ${when}: ${job.error ?? 'no reason given'}.`];
  if (job.status === 'cancelled') return `Cancelled ${when}.`;
  if (job.status === 'succeeded') return `${figures}.`;
  if (!job.evaluations) return `${WAIT_WORDS[job.status]}.`;
  const left = job.seconds_left;
  const rest = job.phase === 'gates' ? ', gate checks running' : left ? `, ${leftText(left)} left` : '';
  const all = job.budget && job.phase === 'search' ? ` of ${job.budget}` : '';
  return `${job.evaluations}${all} evaluations, best ${significant(job.best_fitness)}${rest}`;
}

function gates(job, made) {
  if (made?.gates) {
    return [v('h3', {}, made.gates.accepted ? `v${made.version} passed all gates`
      : `v${made.version} failed at least one gate`), gateList(made)];
  }
  return !made && isUnfinished(job) && v('ul', { class: 'gates' }, Object.values(GATES).map((text) =>
    v('li', { class: 'mut' }, v('span', {}, '·'), v('span', {}, text))));
}

const FEW = 300; // times from the least to the greatest figure

function isRound(value, digits) {
  const mantissa = value / 10 ** Math.floor(Math.log10(value) + 1e-9);
  return digits.includes(Number(mantissa.toFixed(6)));
}

class ConvergenceChart extends Chart {
  update(points, reference) {
    this.reference = isNumber(reference?.fitness) ? reference : null;
    this.isEmpty = !points.length;
    this.show(points.length ? [points.map(([count]) => count), points.map(([, fit]) => fit)] : [[0, 1], [null, null]]);
  }

  options() {
    const thousands = (value) => (value >= 1000 ? `${value / 1000} k` : String(value));
    return {
      scales: {
        x: { time: false, range: (_, low, high) => [0, Math.max(high * 1.05, 100)] },
        y: { distr: 3, range: (_, low, high) => this.range(low, high) },
      },
      axes: [timeAxis(true, { values: (_, splits) => splits.map(thousands), space: 60 }),
        valueAxis({ values: (_, splits) => this.labels(splits), space: 22 })],
      series: [{}, lineOf(token('--twin'), 2.5)], padding: [8, 10, 0, 0],
    };
  }

  /** A little more than the data and the reference need; the lines of the axis begin at its foot. */
  range(low, high) {
    const ends = [low, high, this.reference?.fitness].filter((value) => value > 0);
    if (!ends.length) return [1, 100];
    const foot = Math.min(...ends) / 1.3;
    const power = 10 ** Math.floor(Math.log10(foot));
    return [Math.floor(foot / power) * power, Math.max(...ends) * 1.6];
  }

  /** 1, 2 and 5 where there is room for them, else powers of ten. */
  labels(splits) {
    const known = splits.filter(isNumber);
    const digits = Math.max(...known) / Math.min(...known) < FEW ? [1, 2, 5] : [1];
    return splits.map((value) => (value !== null && isRound(value, digits) ? significant(value) : ''));
  }

  paint(pen) {
    if (this.reference) {
      const y = pen.y(this.reference.fitness);
      pen.across(y, { colour: '--ink-3', width: 1.5, dash: [4, 4] });
      pen.text(this.reference.label, pen.right - 6 * pen.ratio, y - 3 * pen.ratio,
        { colour: '--ink-2', align: 'right' });
    }
    if (this.isEmpty) pen.nothing('No data yet');
  }
}
