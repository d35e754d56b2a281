// How the machine changed over the model versions: one quantity with its interval.
import { h, put, rem, setText, token } from './dom.js';
import { isNumber, significant } from './format.js';
import { icon } from './icons.js';
import { font, fontSize, mount, pixelRatio, timeAxis, valueAxis, write } from './paint.js';

const CLEAR = 'rgba(0,0,0,0)';
const plain = (text) => text.replaceAll(' degC', ' °C').replace(/(^|[\s(])-(?=\d)/g, '$1−');
const first = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** What can be shown: { key: { text, unit, of(item) } }; quantities first, then parameters. */
export function driftChoices(items) {
  const choices = {};
  for (const item of items) {
    for (const [name, { text, unit }] of Object.entries(item.quantities)) {
      choices[`q ${name}`] = { text: plain(text), unit, of: (one) => one.quantities[name] };
    }
  }
  for (const item of items) {
    for (const name of Object.keys(item.parameters)) {
      choices[`p ${name}`] = { text: `parameter ${name}`, unit: '', of: (one) => one.parameters[name] };
    }
  }
  return choices;
}

export class DriftPanel {
  constructor() {
    this.items = [];
    this.shown = [];
    this.select = h('select', { class: 'btn sm', 'aria-label': 'Quantity', onchange: () => this.show() });
    this.plot = h('div', { class: 'plot df' });
    this.text = h('div', { class: 's' }, h('p', { class: 'mut' }, 'loading …'));
    this.select.hidden = true;
    this.element = h('section', { class: 'panel e-drift' },
      h('header', {}, h('h2', {}, 'Drift over versions'), h('span', { class: 'sp' }), this.select),
      this.plot, this.text);
  }

  destroy() {
    this.mounted?.destroy();
  }

  /** items: of the drift series, oldest first; models: all versions. */
  update(items, models) {
    this.items = items;
    this.models = models;
    this.choices = driftChoices(items);
    const chosen = this.choices[this.select.value] ? this.select.value : Object.keys(this.choices)[0];
    put(this.select, Object.entries(this.choices).map(([key, { text, unit }]) =>
      h('option', { value: key, selected: key === chosen }, `${first(text)}${unit ? `, ${unit}` : ''}`)));
    this.select.hidden = !items.length;
    this.show();
  }

  show() {
    const choice = this.choices?.[this.select.value];
    this.shown = choice ? this.items.filter((item) => isNumber(choice.of(item)?.value)) : [];
    this.plot.hidden = !this.shown.length;
    if (!this.shown.length) {
      this.mounted?.destroy();
      this.mounted = null;
      put(this.text, h('p', { class: 'mut' }, 'There is nothing to compare before the first '
        + 'identification.'));
      return;
    }
    const figures = this.shown.map((item) => choice.of(item));
    const data = [this.shown.map((item) => item.version), ...['low', 'high', 'value']
      .map((name) => figures.map((figure) => figure[name] ?? null))];
    if (!this.mounted) this.create(data);
    else this.mounted.plot.setData(data);
    this.showText(choice);
  }

  showText({ text, unit, of }) {
    const latest = this.shown.at(-1);
    const { value, low, high } = of(latest);
    const summary = latest.text ? first(plain(latest.text)) : '';
    put(this.text,
      h('p', {}, `${first(text)}: `, h('b', {}, `${significant(value)}${unit ? ` ${unit}` : ''}`),
        ` in v${latest.version}, 95 % ${significant(low)} … ${significant(high)}`),
      h('p', { class: latest.changed ? 'b' : 'mut' }, latest.changed && [icon(2, 'hollow'), ' '],
        summary && `v${latest.version}: ${summary}.`));
  }

  create(data) {
    const line = (stroke, width) => ({ stroke, width, points: { show: false } });
    this.mounted = mount(this.plot, {
      scales: {
        x: { time: false, range: () =>
          [this.shown[0].version - 0.5, this.shown.at(-1).version + 0.5] },
        y: { range: (_, low, high) => {
          const room = (high - low) * 0.22 || Math.abs(high) * 0.1 || 1;
          return [low - room * 0.6, high + room];
        } },
      },
      axes: [{ ...timeAxis(true), incrs: [1, 2, 5, 10, 20], space: 34,
        values: (_, splits) => splits.map((value) => (Number.isInteger(value) ? `v${value}` : '')) },
      valueAxis({ space: 34, values: (_, splits) => splits.map(significant) })],
      series: [{}, line(CLEAR, 1), line(CLEAR, 1), {
        stroke: token('--ink'), width: 2,
        points: { show: true, size: 9, fill: token('--ink'), stroke: token('--panel'), width: 2 },
      }],
      bands: [{ series: [2, 1], fill: token('--fan95') }],
      cursor: { show: false }, padding: [8, 10, 0, 0],
      hooks: { draw: [(plot) => this.paint(plot)] },
    }, data);
  }

  /** Intervals as whiskers (one version alone has no band), and what each version is. */
  paint(plot) {
    const { ctx: context } = plot;
    const ratio = pixelRatio();
    const [versions, lows, highs] = plot.data;
    const crowded = plot.bbox.width / Math.max(1, versions.length) < 70 * ratio;
    context.save();
    versions.forEach((version, i) => {
      if (!isNumber(lows[i]) || !isNumber(highs[i])) return;
      context.strokeStyle = token('--twin');
      context.lineWidth = 2 * ratio;
      const x = plot.valToPos(version, 'x', true);
      const [low, high] = [lows[i], highs[i]].map((value) => plot.valToPos(value, 'y', true));
      const wing = rem() * 0.3 * ratio;
      context.beginPath();
      for (const y of [low, high]) {
        context.moveTo(x - wing, y);
        context.lineTo(x + wing, y);
      }
      context.moveTo(x, low);
      context.lineTo(x, high);
      context.stroke();
      const { changed } = this.shown[i];
      const { status } = this.models.find((model) => model.version === version) ?? {};
      const label = [status === 'active' || !crowded ? status : '', changed && 'changed']
        .filter(Boolean).join(', ');
      if (label) {
        context.font = font(fontSize() * ratio, status === 'active');
        write(context, label, x, high - 4 * ratio, {
          size: fontSize() * ratio, align: 'center', strong: status === 'active' || changed,
          colour: token(changed ? '--p2-text' : status === 'active' ? '--ink' : '--ink-3'),
          halo: token('--panel'),
        });
      }
    });
    context.restore();
  }
}
