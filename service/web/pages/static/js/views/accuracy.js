// Accuracy: how good the forecasts of this machine were.
import {
  byLead, channelsOf, chosen, inside, leadText, loses, NAIVE, pastPoints, RECORD_DAYS, recordStart,
  together,
} from '../accuracy.js';
import { LeadChart, OutcomeChart, ReliabilityChart } from '../accuracy_charts.js';
import { assetPath, call, callPages } from '../api.js';
import { h, put, scrollable, setText } from '../dom.js';
import {
  channelName, counted, fixed, hourMinute, isNumber, percent,
} from '../format.js';
import { byChannel } from '../past.js';

const REFRESH_MS = 30000;
const HOUR_MS = 3600e3;
const SHOWN_MS = 24 * HOUR_MS;
const LEAST_SHOWN_MS = 2 * HOUR_MS;
const FORECASTS = 200;
const RISKS = [[null, 'All'], ['low', 'Low risk'], ['high', 'High risk']];
const BRIDGE_WALL_MS = 3000;
const KELVIN = [['bias_k', 'Bias'], ['mae_k', 'Mean error'], ['crps_k', 'CRPS'],
  ['interval_score_k', 'Interval score']];

const key = (look, text) => h('span', { class: 'key' }, h('i', { class: look }), text);
const signed = (value) => (isNumber(value) && value > 0 ? `+${fixed(value, 2)}` : fixed(value, 2));

export class AccuracyView {
  constructor(box, page) {
    this.page = page;
    this.items = [];
    this.forecasts = [];
    this.wish = { channel: null, risk: null, version: null, lead: 3600 };
    this.channelChoice = h('span', { class: 'seg', role: 'group', 'aria-label': 'Sensor' });
    this.riskChoice = h('span', { class: 'seg', role: 'group', 'aria-label': 'Risk' });
    this.leadChoice = h('span', { class: 'seg', role: 'group', 'aria-label': 'Lead time' });
    this.versionChoice = h('select', {
      class: 'btn sm', 'aria-label': 'Model version',
      onchange: (event) => this.choose({ version: Number(event.target.value) || null }),
    });
    this.problem = h('p', { class: 'problem', role: 'alert', hidden: true });
    this.answer = h('p', { class: 'verdict' }, 'loading …');
    this.detail = h('p', { class: 's mut' });
    this.boxes = {
      reliability: h('div', { class: 'plot rel', role: 'img', 'aria-label': 'Reliability' }),
      leads: h('div', { class: 'plot', role: 'img', 'aria-label': 'Error by lead time' }),
      outcomes: h('div', { class: 'plot out', role: 'img', 'aria-label': 'Forecasts over what came' }),
    };
    this.outcomeText = h('p', { class: 's mut' });
    this.table = h('div', {});
    put(box, h('h1', { class: 'vh' }, 'Accuracy'),
      h('section', { class: 'panel a-top' },
        h('header', {}, h('h2', {}, `Forecasts of the last ${RECORD_DAYS} days`),
          h('span', { class: 'sp' }), this.channelChoice, this.riskChoice, this.versionChoice),
        this.problem, this.answer, this.detail),
      h('section', { class: 'panel a-out' },
        h('header', {}, h('h2', {}, 'The last forecasts over what came, °C'), this.leadChoice,
          h('span', { class: 'keys' }, key('', 'measured'), key('tw', 'median'),
            key('f50', '50 %'), key('f95', '95 %'), key('box', 'not scored'),
            h('span', { class: 'key' }, h('b', {}, '✕'), 'outside'))),
        this.boxes.outcomes, this.outcomeText),
      h('section', { class: 'panel a-rel' },
        h('header', {}, h('h2', {}, 'Reliability'),
          h('span', { class: 'keys' }, key('tw', 'low risk'), key('tw dash', 'high risk'))),
        this.boxes.reliability,
        h('p', { class: 's mut' }, 'Across: what a quantile states. Up: share of the measurements '
          + 'below it. On the diagonal the bands are right; a curve that is too steep in the '
          + 'middle means bands that are too wide.')),
      h('section', { class: 'panel a-lead' },
        h('header', {}, h('h2', {}, 'Mean error over lead time, K'),
          h('span', { class: 'keys' }, key('tw', 'twin'), key('n-per', 'persistence'),
            key('n-lin', 'linear'), key('n-arx', 'ARX'))),
        this.boxes.leads,
        h('p', { class: 's mut' }, 'Linear and ARX are there from the first identification on.')),
      h('section', { class: 'panel a-tab' },
        h('header', {}, h('h2', {}, 'By lead time')), this.table));
    this.reliability = new ReliabilityChart(this.boxes.reliability);
    this.leads = new LeadChart(this.boxes.leads);
    this.outcomes = new OutcomeChart(this.boxes.outcomes);
    this.load();
    this.timer = setInterval(() => this.load(), REFRESH_MS);
  }

  destroy() {
    this.gone = true;
    clearInterval(this.timer);
    [this.reliability, this.leads, this.outcomes].forEach((chart) => chart.destroy());
  }

  async load() {
    if (this.loading) return;
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
  }

  async fetch() {
    const ask = (rest, query) => call(assetPath(this.page.live.assetId, rest), { query });
    const nowMs = this.page.clock.now() ?? Date.now();
    const [scores, kept] = await Promise.all([
      ask('/forecast-performance', { start: recordStart(nowMs) }),
      ask('/forecasts', { limit: FORECASTS }),
    ]);
    if (this.gone) return;
    Object.assign(this, { items: scores.items, count: scores.forecasts, forecasts: kept.items, nowMs });
    const channels = channelsOf(this.items);
    if (!channels.includes(this.wish.channel)) this.wish.channel = channels[0] ?? null;
    this.show();
    await this.loadMeasured();
  }

  choose(change) {
    const { channel } = this.wish;
    Object.assign(this.wish, change);
    this.show();
    if (change.lead || this.wish.channel !== channel) this.loadMeasured().catch(() => {});
  }

  /** The span of the last chart: a day, less while there is less to show. */
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
    let resolution = '1min';
    const items = await callPages(assetPath(this.page.live.assetId, '/measurements'), {
      channel, start: new Date(span.fromMs).toISOString(), end: new Date(span.toMs).toISOString(),
      resolution,
    }, (page) => { resolution = page.resolution ?? resolution; });
    if (this.gone || channel !== this.wish.channel || lead !== this.wish.lead) return;
    const bridgeMs = BRIDGE_WALL_MS * this.page.clock.rate;
    const line = byChannel(items, resolution, bridgeMs)[channel] ?? { times: [], values: [] };
    this.outcomes.update({ ...span, line });
    this.tellOutcomes(span);
  }

  tellOutcomes({ points }) {
    const { lead, channel } = this.wish;
    const scored = points.filter((point) => point.state === 'scored');
    const within = scored.filter(({ reading: one }) =>
      one.q025 <= one.measured_c && one.measured_c <= one.q975);
    const last = scored.at(-1);
    const text = scored.length ? `${within.length} of the last ${scored.length} readings `
      + `${leadText(lead)} ahead were inside the 95 % band. The last, made at `
      + `${hourMinute(last.madeMs)} for ${hourMinute(last.time)}: ${fixed(last.reading.q50)} °C `
      + `(${fixed(last.reading.q025)} … ${fixed(last.reading.q975)}), measured `
      + `${fixed(last.reading.measured_c)} °C.` : `No reading ${leadText(lead)} ahead is scored yet.`;
    setText(this.outcomeText, text);
    this.boxes.outcomes.setAttribute('aria-label',
      `${channelName(channel)}: forecasts over what was measured. ${text}`);
  }

  show() {
    this.showChoices();
    const wanted = chosen(this.items, this.wish);
    const all = together(wanted);
    this.showAnswer(wanted, all);
    const rows = byLead(wanted);
    this.leads.update(rows);
    this.boxes.leads.setAttribute('aria-label', `Mean absolute error by lead time: ${rows
      .map((row) => `${leadText(row.lead)} ${fixed(row.mae_k, 2)} K`).join(', ') || 'none yet'}.`);
    const of = (risk) => together(chosen(wanted, { risk })).below;
    this.reliability.update({ low: of('low'), high: of('high') });
    this.boxes.reliability.setAttribute('aria-label',
      `Reliability: 50 % bands held ${percent(all.coverage_50)}, 95 % bands ${percent(all.coverage_95)}.`);
    this.showTable(rows);
  }

  showChoices() {
    const { channel, risk, version, lead } = this.wish;
    const buttons = (box, choices, now, change) => {
      const shown = JSON.stringify([choices, now]);
      if (box.dataset.shown === shown) return;
      const focused = [...box.children].indexOf(document.activeElement);
      put(box, choices.map(([value, text]) => h('button', {
        type: 'button', 'aria-pressed': String(value === now), onclick: () => this.choose(change(value)),
      }, text)));
      box.dataset.shown = shown;
      if (focused >= 0) box.children[focused]?.focus();
    };
    buttons(this.channelChoice, channelsOf(this.items).map((name) => [name, channelName(name)]),
      channel, (value) => ({ channel: value }));
    this.channelChoice.hidden = !this.items.length;
    buttons(this.riskChoice, RISKS, risk, (value) => ({ risk: value }));
    const leads = [...new Set(this.items.map((item) => item.lead_time_s))].sort((a, b) => a - b);
    buttons(this.leadChoice, leads.map((one) => [one, leadText(one)]), lead,
      (value) => ({ lead: value }));
    this.leadChoice.hidden = !leads.length;
    const versions = [...new Set(this.items.map((item) => item.model_version))].sort((a, b) => b - a);
    if (this.versionChoice.dataset.shown !== versions.join()) {
      put(this.versionChoice, h('option', { value: '' }, 'All versions'),
        versions.map((one) => h('option', { value: one, selected: one === version }, `Model v${one}`)));
      this.versionChoice.dataset.shown = versions.join();
    }
  }

  showAnswer(wanted, all) {
    if (!all.n) {
      setText(this.answer, all.setAside ? 'No forecast could be scored'
        : 'No forecast is due yet');
    } else {
      setText(this.answer, `${inside(wanted)} of ${all.n} readings inside the 95 % band`);
    }
    const why = [
      all.by.plan && `${all.by.plan} set aside because the machine did not follow the plan`,
      all.by.data && `${all.by.data} without a good measurement`,
      all.by.model && `${all.by.model} of a model version that is gone`,
      all.waiting && `${all.waiting} still ahead`,
    ].filter(Boolean);
    const held = all.n ? [`95 % bands held ${percent(all.coverage_95)}, 50 % bands `
      + `${percent(all.coverage_50)}`] : [];
    const kept = `${counted(this.count ?? 0, 'forecast')} kept`;
    setText(this.detail, `${[...held, ...why, kept].join('; ')}.`);
  }

  showTable(rows) {
    if (!rows.length) {
      put(this.table, h('p', { class: 'mut' }, 'Forecasts are kept at the beginning of each step of '
        + 'the plan and every ten minutes, and scored when their time has come.'));
      return;
    }
    const heading = (text, look = 'r') => h('th', { class: look, scope: 'col' }, text);
    const cell = (text, look = 'r') => h('td', { class: look }, text);
    put(this.table, scrollable('wide', 'Scores by lead time', h('table', {},
      h('thead', {}, h('tr', {}, heading('Lead time', ''), heading('Readings'), heading('Set aside'),
        heading('50 % band'), heading('95 % band'), KELVIN.map(([, text]) => heading(`${text}, K`)),
        Object.values(NAIVE).map((name) => heading(`${name[0].toUpperCase()}${name.slice(1)}, K`)))),
      h('tbody', {}, rows.map((row) => h('tr', {},
        h('th', { scope: 'row' }, leadText(row.lead)), cell(row.n), cell(row.setAside),
        cell(row.n ? percent(row.coverage_50) : '–'), cell(row.n ? percent(row.coverage_95) : '–'),
        KELVIN.map(([name]) => cell(name === 'bias_k' ? signed(row[name]) : fixed(row[name], 2),
          name === 'mae_k' && loses(row) ? 'r lose' : 'r')),
        Object.keys(NAIVE).map((kind) => cell(fixed(row.naive[kind], 2)))))))),
    rows.some(loses) && h('p', { class: 's mut' }, 'Marked: a simple forecast was better.'));
  }
}
