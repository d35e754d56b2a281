// The nodes of a network of one's own: nothing is known of its shape, so they are shown as tiles.
import { h, put, setText } from './dom.js';
import { channelName, estimated, fixed } from './format.js';
import { heatLegend, heatOf } from './heat.js';

export class NodeTiles {
  /** open(name): called when a measured point is clicked. */
  constructor(box, open = () => {}) {
    this.open = open;
    this.grid = h('ul', { class: 'ntiles' });
    this.tiles = new Map();
    put(box, this.grid, heatLegend());
  }

  /**
   * nodes: { name: estimate °C }, spreads: { name: its standard deviation in K }, unknown: names of
   * those without a useful estimate, reasons: { name: why },
   * measured: { name: { value, usable } } of measured points (which need not be nodes),
   * alerts: { name: { priority, predicted } }, stale: all is of the past.
   */
  update({ nodes, spreads, unknown, reasons = {}, measured, alerts, stale }) {
    const names = [...new Set([...Object.keys(measured), ...Object.keys(nodes)])];
    this.measured = measured;
    this.grid.classList.toggle('stale', stale);
    for (const name of names) {
      if (!this.tiles.has(name)) this.tiles.set(name, this.createTile(name));
      const known = !unknown.includes(name);
      const text = estimated(nodes[name], spreads[name], known);
      const estimate = { mean: known ? nodes[name] : null, text, known, why: reasons[name] };
      this.updateTile(this.tiles.get(name), estimate, measured[name], alerts[name]);
    }
  }

  createTile(name) {
    const heat = h('i', {});
    const value = h('b', { 'data-figure': name }, '–');
    const twin = h('small', {});
    const element = h('li', { onclick: () => this.measured?.[name] && this.open(name) }, heat,
      h('span', {}, channelName(name)), value, twin);
    this.grid.append(element);
    return { element, heat, value, twin };
  }

  updateTile({ element, heat, value, twin }, estimate, measured, alert) {
    const shown = measured?.value ?? estimate.mean;
    setText(value, measured ? fixed(shown) : estimate.text);
    const both = measured && Number.isFinite(estimate.mean);
    setText(twin, both ? `twin ${estimate.text}` : measured ? 'measured' : 'estimated');
    element.title = (!measured && !estimate.known && estimate.why) || '';
    value.className = measured ? (measured.usable ? 'me' : 'st') : 'es';
    element.className = [measured?.usable === false && 'gone', alert && `a${alert.priority}`,
      alert?.predicted && 'ahead'].filter(Boolean).join(' ');
    heat.classList.toggle('hatch', !measured && !estimate.known);
    heat.style.background = measured || estimate.known ? heatOf(shown) : '';
  }
}
