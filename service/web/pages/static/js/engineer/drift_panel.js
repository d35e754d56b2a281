// How the machine changed over the model versions: one quantity with its interval.
import { Chart } from '../charts/chart.js';
import { CLEAR, lineOf, timeAxis, valueAxis } from '../charts/paint.js';
import { rem, token } from '../parts/dom.js';
import { isNumber, significant } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { gap, Hosted, Panel, section, select, v } from '../parts/panel.js';

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

/** items: of the drift series, oldest first, null while they are asked for; models: all versions. */
export class DriftPanel extends Panel {
  render({ items, models }) {
    const choices = driftChoices(items ?? []);
    const key = choices[this.chosen] ? this.chosen : Object.keys(choices)[0];
    const choice = choices[key];
    const shown = choice ? items.filter((item) => isNumber(choice.of(item)?.value)) : [];
    return section('e-drift', 'Drift over versions', [gap(), choice && select('Quantity',
      Object.entries(choices).map(([name, { text, unit }]) => [name, `${first(text)}${unit ? `, ${unit}` : ''}`]), key,
      (chosen) => this.set({ chosen }), { class: 'btn sm' })],
    shown.length > 0 && v(Hosted, { class: 'plot df', make: (box) => new DriftChart(box),
      show: (chart) => chart.update(shown, choice, models) }),
    v('div', { class: 's' }, shown.length ? summaryOf(shown.at(-1), choice) : v('p', { class: 'mut' },
      items ? 'There is nothing to compare before the first identification.' : 'loading …')));
  }
}

function summaryOf(latest, { text, unit, of }) {
  const { value, low, high } = of(latest);
  const summary = latest.text ? first(plain(latest.text)) : '';
  return [
    v('p', {}, `${first(text)}: `, v('b', {}, `${significant(value)}${unit ? ` ${unit}` : ''}`),
      ` in v${latest.version}, 95 % ${significant(low)} … ${significant(high)}`),
    v('p', { class: latest.changed ? 'b' : 'mut' }, latest.changed && [icon(2, 'hollow'), ' '],
      summary && `v${latest.version}: ${summary}.`)];
}

class DriftChart extends Chart {
  shown;
  models;

  update(shown, choice, models) {
    Object.assign(this, { shown, models });
    const figures = shown.map((item) => choice.of(item));
    this.show([shown.map((item) => item.version),
      ...['low', 'high', 'value'].map((name) => figures.map((figure) => figure[name] ?? null))]);
  }

  options() {
    const [ink, ground] = [token('--ink'), token('--panel')];
    return {
      scales: {
        x: { time: false, range: () => [this.shown[0].version - 0.5, this.shown.at(-1).version + 0.5] },
        y: { range: (_, low, high) => {
          const room = (high - low) * 0.22 || Math.abs(high) * 0.1 || 1;
          return [low - room * 0.6, high + room];
        } },
      },
      axes: [timeAxis(true, { incrs: [1, 2, 5, 10, 20], space: 34,
        values: (_, splits) => splits.map((value) => (Number.isInteger(value) ? `v${value}` : '')) }),
      valueAxis({ space: 34, values: (_, splits) => splits.map(significant) })],
      series: [{}, lineOf(CLEAR, 1), lineOf(CLEAR, 1),
        lineOf(ink, 2, { points: { show: true, size: 9, fill: ink, stroke: ground, width: 2 } })],
      bands: [{ series: [2, 1], fill: token('--fan95') }], padding: [8, 10, 0, 0],
    };
  }

  /** Intervals as whiskers (one version alone has no band), and what each version is. */
  paint(pen) {
    const [versions, lows, highs] = pen.plot.data;
    const isCrowded = pen.width / Math.max(1, versions.length) < 70 * pen.ratio;
    versions.forEach((version, i) => {
      if (!isNumber(lows[i]) || !isNumber(highs[i])) return;
      const [x, low, high] = [pen.x(version), pen.y(lows[i]), pen.y(highs[i])];
      const wing = rem() * 0.3 * pen.ratio;
      pen.line({ colour: '--twin', width: 2 }, ...[low, high].map((y) => [[x - wing, y], [x + wing, y]]),
        [[x, low], [x, high]]);
      const { changed } = this.shown[i];
      const { status } = this.models.find((model) => model.version === version) ?? {};
      const isActive = status === 'active';
      const label = [isActive || !isCrowded ? status : '', changed && 'changed'].filter(Boolean).join(', ');
      if (label) pen.text(label, x, high - 4 * pen.ratio, { align: 'center', strong: isActive || changed,
        colour: changed ? '--p2-text' : isActive ? '--ink' : '--ink-3' });
    });
  }
}
