// Runs over each other: one channel, all of them aligned at their start.
import { ChartCursor } from './chart_cursor.js';
import { rem, token } from './dom.js';
import { isNumber, spanText } from './format.js';
import { font, fontSize, mount, pixelRatio, roomAround, stroke, valueAxis, write } from './paint.js';
import { joined } from './past.js';

const PER_LINE = 3;
const HOUR_S = 3600;
// Measured values are never in the colours of alarms; what is alike in colour differs in its dashes.
const LOOKS = [
  ['--ink', []], ['--twin', []], ['--ink-3', [10, 5]], ['--twin-2', [3, 4]], ['--ink', [12, 4, 3, 4]],
];

/** As many runs as can be told from each other. */
export const MOST_RUNS = LOOKS.length;

/** How the run at a place of the list is drawn. */
export const lookOfRun = (place) => ({ colour: LOOKS[place][0], dash: LOOKS[place][1] });

export class RunChart {
  constructor(box) {
    this.box = box;
  }

  /** model: { title, unit, runs: [{ text, line }] }; times of a line are ms since the run's start. */
  update(model) {
    this.model = model;
    this.destroy();
    const data = joined(model.runs.map(({ line }) => line));
    const series = [{}, ...model.runs.flatMap((_, place) => {
      const { colour, dash } = lookOfRun(place);
      const hidden = { stroke: 'rgba(0,0,0,0)', width: 0, points: { show: false } };
      return [{
        stroke: token(colour), width: stroke(2), dash, points: { show: false }, spanGaps: false,
      }, hidden, hidden];
    })];
    this.reading = new ChartCursor(this.box, (index) => this.readAt(index));
    this.mounted = mount(this.box, {
      scales: { x: { time: false } },
      axes: [{
        stroke: token('--ink-2'), font: font(fontSize()), size: rem() * 2, space: stroke(80),
        grid: { stroke: token('--grid'), width: stroke(1) }, ticks: { show: false },
        incrs: [60, 300, 600, 1200, 1800, 1, 2, 4, 8, 12, 24, 48, 96, 240].map((one, i) =>
          (i < 5 ? one : one * HOUR_S)),
        values: (_, splits) => splits.map((second) => elapsed(second)),
      }, valueAxis()],
      series, padding: roomAround(),
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      hooks: { draw: [(plot) => this.paint(plot)], setCursor: [() => this.reading.show()] },
    }, data);
    this.reading.attach(this.mounted.plot);
  }

  destroy() {
    this.mounted?.destroy();
    this.reading?.destroy();
    this.mounted = null;
  }

  paint(plot) {
    const ratio = pixelRatio();
    this.reading.paintMark(plot);
    write(plot.ctx, `${this.model.title}, ${this.model.unit}`, plot.bbox.left + 8 * ratio,
      plot.bbox.top + 3 * ratio, {
        size: fontSize() * ratio, base: 'top', colour: token('--ink-2'), halo: token('--panel'),
      });
  }

  /** What all runs measured so long after their start; between two readings the one before. */
  readAt(index) {
    const [times, ...columns] = this.mounted.plot.data;
    const rows = this.model.runs.map(({ text }, place) => {
      const values = columns[PER_LINE * place];
      let at = index;
      while (at > 0 && values[at] === undefined) at -= 1;
      const ends = values.findLastIndex((value) => value !== undefined);
      return {
        name: text, value: index <= ends ? values[at] : null, unit: this.model.unit,
        digits: this.model.unit === '°C' ? 1 : 0,
      };
    });
    const seconds = times[index];
    return {
      ms: seconds * 1000, head: [`${spanText(seconds)} after the start`],
      rows: rows.filter((row) => isNumber(row.value)),
    };
  }
}

/** Hours and minutes since the start. */
function elapsed(second) {
  const minutes = Math.round(second / 60);
  return `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, '0')}`;
}
