// The bearing and its housing: upper half in section, lower half in outside view (drafting
// convention), with the 13 nodes and the air. Greys show temperature; only a limit has a colour.
import { estimated, fixed, NODE_NAMES } from '../parts/format.js';
import { v } from '../parts/panel.js';
import { spoken } from '../live/readings.js';
import { heatLegend, heatOf } from './nodes.js';

const INNER_RING = 'M300 254H420V200H392A40 40 0 0 1 328 200H300Z';
const OUTER_RING = 'M300 94H420V144H392A40 40 0 0 0 328 144H300Z';
const OUTLINES = { 2: OUTER_RING, 4: INNER_RING };

const rectangle = (node, x, y, width, height, rx = 0) => (fill) =>
  v('rect', { 'data-node': node, x, y, width, height, rx, style: { fill: fill(node) } });
const shape = (node, d) => (fill) => v('path', { 'data-node': node, d, style: { fill: fill(node) } });

/** All parts, each in the grey of its node; those that are seen from outside in a group of their own. */
const PARTS = [rectangle(13, 60, 412, 600, 40, 2),
  [rectangle(1, 244, 316, 232, 78), rectangle(8, 200, 316, 44, 68),
    rectangle(9, 476, 316, 44, 68), shape(1, 'M214 412V400H506V412Z')],
  rectangle(5, 26, 254, 334, 124), rectangle(12, 360, 254, 334, 124),
  [shape(1, 'M244 316H476V400H244Z'), shape(8, 'M200 316H244V392H200Z'), shape(9, 'M476 316H520V392H476Z')],
  rectangle(7, 244, 94, 232, 160), rectangle(1, 244, 34, 232, 60),
  rectangle(8, 200, 34, 44, 186), rectangle(9, 476, 34, 44, 186),
  rectangle(10, 208, 226, 92, 28), rectangle(11, 420, 226, 92, 28),
  shape(2, OUTER_RING), shape(4, INNER_RING),
  rectangle(6, 305, 158, 15, 28, 2), rectangle(6, 400, 158, 15, 28, 2),
  (fill) => v('circle', { 'data-node': 3, cx: 360, cy: 172, r: 40, style: { fill: fill(3) } })];
const drawn = (part, fill) => (Array.isArray(part) ? v('g', { class: 'out' }, part.map((one) => one(fill)))
  : part(fill));

// node, where its label stands, what it points at
const LABELS_LEFT = [[1, 40, 256, 62], [8, 87, 212, 110], [7, 134, 262, 140], [6, 181, 311, 172],
  [10, 228, 218, 240]];
const LABELS_RIGHT = [[2, 40, 366, 103], [9, 87, 508, 110], [3, 134, 384, 166],
  [4, 181, 366, 246], [11, 228, 500, 240]];
const LABELLED = [...LABELS_LEFT, ...LABELS_RIGHT].map(([node]) => node);

const pattern = (id, stroke, ground) => v('pattern', {
  id, width: 9, height: 9, patternUnits: 'userSpaceOnUse', patternTransform: 'rotate(45)',
}, ground && v('rect', { width: 9, height: 9, fill: ground, style: { stroke: 'none' } }),
v('path', { d: 'M0 0V9', style: { stroke, strokeWidth: 2, opacity: 0.55 } }));

/** As `NodeTiles`, by the number of a node; alerts are of 2 and 4. */
export function Section({ nodes, spreads, unknown, reasons = {}, measured, alerts, stale, open = (_) => {} }) {
  const isKnown = (node) => !unknown.includes(node);
  const text = (node) => estimated(nodes[node], spreads[node], isKnown(node));
  const look = (node) => (measured[node] ? (measured[node].usable ? 'me' : 'st') : isKnown(node) ? 'es' : 'un');
  const fill = (node) => (measured[node] || isKnown(node) ? heatOf(measured[node]?.value ?? nodes[node])
    : 'url(#unknown)');
  const figure = (node, x, y, anchor) => v('g', {},
    v('title', {}, !measured[node] && !isKnown(node) && reasons[node] && `${NODE_NAMES[node - 1]}: ${reasons[node]}`),
    v('text', { class: `v ${look(node)}`, 'data-figure': node, x, y, 'text-anchor': anchor },
      measured[node] ? fixed(measured[node].value ?? nodes[node]) : text(node)));
  // What a label points at: a dot, or a ring where a sensor measures.
  const pin = (node, x, y) => v('circle', { 'data-pin': node, cx: x, cy: y, r: measured[node] ? 6 : 2.6,
    class: measured[node] ? `ring ${look(node)}` : 'pin',
    style: { display: measured[node] || LABELLED.includes(node) ? '' : 'none' } });
  const name = (node, x, y, anchor) => v('text', { class: 'n', x, y, 'text-anchor': anchor }, NODE_NAMES[node - 1]);
  const label = (isLeft) => (/** @type {any[]} */ [node, y, toX, toY]) => {
    const [x, side, anchor] = isLeft ? [150, 1, 'end'] : [570, -1, 'start'];
    return [v('polyline', { class: 'lead', points: `${x + 6 * side},${y} ${x + 18 * side},${y} ${toX},${toY}` }),
      pin(node, toX, toY), name(node, x, y - 8, anchor), figure(node, x, y + 13, anchor)];
  };
  const tag = (node, x) => [v('rect', { class: 'tag', x: x - 66, y: 262, width: 132, height: 44, rx: 3 }),
    pin(node, x - 54, 292), name(node, x, 279, 'middle'), figure(node, x, 299, 'middle')];
  const say = (node) => (measured[node] ? spoken(measured[node], 'degrees Celsius')
    : stale ? 'last known only' : `estimated ${text(node)} degrees Celsius`);
  const press = ({ target: { dataset } }) => {
    const node = Number(dataset.node ?? dataset.pin ?? dataset.figure);
    if (measured[node]) open(node);
  };
  return [v('svg', { class: `sect${stale ? ' stale' : ''}`, viewBox: '0 12 720 444', role: 'img', onclick: press,
    'aria-label': `Bearing cross-section. Inner ring ${say(4)}, outer ring ${say(2)}.` },
  v('defs', {}, pattern('distrust', 'var(--bad)'), pattern('unknown', 'var(--line-2)', 'var(--panel-2)')),
  v('g', { class: 'parts' }, PARTS.map((part) => drawn(part, fill))),
  v('g', {}, Object.entries(OUTLINES).filter(([node]) => measured[node]?.usable === false)
    .map(([, d]) => v('path', { d, fill: 'url(#distrust)' }))),
  v('g', {}, Object.entries(alerts).map(([node, { priority, predicted }]) => v('path', {
    d: OUTLINES[node], fill: 'none', stroke: `var(--p${priority}-line)`, 'stroke-width': 4,
    'stroke-dasharray': predicted ? '8 5' : null,
  }))),
  v('path', { class: 'cl', d: 'M8 316H712' }),
  v('path', { class: 'brk', d: 'M26 248q9 17 0 34t0 34 0 34 0 34M694 248q-9 17 0 34t0 34 0 34 0 34' }),
  LABELS_LEFT.map(label(true)), LABELS_RIGHT.map(label(false)), tag(5, 110), tag(12, 610),
  v('rect', { class: 'tag', x: 268, y: 418, width: 184, height: 28, rx: 3 }),
  v('text', { class: 'n', x: 290, y: 437 }, 'Bench'), figure(13, 442, 438, 'end'), pin(13, 279, 432),
  v('text', { class: 'n', x: 26, y: 34 }, 'Air'), figure(14, 26, 55, 'start'), pin(14, 14, 48),
  v('text', { class: 'n d', x: 30, y: 394 }, 'lower half: outside view')), heatLegend()];
}
