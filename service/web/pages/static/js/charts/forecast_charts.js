// Temperatures over time with their forecast, and speed and load below, on one axis of time.
import { readChannel, spoken } from '../live/readings.js';
import { lowerName } from '../parts/format.js';
import { Hosted, Panel, v } from '../parts/panel.js';
import { LaneChart } from './lane.js';
import { TrendChart } from './trend.js';

const BRIDGE_WALL_MS = 1500;
const FLAG_MS = 250; // as often as the header's clock
// What is drawn while the past is still on its way.
const NO_PAST = { columns: () => ({ times: [], columns: {} }) };

export const limitsOfSensors = ({ limits }, sensors) =>
  Object.fromEntries(Object.entries(limits).filter(([sensor]) => sensors.includes(sensor)));

/** now: the situation that is described in words, null where the view does so; syncKey: of their cursors. */
export class ForecastCharts extends Panel {
  constructor(attributes) {
    super(attributes);
    const { clock } = this.page;
    this.every(FLAG_MS, () => clock.now() !== null && this.trend.showClock(clock.now()));
  }

  render({ now, syncKey }) {
    const chart = (name, look, label, make) => v(Hosted, { class: `plot ${look}`, role: 'img', 'aria-label': label,
      make: (box) => {
        this[name] = make(box);
        return this[name];
      } });
    const readings = now?.readings.map((reading) =>
      `${lowerName(reading.sensor)} ${spoken(reading, 'degrees Celsius')}`);
    return [
      chart('trend', 't', readings ? `Temperatures measured, estimated and forecast: ${readings.join(', ')}.`
        : 'Temperatures', (box) => new TrendChart(box, syncKey)),
      chart('speed', 'sp1', now ? `Speed measured and planned: ${spoken(now.speed, 'revolutions per minute')}.`
        : 'Speed', (box) => new LaneChart(box, { label: 'Speed, rpm', syncKey })),
      chart('load', 'ld1', now ? `Radial load measured and planned: ${spoken(now.load, 'newtons')}.` : 'Load',
        (box) => new LaneChart(box, { label: 'Load, N', syncKey, showTime: true })),
    ];
  }

  /** Draw the past since fromMs, and what lies ahead until endMs; ghost: another fan behind that one. */
  show(now, { fromMs, endMs, sensors, steps, fan, ghost = null, crossings }) {
    const { store, clock } = this.page;
    const { nowMs, lostMs } = now;
    const { times, columns } = (store.get('history') ?? NO_PAST).columns(fromMs, nowMs, BRIDGE_WALL_MS * clock.rate);
    const span = { nowMs, fromMs, endMs, times, steps };
    const ofSensors = (what) => Object.fromEntries(sensors.map((sensor) => [sensor, what(sensor)]));
    this.trend.update({
      ...span, limits: limitsOfSensors(now, sensors), fan, ghost, lostMs, sensors, crossings,
      lanes: [
        { name: 'Speed', unit: 'rpm', key: 'speed_rpm', values: columns.speed_rpm ?? [] },
        { name: 'Load', unit: 'N', key: 'load_n', values: columns.load_n ?? [] },
      ],
      past: ofSensors((sensor) => ({ measured: columns[sensor] ?? [], twin: columns[`${sensor}.twin`] ?? [] })),
      current: ofSensors((sensor) => readChannel(store.state, clock, sensor)),
    });
    for (const [lane, key] of [['speed', 'speed_rpm'], ['load', 'load_n']]) {
      const { usable, value } = now[lane];
      this[lane].update({ ...span, values: columns[key] ?? [], current: usable ? value : null, key });
    }
  }
}
