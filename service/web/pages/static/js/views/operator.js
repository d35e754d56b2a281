// One screen, three answers, then the evidence.
import { AlarmList } from '../alarm_list.js';
import { summary } from '../alarms.js';
import { BandChoice } from '../band_choice.js';
import { h, put, setText } from '../dom.js';
import { FirstData } from '../first_data.js';
import { ForecastRecord } from '../forecast_record.js';
import { channelName, fixed, isNumber, labelText, NODE_NAMES } from '../format.js';
import { LaneChart } from '../lane.js';
import { listed } from '../live_verdict.js';
import { NodeTiles } from '../nodes.js';
import { readChannel } from '../readings.js';
import { assetHash } from '../route.js';
import { marginText, marginTitle } from '../runaway.js';
import { Section } from '../section.js';
import { channelNames, chartSensors } from '../sensors.js';
import { liveDetail, situation } from '../situation.js';
import { liveLimitTile, nextStepTile, nowTile } from '../tiles.js';
import { TrendChart } from '../trend.js';
import { THRESHOLDS } from '../verdict.js';

const HOUR_MS = 3600e3;
const SPANS = [[1, '1 h'], [3, '3 h'], [12, '12 h']];
const BRIDGE_WALL_MS = 1500;
const FLAG_MS = 250; // as often as the header's clock
const PHONE = 760;
const PHONE_PAST_MS = 1.5 * HOUR_MS;
const BEARING_14 = 'bearing-14';
// What is drawn while the past is still on its way.
const NO_PAST = { columns: () => ({ times: [], columns: {} }) };
const NODE_OF_SENSOR = { t_inner_ring_c: 4, t_outer_ring_c: 2 };

const key = (look, text) => h('span', { class: 'key' }, h('i', { class: look }), text);

export class OperatorView {
  /** page: { store, clock, live, desk } */
  constructor(box, page) {
    this.page = page;
    this.span = page.live.span;
    this.sensors = chartSensors(page.store.get('asset'));
    this.answers = h('div', { class: 'answers' });
    this.trendPanel = this.createTrendPanel();
    this.sectionTitle = h('h2', {});
    this.sectionChip = h('span', { class: 'chip badc', hidden: true }, 'last known values');
    const sectionBox = h('div', { class: 'sectbox' });
    this.isBearing = page.store.get('asset').network === BEARING_14;
    this.sectionPanel = h('section', { class: 'panel p-sect' },
      h('header', {}, this.sectionTitle, h('span', { class: 'sp' }), this.sectionChip), sectionBox);
    this.alarmCount = h('span', { class: 's mut' });
    const alarmBox = h('div', { class: 'alarmbox' });
    this.firstData = new FirstData(page);
    put(box, h('h1', { class: 'vh' }, 'Operator'), this.answers, this.firstData.element, this.trendPanel,
      this.sectionPanel, h('section', { class: 'panel p-al' },
        h('header', {}, h('h2', {}, 'Alarms'), this.alarmCount, h('span', { class: 'sp' }),
          h('a', { class: 'btn sm', href: assetHash('alarms', this.hashAsset()) }, 'Journal')),
        alarmBox));
    this.trend = new TrendChart(this.boxes.temperature, 'operator');
    this.speed = new LaneChart(this.boxes.speed, { label: 'Speed, rpm', syncKey: 'operator' });
    this.load = new LaneChart(this.boxes.load,
      { label: 'Load, N', syncKey: 'operator', showTime: true });
    this.section = this.isBearing ? new Section(sectionBox, (node) => this.openNode(node))
      : new NodeTiles(sectionBox, (name) => this.openHistory(name));
    this.alarms = new AlarmList(alarmBox, page.desk);
    const { store } = page;
    this.endings = [
      store.on(['tags', 'forecast', 'verdict', 'nodes', 'asset', 'link', 'alarms', 'sources'],
        () => this.update(), 250),
      store.on(['history', 'loaded'], () => this.draw(), 500),
    ];
    this.flagTimer = setInterval(() => {
      if (page.clock.now() !== null) this.trend.showClock(page.clock.now());
    }, FLAG_MS);
    this.timer = setInterval(() => {
      this.update();
      this.draw();
    }, 1000);
    this.update();
    this.draw();
  }

  hashAsset() {
    return this.page.assets.length > 1 ? this.page.live.assetId : null;
  }

  destroy() {
    clearInterval(this.timer);
    clearInterval(this.flagTimer);
    this.endings.forEach((end) => end());
    this.record.destroy();
    [this.trend, this.speed, this.load].forEach((chart) => chart.destroy());
  }

  createTrendPanel() {
    this.boxes = {
      temperature: h('div', { class: 'plot t', role: 'img', 'aria-label': 'Temperatures' }),
      speed: h('div', { class: 'plot sp1', role: 'img', 'aria-label': 'Speed' }),
      load: h('div', { class: 'plot ld1', role: 'img', 'aria-label': 'Load' }),
    };
    this.modelText = h('span', { class: 's mut' });
    this.record = new ForecastRecord(this.page, this.hashAsset());
    this.labels = h('span', { class: 'labels' });
    this.band = new BandChoice(this.page, () => this.draw());
    this.margin = h('span', { class: 's mut margin' });
    this.spanButtons = SPANS.map(([hours, text]) => h('button', {
      type: 'button', 'aria-pressed': String(hours * HOUR_MS === this.span),
      onclick: () => this.choose(hours * HOUR_MS),
    }, text));
    return h('section', { class: 'panel p-trend' },
      h('header', {}, h('h2', {}, 'Temperature, °C'), this.modelText, this.record.element,
        this.labels, this.margin,
        h('span', { class: 'keys' },
          key('', 'measured'), key('tp', 'twin'), key('tw', 'forecast median'),
          this.band.element,
          h('span', { class: 'seg', role: 'group', 'aria-label': 'History range' },
            this.spanButtons))),
      this.boxes.temperature, this.boxes.speed, this.boxes.load);
  }

  choose(spanMs) {
    this.span = spanMs;
    SPANS.forEach(([hours], i) =>
      this.spanButtons[i].setAttribute('aria-pressed', String(hours * HOUR_MS === spanMs)));
    this.page.live.showPast(spanMs);
    this.draw();
  }

  /** Everything but the charts. */
  update() {
    const { store, clock } = this.page;
    const now = situation(store.state, clock);
    if (!now) return;
    this.updateAnswers(now);
    this.updateHeads(now);
    this.updateSection(now);
    const detail = liveDetail(store.state, clock);
    this.alarms.update(store.get('alarms'), () => detail);
    const known = now.live && store.get('alarmsKnown');
    setText(this.alarmCount, known ? summary(store.get('alarms')) : 'unknown');
    this.firstData.update(store.state, clock);
    this.trendPanel.hidden = this.firstData.element.hidden === false;
  }

  updateAnswers(now) {
    const peakOf = (sensor) => {
      const band = now.fan?.bands[sensor];
      return band ? Math.max(...band.q975) : null;
    };
    const tiles = [nowTile(now, peakOf(now.reading?.sensor)), nextStepTile(now), liveLimitTile(now)];
    tiles.forEach((tile, i) => {
      const shown = this.answers.children[i];
      if (!shown) this.answers.append(tile);
      else if (!shown.isEqualNode(tile)) shown.replaceWith(tile);
    });
  }

  updateHeads(now) {
    const { asset, forecast } = this.page.store.state;
    const stale = this.isStale(now);
    const blind = this.blind(now);
    setText(this.sectionChip, blind ? `estimates uncertain: no ${blind}` : 'last known values');
    this.trendPanel.classList.toggle('isstale', stale || now.lostMs !== null);
    this.sectionPanel.classList.toggle('isstale', stale);
    this.sectionChip.hidden = !stale;
    setText(this.sectionTitle, this.isBearing ? `Bearing ${asset.bearing} cross-section, °C`
      : `Network ${asset.network}, °C`);
    setText(this.modelText, this.modelLine(asset, now));
    const labels = [...((now.fan && forecast?.labels) || []), isNumber(asset.ambient_assumed_c)
      && `ambient assumed ${fixed(asset.ambient_assumed_c, 0)} °C`].filter(Boolean);
    if (labels.join() !== this.shownLabels) {
      put(this.labels, labels.map((label) => h('span', { class: 'chip dash' }, labelText(label))));
      this.shownLabels = labels.join();
    }
    const margin = now.fan && forecast?.runaway_margin;
    setText(this.margin, marginText(margin));
    this.margin.title = marginTitle(margin);
  }

  modelLine(asset, now) {
    const model = asset.active_model;
    if (!model) return 'no model yet';
    const name = `model v${model.version}`;
    if (model.trusted === false) return `${name}, not trusted: no forecast`;
    if (now.alone) return `model v${model.version}, open loop (no sensor correction)`;
    if (!this.page.store.get('history')) return `${name}, loading history …`;
    const parts = [name];
    const residual = this.residual(now.nowMs);
    if (isNumber(residual)) parts.push(`rms residual of the last hour ${fixed(residual, 2)} K`);
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

  /** What of the operation the estimates would need and do not have, in words. */
  blind(now) {
    const missing = this.page.store.get('nodes')?.missing ?? [];
    return now.live && listed(missing.map((name) => channelName(name).toLowerCase()));
  }

  /** Whether the estimates are not of now. */
  isStale(now) {
    return now.alone || !now.live || Boolean(this.blind(now));
  }

  updateSection(now) {
    const stale = this.isStale(now);
    if (this.isBearing) this.section.update({ ...this.bearingNodes(now), stale });
    else this.section.update({ ...this.ownNodes(now), stale });
  }

  /** What the drawing shows, by number of the node. */
  bearingNodes(now) {
    const { state } = this.page.store;
    const nodes = {};
    const spreads = {};
    const unknown = [];
    const reasons = {};
    const measured = {};
    const measure = (node, channel) => {
      if (state.tags[channel]) measured[node] = readChannel(state, this.page.clock, channel);
    };
    NODE_NAMES.forEach((_, i) => {
      const estimate = state.nodes?.nodes?.[`t_node_${i + 1}_c`];
      nodes[i + 1] = estimate?.mean_c ?? null;
      spreads[i + 1] = estimate?.std_c ?? 0;
      if (estimate?.known === false) unknown.push(i + 1);
      reasons[i + 1] = estimate?.reason;
      measure(i + 1, `t_node_${i + 1}_c`);
    });
    nodes[14] = state.asset.ambient_assumed_c ?? null;
    measure(14, 'ambient_c');
    const alerts = {};
    for (const [sensor, node] of Object.entries(NODE_OF_SENSOR)) {
      measure(node, sensor);
      const priority = this.alertOf(now, now.readings.find((one) => one.sensor === sensor));
      if (priority) alerts[node] = priority;
    }
    return { nodes, spreads, unknown, reasons, measured, alerts };
  }

  /** What the tiles show, by name. */
  ownNodes(now) {
    const { state } = this.page.store;
    const temperatures = channelNames(state.asset).filter((name) => name.endsWith('_c'));
    const byName = (names, one) => Object.fromEntries(names.map((name) => [name, one(name)]));
    const alerts = now.readings.map((reading) => [reading.sensor, this.alertOf(now, reading)]);
    const estimate = (name) =>
      state.nodes?.nodes?.[name]?.mean_c ?? state.tags[`${name}.twin`]?.goodValue;
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

  /** A ring over its limit, or on its way there. */
  alertOf(now, reading) {
    if (!reading) return null;
    const { limits } = reading;
    if (reading.usable && reading.value >= limits.warning) {
      return { priority: reading.value >= limits.alarm ? 1 : 2, predicted: false };
    }
    const ahead = this.page.store.get('forecast')?.time_to_limit?.[reading.sensor];
    if (!now.fan || !ahead || ahead.warning.probability < THRESHOLDS.atRisk) return null;
    return { priority: ahead.alarm.probability >= THRESHOLDS.alarm ? 1 : 2, predicted: true };
  }

  /** The charts, once a second. */
  draw() {
    const { store, clock } = this.page;
    const now = situation(store.state, clock);
    const history = store.get('history') ?? NO_PAST;
    if (!now || document.hidden || !this.sensors.length) return;
    const past = window.innerWidth < PHONE ? Math.min(this.span, PHONE_PAST_MS) : this.span;
    const fromMs = now.nowMs - past;
    const { times, columns } = history.columns(fromMs, now.nowMs, BRIDGE_WALL_MS * clock.rate);
    const span = { nowMs: now.nowMs, fromMs, endMs: now.endMs ?? now.nowMs + past * 0.15, times };
    const limits = Object.fromEntries(
      Object.entries(now.limits).filter(([sensor]) => this.sensors.includes(sensor)));
    const lanes = [
      { name: 'Speed', unit: 'rpm', key: 'speed_rpm', values: columns.speed_rpm ?? [] },
      { name: 'Load', unit: 'N', key: 'load_n', values: columns.load_n ?? [] },
    ];
    this.trend.update({
      ...span, lanes, steps: now.steps, limits, fan: this.band.drawn(now.fan), ghost: null, lostMs: now.lostMs,
      sensors: this.sensors,
      crossings: now.crossings,
      past: Object.fromEntries(this.sensors.map((sensor) => [sensor,
        { measured: columns[sensor] ?? [], twin: columns[`${sensor}.twin`] ?? [] }])),
      current: Object.fromEntries(this.sensors.map((sensor) =>
        [sensor, readChannel(store.state, clock, sensor)])),
    });
    const lane = (values, reading, name) => ({
      ...span, values, current: reading.usable ? reading.value : null, steps: now.steps, key: name,
    });
    this.speed.update(lane(columns.speed_rpm ?? [], now.speed, 'speed_rpm'));
    this.load.update(lane(columns.load_n ?? [], now.load, 'load_n'));
    this.describeCharts(now);
  }

  describeCharts(now) {
    const readings = now.readings.map((reading) => `${reading.sensor} ${fixed(reading.value)}`);
    this.boxes.temperature.setAttribute('aria-label',
      `Temperatures measured, estimated and forecast: ${readings.join(', ')} degrees Celsius.`);
    this.boxes.speed.setAttribute('aria-label',
      `Speed measured and planned, now ${fixed(now.speed.value, 0)} revolutions per minute.`);
    this.boxes.load.setAttribute('aria-label',
      `Radial load measured and planned, now ${fixed(now.load.value, 0)} newtons.`);
  }
}
