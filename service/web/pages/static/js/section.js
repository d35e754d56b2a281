// The bearing and its housing: upper half in section, lower half in outside view (drafting
// convention), with the 13 nodes and the air. Greys show temperature; only a limit has a colour.
import { h, put, s, setText } from './dom.js';
import { estimated, fixed, NODE_NAMES } from './format.js';
import { heatLegend, heatOf } from './heat.js';

const INNER_RING = 'M300 254H420V200H392A40 40 0 0 1 328 200H300Z';
const OUTER_RING = 'M300 94H420V144H392A40 40 0 0 0 328 144H300Z';
const OUTLINES = { 2: OUTER_RING, 4: INNER_RING };

const rectangle = (node, x, y, width, height, rx = 0) =>
  s('rect', { 'data-node': node, x, y, width, height, rx });
const shape = (node, d) => s('path', { 'data-node': node, d });

const parts = () => s('g', { class: 'parts' },
  rectangle(13, 60, 412, 600, 40, 2),
  s('g', { class: 'out' },
    rectangle(1, 244, 316, 232, 78), rectangle(8, 200, 316, 44, 68),
    rectangle(9, 476, 316, 44, 68), shape(1, 'M214 412V400H506V412Z')),
  rectangle(5, 26, 254, 334, 124), rectangle(12, 360, 254, 334, 124),
  s('g', { class: 'out' },
    shape(1, 'M244 316H476V400H244Z'), shape(8, 'M200 316H244V392H200Z'),
    shape(9, 'M476 316H520V392H476Z')),
  rectangle(7, 244, 94, 232, 160), rectangle(1, 244, 34, 232, 60),
  rectangle(8, 200, 34, 44, 186), rectangle(9, 476, 34, 44, 186),
  rectangle(10, 208, 226, 92, 28), rectangle(11, 420, 226, 92, 28),
  shape(2, OUTER_RING), shape(4, INNER_RING),
  rectangle(6, 305, 158, 15, 28, 2), rectangle(6, 400, 158, 15, 28, 2),
  s('circle', { 'data-node': 3, cx: 360, cy: 172, r: 40 }));

// node, where its label stands, what it points at
const LABELS_LEFT = [[1, 40, 256, 62], [8, 87, 212, 110], [7, 134, 262, 140], [6, 181, 311, 172],
  [10, 228, 218, 240]];
const LABELS_RIGHT = [[2, 40, 366, 103], [9, 87, 508, 110], [3, 134, 384, 166],
  [4, 181, 366, 246], [11, 228, 500, 240]];

const LABELLED = [...LABELS_LEFT, ...LABELS_RIGHT].map(([node]) => node);

function label(node, y, toX, toY, left) {
  const x = left ? 150 : 570;
  const side = left ? 1 : -1;
  const anchor = left ? 'end' : 'start';
  return [
    s('polyline', {
      class: 'lead', points: `${x + 6 * side},${y} ${x + 18 * side},${y} ${toX},${toY}`,
    }),
    pin(node, toX, toY),
    s('text', { class: 'n', x, y: y - 8, 'text-anchor': anchor }, NODE_NAMES[node - 1]),
    figure(node, x, y + 13, anchor),
  ];
}

/** What a label points at: a dot, or a ring where a sensor measures. */
const pin = (node, x, y) => s('circle', { class: 'pin', 'data-pin': node, cx: x, cy: y, r: 2.6 });

const figure = (node, x, y, anchor) => s('g', {},
  s('title', { 'data-why': node }),
  s('text', { class: 'v es', 'data-figure': node, x, y, 'text-anchor': anchor }, '–'));

const tagged = (node, x) => [
  s('rect', { class: 'tag', x: x - 66, y: 262, width: 132, height: 44, rx: 3 }),
  pin(node, x - 54, 292),
  s('text', { class: 'n', x, y: 279, 'text-anchor': 'middle' }, NODE_NAMES[node - 1]),
  figure(node, x, 299, 'middle'),
];

const pattern = (id, stroke, ground) => s('pattern', {
  id, width: 9, height: 9, patternUnits: 'userSpaceOnUse', patternTransform: 'rotate(45)',
}, ground && s('rect', { width: 9, height: 9, fill: ground, style: { stroke: 'none' } }),
s('path', { d: 'M0 0V9', style: { stroke, strokeWidth: 2, opacity: 0.55 } }));
const hatchPatterns = () => s('defs', {}, pattern('distrust', 'var(--bad)'),
  pattern('unknown', 'var(--line-2)', 'var(--panel-2)'));

export class Section {
  /** open(node): called when a node is clicked that a sensor measures. */
  constructor(box, open = () => {}) {
    this.outlines = s('g', {});
    this.hatches = s('g', {});
    this.svg = s('svg', { class: 'sect', viewBox: '0 12 720 444', role: 'img' },
      hatchPatterns(), parts(), this.hatches, this.outlines,
      s('path', { class: 'cl', d: 'M8 316H712' }),
      s('path', {
        class: 'brk', d: 'M26 248q9 17 0 34t0 34 0 34 0 34M694 248q-9 17 0 34t0 34 0 34 0 34',
      }),
      LABELS_LEFT.map((one) => label(...one, true)),
      LABELS_RIGHT.map((one) => label(...one, false)),
      tagged(5, 110), tagged(12, 610),
      s('rect', { class: 'tag', x: 268, y: 418, width: 184, height: 28, rx: 3 }),
      s('text', { class: 'n', x: 290, y: 437 }, 'Bench'), figure(13, 442, 438, 'end'),
      pin(13, 279, 432), s('text', { class: 'n', x: 26, y: 34 }, 'Air'), figure(14, 26, 55, 'start'),
      pin(14, 14, 48),
      s('text', { class: 'n d', x: 30, y: 394 }, 'lower half: outside view'));
    this.svg.addEventListener('click', ({ target }) => {
      const { node, pin, figure } = target.dataset;
      const number = Number(node ?? pin ?? figure);
      if (this.measured?.[number]) open(number);
    });
    put(box, this.svg, heatLegend());
  }

  /**
   * nodes: { number: °C }, spreads: { number: standard deviation in K }, unknown: numbers of those
   * without a useful estimate, reasons: { number: why }, measured: { number: { value, usable } },
   * alerts: { 2 or 4: { priority, predicted } }, stale: the whole picture is of the past.
   */
  update({ nodes, spreads, unknown, reasons = {}, measured, alerts, stale }) {
    for (let node = 1; node <= 14; node += 1) {
      const known = !unknown.includes(node);
      const estimate = { value: nodes[node], spread: spreads[node], known, why: reasons[node] };
      this.updateNode(node, estimate, measured[node]);
    }
    this.measured = measured;
    this.svg.classList.toggle('stale', stale);
    put(this.hatches, Object.entries(OUTLINES).filter(([node]) => measured[node]?.usable === false)
      .map(([, d]) => s('path', { d, fill: 'url(#distrust)' })));
    put(this.outlines, Object.entries(alerts).map(([node, { priority, predicted }]) => s('path', {
      d: OUTLINES[node], fill: 'none', stroke: `var(--p${priority}-line)`, 'stroke-width': 4,
      'stroke-dasharray': predicted ? '8 5' : null,
    })));
    const say = (node) => fixed(measured[node]?.value ?? nodes[node]);
    this.svg.setAttribute('aria-label', `Bearing cross-section. Inner ring ${say(4)} degrees, `
      + `outer ring ${say(2)} degrees Celsius.`);
  }

  updateNode(node, estimate, measured) {
    const value = measured?.value ?? estimate.value;
    const figureText = this.svg.querySelector(`[data-figure="${node}"]`);
    setText(figureText, measured ? fixed(value)
      : estimated(value, estimate.spread, estimate.known));
    const why = !measured && !estimate.known && estimate.why;
    setText(this.svg.querySelector(`[data-why="${node}"]`), why ? `${NODE_NAMES[node - 1]}: ${why}` : '');
    const look = measured ? (measured.usable ? 'me' : 'st') : estimate.known ? 'es' : 'un';
    figureText.setAttribute('class', `v ${look}`);
    const ring = this.svg.querySelector(`[data-pin="${node}"]`);
    ring.setAttribute('class', measured ? `ring ${look}` : 'pin');
    ring.setAttribute('r', measured ? 6 : 2.6);
    ring.style.display = measured || LABELLED.includes(node) ? '' : 'none';
    const heat = measured || estimate.known ? heatOf(value) : 'url(#unknown)';
    for (const part of this.svg.querySelectorAll(`[data-node="${node}"]`)) part.style.fill = heat;
  }
}
