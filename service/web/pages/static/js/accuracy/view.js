// Accuracy: how good the forecasts of this machine were.
// view: {"place": 70, "title": "Accuracy", "from": "viewer"}
import {
  byLead, channelsOf, chosen, inside, leadText, loses, NAIVE, pastPoints, RECORD_DAYS, recordStart,
  together,
} from './scores.js';
import { LeadChart, OutcomeChart, ReliabilityChart } from './charts.js';
import { assetPath, call } from '../app/api.js';
import { channelName, counted, fixed, hourMinute, isNumber, percent } from '../parts/format.js';
import { EMPTY_LINE, fetchLines } from '../charts/measured.js';
import { choice, gap, Hosted, key, Panel, problem, section, select, table, v } from '../parts/panel.js';

const REFRESH_MS = 30000;
const HOUR_MS = 3600e3;
const SHOWN_MS = 24 * HOUR_MS;
const LEAST_SHOWN_MS = 2 * HOUR_MS;
const FORECASTS = 200;
const RISKS = [[null, 'All'], ['low', 'Low risk'], ['high', 'High risk']];
const BRIDGE_WALL_MS = 3000;
const KELVIN = [['bias_k', 'Bias'], ['mae_k', 'Mean error'], ['crps_k', 'CRPS'],
  ['interval_score_k', 'Interval score']];

const signed = (value) => (isNumber(value) && value > 0 ? `+${fixed(value, 2)}` : fixed(value, 2));

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { items: null, forecasts: [], measured: null,
      wish: { channel: null, risk: null, version: null, lead: 3600 } });
    this.poll(REFRESH_MS, () => this.load());
  }

  async load() {
    if (this.loading) return;
    this.loading = true;
    await this.tried('Loading failed', async () => {
      await this.fetch();
      this.set({ problem: '' });
    }, (problem) => this.set({ problem }));
    this.loading = false;
  }

  async fetch() {
    const ask = (rest, query) => call(assetPath(this.page.live.assetId, rest), { query });
    const nowMs = this.page.clock.now() ?? Date.now();
    const [scores, kept] = await Promise.all([
      ask('/forecast-performance', { start: recordStart(nowMs) }),
      ask('/forecasts', { limit: FORECASTS }),
    ]);
    const channels = channelsOf(scores.items);
    if (!channels.includes(this.wish.channel)) this.wish.channel = channels[0] ?? null;
    this.set({ items: scores.items, count: scores.forecasts, forecasts: kept.items, nowMs });
    await this.loadMeasured();
  }

  choose(change) {
    const { channel } = this.wish;
    this.set({ wish: { ...this.wish, ...change } });
    if (change.lead || this.wish.channel !== channel) this.loadMeasured().catch(() => {});
  }

  span() {
    const { channel, lead } = this.wish;
    const points = pastPoints(this.forecasts, channel, lead, this.nowMs)
      .filter((point) => point.time >= this.nowMs - SHOWN_MS);
    const first = points[0]?.time ?? this.nowMs;
    const fromMs = Math.min(first - 0.1 * HOUR_MS, this.nowMs - LEAST_SHOWN_MS);
    return { points, fromMs, toMs: this.nowMs + 0.1 * HOUR_MS };
  }

  async loadMeasured() {
    const { channel, lead } = this.wish;
    if (!channel) return;
    const span = this.span();
    const { lines: { [channel]: line = EMPTY_LINE } } = await fetchLines(this.page, {
      channel, start: new Date(span.fromMs).toISOString(), end: new Date(span.toMs).toISOString(),
      resolution: '1min',
    }, BRIDGE_WALL_MS);
    if (channel !== this.wish.channel || lead !== this.wish.lead) return;
    this.set({ measured: { ...span, line, text: outcomeText(span.points, lead), channel } });
  }

  render() {
    const { items, wish, measured } = this;
    const wanted = chosen(items ?? [], wish);
    const all = together(wanted);
    const rows = byLead(wanted);
    const of = (risk) => together(chosen(wanted, { risk })).below;
    // A chart is drawn again for other data only.
    const chart = (look, label, make, shown, update) => v(Hosted, { class: `plot ${look}`, role: 'img',
      'aria-label': label, make, show: (made) => {
        if (!items || made.shown === shown) return;
        update(made);
        made.shown = shown;
      } });
    const leads = [...new Set((items ?? []).map((item) => item.lead_time_s))].sort((a, b) => a - b);
    const versions = [...new Set((items ?? []).map((item) => item.model_version))].sort((a, b) => b - a);
    const channels = channelsOf(items ?? []).map((name) => [name, channelName(name)]);
    const wishOf = (label, name, choices) => choices.length > 0
      && choice(label, choices, wish[name], (value) => this.choose({ [name]: value }));
    return [
      v('h1', { class: 'vh' }, 'Accuracy'),
      section('a-top', `Forecasts of the last ${RECORD_DAYS} days`, [gap(), wishOf('Sensor', 'channel', channels),
        wishOf('Risk', 'risk', items ? RISKS : []),
        select('Model version', [['', 'All versions'], ...versions.map((one) => [one, `Model v${one}`])],
          wish.version ?? '', (version) => this.choose({ version: Number(version) || null }), { class: 'btn sm' })],
      this.problem && problem(this.problem),
      v('p', { class: 'verdict' }, !items ? 'loading …' : all.scored
        ? `${inside(wanted)} of ${all.scored} readings inside the 95 % band`
        : all.setAside ? 'No forecast could be evaluated' : 'No forecast is due yet'),
      v('p', { class: 's mut' }, items && detailOf(all, this.count))),
      section('a-out', 'The last forecasts against measured, °C', [
        wishOf('Lead time', 'lead', leads.map((one) => [one, leadText(one)])),
        v('span', { class: 'keys' }, key('', 'measured'), key('tw', 'median'),
          key('f50', '50 %'), key('f95', '95 %'), key('box', 'not evaluated'),
          v('span', { class: 'key' }, v('b', {}, '✕'), 'outside'))],
      chart('out', measured ? `${channelName(measured.channel)}: forecasts against measured. ${measured.text}`
        : 'Forecasts against measured', (box) => new OutcomeChart(box), measured,
      (made) => measured && made.update(measured)),
      v('p', { class: 's mut' }, measured?.text)),
      section('a-rel', 'Reliability', v('span', { class: 'keys' }, key('tw', 'low risk'), key('tw dash', 'high risk')),
        chart('rel', `Reliability: 50 % bands held ${percent(all.coverage_50)}, 95 % bands `
          + `${percent(all.coverage_95)}.`, (box) => new ReliabilityChart(box), JSON.stringify([of('low'), of('high')]),
        (made) => made.update({ low: of('low'), high: of('high') })),
        v('p', { class: 's mut' }, 'Across: what a quantile states. Up: share of the measurements '
          + 'below it. On the diagonal the bands are right; a curve that is too steep in the '
          + 'middle means bands that are too wide.')),
      section('a-lead', 'Mean error over lead time, K', v('span', { class: 'keys' }, key('tw', 'twin'),
        key('n-per', 'persistence'), key('n-lin', 'linear'), key('n-arx', 'ARX')),
      chart('', `Mean absolute error by lead time: ${rows.map((row) =>
        `${leadText(row.lead)} ${fixed(row.mae_k, 2)} K`).join(', ') || 'none yet'}.`, (box) => new LeadChart(box),
      JSON.stringify(rows), (made) => made.update(rows)),
      v('p', { class: 's mut' }, 'Linear and ARX are there from the first identification on.')),
      section('a-tab', 'By lead time', null, items && scoreTableOf(rows)),
    ];
  }
}

function outcomeText(points, lead) {
  const scored = points.filter((point) => point.state === 'scored');
  const within = scored.filter(({ reading: one }) =>
    one.q025 <= one.measured_c && one.measured_c <= one.q975);
  const last = scored.at(-1);
  return scored.length ? `${within.length} of the last ${scored.length} readings `
    + `${leadText(lead)} ahead were inside the 95 % band. The last, made at `
    + `${hourMinute(last.madeMs)} for ${hourMinute(last.time)}: ${fixed(last.reading.q50)} °C `
    + `(${fixed(last.reading.q025)} … ${fixed(last.reading.q975)}), measured `
    + `${fixed(last.reading.measured_c)} °C.` : `No reading ${leadText(lead)} ahead is evaluated yet.`;
}

const detailOf = (all, count) => `${[
  all.scored && `95 % bands held ${percent(all.share)}`, all.n && `50 % bands ${percent(all.coverage_50)}`,
  all.independent && `${all.independent} independent runs`,
  all.runs && `${all.runsInside} of ${all.runs} whole runs inside their 90 % band`,
  all.left && `${all.left} interrupted, ${all.leftInside} of them inside`,
  all.by.plan && `${all.by.plan} whose plan was not followed to the end`,
  all.by.data && `${all.by.data} without a good measurement`,
  all.by.model && `${all.by.model} of a model version that is gone`,
  all.waiting && `${all.waiting} still ahead`, `${counted(count ?? 0, 'forecast')} kept`,
].filter(Boolean).join('; ')}.`;

function scoreTableOf(rows) {
  if (!rows.length) {
    return v('p', { class: 'mut' }, 'Forecasts are kept at the beginning of each step of '
      + 'the plan and every ten minutes, and evaluated when their time has come.');
  }
  const own = (name) => (name === 'bias_k' ? signed : (value) => fixed(value, 2));
  return [table('Scores by lead time', [
    [v('th', { class: '', scope: 'col' }, 'Lead time'), (row) => v('th', { scope: 'row' }, leadText(row.lead))],
    ...[['Readings', (row) => row.scored], ['Of these interrupted', (row) => row.left],
      ['Independent runs', (row) => row.independent], ['Excluded', (row) => row.setAside - row.left],
      ['50 % band', (row) => (row.n ? percent(row.coverage_50) : '–')],
      ['95 % band', (row) => (row.scored ? percent(row.share) : '–')],
      ['Whole runs', (row) => (row.runs ? `${row.runsInside} of ${row.runs}` : '–')],
      ...KELVIN.map(([name, text]) => [`${text}, K`, (row) => v('td', {
        class: name === 'mae_k' && loses(row) ? 'r lose' : 'r' }, own(name)(row[name]))]),
      ...Object.entries(NAIVE).map(([kind, name]) => [`${name[0].toUpperCase()}${name.slice(1)}, K`,
        (row) => fixed(row.naive[kind], 2)])].map((column) => [...column, 'r', 'r']),
  ], rows, { boxLook: 'wide' }),
  rows.some(loses) && v('p', { class: 's mut' }, 'Marked: a simple forecast was better.')];
}
