// Alarm symbols. Shape shows priority, line shows reality, hatch shows distrust: never colour alone.
import { v } from './panel.js';

const SHAPES = {
  1: () => v('rect', { x: 2.5, y: 2.5, width: 19, height: 19, rx: 1.5 }),
  2: () => v('path', { d: 'M12 2 23 21.5H1Z', 'stroke-linejoin': 'round' }),
  3: () => v('path', { d: 'M12 1.5 22.5 12 12 22.5 1.5 12Z', 'stroke-linejoin': 'round' }),
  bad: () => v('circle', { cx: 12, cy: 12, r: 10 }),
  ok: () => v('circle', { cx: 12, cy: 12, r: 9.5 }),
  none: () => v('circle', { cx: 12, cy: 12, r: 9.5, 'stroke-dasharray': '1.6 2.4' }),
};

const COLOURS = {
  1: ['var(--p1)', 'var(--p1-line)', 'var(--p1-on)'],
  2: ['var(--p2)', 'var(--p2-line)', 'var(--p2-on)'],
  3: ['var(--p3)', 'var(--p3-line)', 'var(--p3-on)'],
  bad: ['var(--bad)', 'var(--bad)', 'var(--bad-on)'],
  ok: ['var(--ink-2)', 'var(--ink-2)', 'var(--ink-2)'],
  none: ['var(--ink-3)', 'var(--ink-3)', 'var(--ink-3)'],
};

const MARKS = {
  shelved: ['M12 8v5l3 2', 2.2], struck: ['M4 20 20 4', 2.2], ok: ['M7 12.5 10.5 16 17 8.5', 2.4],
  bad: ['M7 7 17 17M17 7 7 17', 2.6], none: ['M7 12H17', 2.4],
};

function mark(kind, look, colour) {
  const [d, width] = MARKS[look] ?? MARKS[kind] ?? [];
  return d ? v('path', { d, fill: 'none', stroke: colour, 'stroke-width': width }) : v('text', {
    x: 12, y: kind === 2 ? 19 : 17, 'text-anchor': 'middle', 'font-weight': 700,
    'font-size': kind === 2 ? 12 : 13.5, fill: colour,
  }, String(kind));
}

/**
 * One symbol. kind: 1, 2, 3 (priority), 'bad' (untrusted), 'ok', 'none'. look: 'filled', 'hollow'
 * (returned), 'dashed' (predicted), 'inverse' (on its own full colour), 'current' (in the colour of
 * the text around it), 'shelved', 'suppressed', 'struck' (out of service): grey.
 */
export function icon(kind, look = 'filled', size = '1.25em') {
  let [fill, line, on] = COLOURS[kind];
  if (look === 'inverse') [fill, line, on] = [on, on, fill];
  if (look === 'current') fill = line = 'currentColor';
  const aside = ['shelved', 'suppressed', 'struck'].includes(look);
  if (aside) fill = line = 'var(--ink-3)';
  const hollow = aside || ['hollow', 'dashed', 'current'].includes(look)
    || kind === 'ok' || kind === 'none';
  const shape = v('g', {
    fill: hollow ? 'none' : fill, stroke: line, 'stroke-width': 2.2,
    'stroke-dasharray': { dashed: '4 2.6', suppressed: '1.6 2.4' }[look] ?? null,
  }, SHAPES[kind]());
  return v('svg', {
    class: 'ic', viewBox: '0 0 24 24', 'aria-hidden': 'true', style: { width: size, height: size },
  }, shape, mark(kind, look, hollow ? line : on));
}

export function logo() {
  const balls = [[12, 4.6], [19, 10], [16.4, 18], [7.6, 18], [5, 10]];
  return v('svg', {
    viewBox: '0 0 24 24', fill: 'none', stroke: 'currentColor', 'stroke-width': 2,
    'aria-hidden': 'true',
  },
  v('circle', { cx: 12, cy: 12, r: 10.5 }), v('circle', { cx: 12, cy: 12, r: 4.5 }),
  v('g', { fill: 'currentColor', stroke: 'none' },
    balls.map(([x, y]) => v('circle', { cx: x, cy: y, r: 1.9 }))));
}
