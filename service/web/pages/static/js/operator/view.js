// One screen, three answers, then the evidence.
// view: {"place": 20, "title": "Operator", "from": "viewer", "style": false}
import { AlarmList } from '../alarms/list.js';
import { summary } from '../alarms/alarm.js';
import { BandChoice, chosenBand } from '../forecast/band_choice.js';
import { choice, gap, key, Panel, quiet, section, v } from '../parts/panel.js';
import { FirstData, isWaiting } from './first_data.js';
import { fixed, isNumber, labelText, lowerName, NODE_NAMES } from '../parts/format.js';
import { ForecastCharts } from '../charts/forecast_charts.js';
import { listed } from '../live/verdict.js';
import { NodeTiles } from './nodes.js';
import { channelNames, chartSensors, readChannel } from '../live/readings.js';
import { assetHash } from '../app/route.js';
import { Section } from './section.js';
import { liveDetail, situation } from '../live/situation.js';
import { liveLimitTile, nextStepTile, nowTile } from '../forecast/tiles.js';
import { marginText, marginTitle, priorityFor, safeBelow } from '../forecast/verdict.js';
import { recordFor, recordStart, recordText, riskOf } from '../accuracy/scores.js';
import { assetPath, call } from '../app/api.js';

const REFRESH_MS = 300000;
const RETRY_MS = 20000;

class ForecastRecord extends Panel {
  constructor(attributes) {
    super(attributes);
    this.load();
  }

  render({ asset }) {
    return this.text && v('a', { class: 's record', href: assetHash('accuracy', asset),
      title: 'Readings of all sensors, 5 min to 4 h ahead, where the asset followed the plan. '
        + 'A 95 % band holds 95 of 100.' }, this.text);
  }

  async load() {
    try {
      const nowMs = this.page.clock.now() ?? Date.now();
      const { items } = await call(assetPath(this.page.live.assetId, '/forecast-performance'),
        { query: { start: recordStart(nowMs) } });
      this.set({ text: recordText(items) });
      this.props.loaded?.(items);
    } catch {
      // The page says elsewhere when the service is offline.
    }
    this.after(this.text ? REFRESH_MS : RETRY_MS, () => this.load());
  }
}

const HOUR_MS = 3600e3;
const SPANS = [[HOUR_MS, '1 h'], [3 * HOUR_MS, '3 h'], [12 * HOUR_MS, '12 h']];
const PHONE = 760;
const PHONE_PAST_MS = 1.5 * HOUR_MS;
const BEARING_14 = 'bearing-14';
const NODES = NODE_NAMES.map((_, i) => i + 1);
const NODE_OF_SENSOR = { t_inner_ring_c: 4, t_outer_ring_c: 2 };

export class OperatorView extends Panel {
  constructor(attributes) {
    super(attributes);
    const { store, live, assets } = this.page;
    this.span = live.span;
    this.sensors = chartSensors(store.get('asset'));
    this.isBearing = store.get('asset').network === BEARING_14;
    this.hashAsset = assets.length > 1 ? live.assetId : null;
    this.follow(store, ['tags', 'forecast', 'verdict', 'nodes', 'asset', 'link', 'alarms', 'sources'], 250);
    this.follow(store, ['history', 'loaded'], 500, () => this.drawCharts());
    this.follow(store, ['link'], 0);
    this.every(1000, () => {
      this.draw();
      this.drawCharts();
    });
  }

  componentDidMount() {
    this.drawCharts();
  }

  render() {
    const { page: { store, clock, live, desk } } = this;
    const { asset, alarms, alarmsKnown } = store.state;
    const now = situation(store.state, clock);
    const stale = now && this.isStale(now);
    const blind = now && this.blind(now);
    const detail = liveDetail(store.state, clock);
    const waiting = now && isWaiting(store.state);
    return [
      v('h1', { class: 'vh' }, 'Operator'), v('div', { class: 'answers' }, now && this.tiles(now)),
      waiting && v(FirstData, { state: store.state, clock, assetId: live.assetId }),
      this.trendPanel(now, stale, waiting),
      section(`p-sect${stale ? ' isstale' : ''}`, now && (this.isBearing ? `Bearing ${asset.bearing} cross-section, °C`
        : `Network ${asset.network}, °C`), [gap(), stale && v('span', { class: 'chip badc' },
        blind ? `estimates uncertain: no ${blind}` : 'last known values')],
        v('div', { class: 'sectbox' }, now && (this.isBearing
          ? v(Section, { ...this.bearingNodes(now), stale, open: (node) => this.openNode(node) })
          : v(NodeTiles, { ...this.ownNodes(now), stale, open: (name) => this.openHistory(name) })))),
      section('p-al', 'Alarms', [quiet(now && (now.live && alarmsKnown ? summary(alarms) : 'unknown')), gap(),
        v('a', { class: 'btn sm', href: assetHash('alarms', this.hashAsset) }, 'Journal')],
        v('div', { class: 'alarmbox' }, now && v(AlarmList, { desk, alarms, live: () => detail }))),
    ];
  }

  tiles(now) {
    const band = now.fan?.bands[now.reading?.sensor];
    return [nowTile(now, band ? Math.max(...band.q975) : null),
      nextStepTile(now, this.stepRecord(now)), liveLimitTile(now)];
  }

  /** How forecasts like that of the next step have done. */
  stepRecord({ nowMs, steps, verdict }) {
    const place = Math.min(1, steps.length - 1);
    const channel = verdict.next_step.limit?.channel;
    if (!this.items || place < 0 || !channel) return '';
    return recordFor(this.items, { channel, aheadS: (steps[place].to - nowMs) / 1000,
      risk: riskOf(steps.slice(0, place + 1), this.page.store.get('asset').low_risk) });
  }

  trendPanel(now, stale, hidden) {
    const { asset, forecast } = this.page.store.state;
    const labels = [...((now?.fan && forecast?.labels) || []), isNumber(asset.ambient_assumed_c)
      && `ambient assumed ${fixed(asset.ambient_assumed_c, 0)} °C`].filter(Boolean);
    const margin = now?.fan && forecast?.runaway_margin;
    return v('section', { class: `panel p-trend${stale || (now && now.lostMs !== null) ? ' isstale' : ''}`,
      hidden: Boolean(hidden) },
    v('header', {}, v('h2', {}, 'Temperature, °C'),
      quiet(now && this.modelLine(asset, now)),
      v(ForecastRecord, { page: this.page, asset: this.hashAsset, loaded: (items) => this.set({ items }) }),
      v('span', { class: 'labels' }, labels.map((label) => v('span', { class: 'chip dash' }, labelText(label)))),
      v('span', { class: 's mut margin', title: marginTitle(margin) }, marginText(margin)),
      v('span', { class: 'keys' },
        key('', 'measured'), key('tp', 'twin'), key('tw', 'forecast median'),
        v(BandChoice, { page: this.page, onchange: () => this.drawCharts() }),
        choice('History range', SPANS, this.span, (span) => this.choose(span)))),
    v(ForecastCharts, { page: this.page, now, syncKey: 'operator', ref: (charts) => { this.charts = charts; } }));
  }

  choose(spanMs) {
    this.set({ span: spanMs });
    this.page.live.showPast(spanMs);
    this.drawCharts();
  }

  modelLine(asset, now) {
    const model = asset.active_model;
    if (!model) return 'no model yet';
    const name = `model v${model.version}`;
    if (model.trusted === false) return `${name}, not trusted: no forecast`;
    if (!model.identified) return `${name}, never identified: no forecast`;
    if (now.alone) return `model v${model.version}, open loop (no sensor correction)`;
    if (!this.page.store.get('history')) return `${name}, loading history …`;
    const parts = [name];
    const residual = this.residual(now.nowMs);
    if (isNumber(residual)) parts.push(`model fits (${fixed(residual, 2)} K, last hour)`);
    return parts.join(', ');
  }

  /** Root mean square of twin less measured over the last hour, both rings. */
  residual(nowMs) {
    const { history } = this.page.store.state;
    if (!history) return null;
    const { columns } = history.columns(nowMs - HOUR_MS, nowMs, 0);
    const squares = this.sensors.flatMap((sensor) => {
      const twins = columns[`${sensor}.twin`] ?? []; // of a sensor without data there is none
      return (columns[sensor] ?? []).map((measured, i) =>
        isNumber(measured) && isNumber(twins[i]) ? (measured - twins[i]) ** 2 : null);
    }).filter((square) => square !== null);
    if (squares.length < 10) return null;
    return Math.sqrt(squares.reduce((sum, square) => sum + square, 0) / squares.length);
  }

  blind(now) {
    const missing = this.page.store.get('nodes')?.missing ?? [];
    return now.live && listed(missing.map(lowerName));
  }

  isStale(now) {
    return now.alone || !now.live || Boolean(this.blind(now));
  }

  bearingNodes(now) {
    const { state } = this.page.store;
    const sensors = Object.entries(NODE_OF_SENSOR);
    const ofNode = (node) => state.nodes?.nodes?.[`t_node_${node}_c`];
    const byNode = (one) => Object.fromEntries(NODES.map((node) => [node, one(ofNode(node))]));
    const channels = [...NODES.map((node) => [`t_node_${node}_c`, node]), ['ambient_c', 14], ...sensors];
    const alerts = sensors.map(([sensor, node]) =>
      [node, this.alertOf(now, now.readings.find((one) => one.sensor === sensor))]);
    return {
      nodes: { ...byNode((one) => one?.mean_c ?? null), 14: state.asset.ambient_assumed_c ?? null },
      spreads: byNode((one) => one?.std_c ?? 0), reasons: byNode((one) => one?.reason),
      unknown: NODES.filter((node) => ofNode(node)?.known === false),
      measured: Object.fromEntries(channels.filter(([channel]) => state.tags[channel])
        .map(([channel, node]) => [node, readChannel(state, this.page.clock, channel)])),
      alerts: Object.fromEntries(alerts.filter(([, alert]) => alert)),
    };
  }

  ownNodes(now) {
    const { state } = this.page.store;
    const temperatures = channelNames(state.asset).filter((name) => name.endsWith('_c'));
    const byName = (names, one) => Object.fromEntries(names.map((name) => [name, one(name)]));
    const alerts = now.readings.map((reading) => [reading.sensor, this.alertOf(now, reading)]);
    const estimate = (name) => state.nodes?.nodes?.[name]?.mean_c ?? state.tags[`${name}.twin`]?.goodValue;
    const nodes = Object.keys(state.nodes?.nodes ?? {});
    return {
      nodes: byName([...new Set([...nodes, ...temperatures])], estimate),
      spreads: byName(nodes, (name) => state.nodes.nodes[name].std_c),
      unknown: nodes.filter((name) => state.nodes.nodes[name].known === false),
      reasons: byName(nodes, (name) => state.nodes.nodes[name].reason),
      measured: byName(temperatures, (name) => readChannel(state, this.page.clock, name)),
      alerts: Object.fromEntries(alerts.filter(([, alert]) => alert)),
    };
  }

  openNode(node) {
    const { tags } = this.page.store.state;
    const ring = Object.entries(NODE_OF_SENSOR).find(([, one]) => one === node)?.[0];
    const names = [ring, `t_node_${node}_c`, node === 14 && 'ambient_c'].filter((name) => tags[name]);
    if (names.length) this.openHistory(names[0]);
  }

  /** A measured temperature, and its estimate where one is stored, in the history's trend. */
  openHistory(name) {
    const query = new URLSearchParams([['channel', name], ['channel', `${name}.twin`]]);
    location.hash = `${assetHash('history', this.page.live.assetId)}?${query}`;
  }

  alertOf(now, reading) {
    if (!reading) return null;
    const { limits } = reading;
    if (reading.usable && reading.value >= limits.warning) {
      return { priority: reading.value >= limits.alarm ? 1 : 2, predicted: false };
    }
    const ahead = this.page.store.get('forecast')?.time_to_limit?.[reading.sensor];
    if (!now.fan || !ahead) return null;
    const priority = priorityFor(ahead.warning.probability, ahead.alarm.probability,
      safeBelow(this.page.store.get('asset')));
    return priority ? { priority, predicted: true } : null;
  }

  drawCharts() {
    const { store, clock } = this.page;
    const now = situation(store.state, clock);
    if (!now || document.hidden || !this.sensors.length) return;
    const past = window.innerWidth < PHONE ? Math.min(this.span, PHONE_PAST_MS) : this.span;
    this.charts.show(now, {
      fromMs: now.nowMs - past, endMs: now.endMs ?? now.nowMs + past * 0.15, sensors: this.sensors,
      steps: now.steps, fan: chosenBand(this.page, now.fan), crossings: now.crossings,
    });
  }
}
