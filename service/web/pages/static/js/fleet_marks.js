// What one letter of `GET /fleet/map` means: its words, its symbol, and how it looks on the map.
import { h, token } from './dom.js';

/** By letter: the state, and the words for it. */
export const MARKS = {
  a: { state: 'over', words: 'over an alarm limit' },
  b: { state: 'over', words: 'over a warning limit' },
  c: { state: 'over', words: 'recovering' },
  d: { state: 'ahead', words: 'alarm limit ahead' },
  e: { state: 'ahead', words: 'warning limit ahead' },
  f: { state: 'lost', words: 'without data' },
  g: { state: 'unknown', words: 'unknown' },
  h: { state: 'safe', words: 'safe, also in the next step' },
  i: { state: 'safe', words: 'safe now; next step or model in doubt' },
  j: { state: 'waiting', words: 'waiting for the first data' },
  k: { state: 'unread', words: 'not read yet' },
};

/** The meaning of a mark, and whether an alarm waits for an acknowledgement. */
export const meaningOf = (mark) =>
  ({ ...(MARKS[mark.toLowerCase()] ?? MARKS.k), waits: mark !== mark.toLowerCase() });

/** Colours of the marks in the present theme: [ground, line, text]; no ground where it is null. */
export function markColours() {
  const grey = [token('--panel-2'), token('--line-2'), token('--ink-2')];
  const priority = (one) => [token(`--p${one}`), token(`--p${one}-line`), token(`--p${one}-on`)];
  const ahead = (one) => [null, token(`--p${one}-line`), token('--ink')];
  return {
    a: priority(1), b: priority(2), c: [token('--panel-2'), token('--ink'), token('--ink')],
    d: ahead(1), e: ahead(2), f: [null, token('--bad'), token('--bad-text')],
    g: [null, token('--ink-3'), token('--ink-3')], h: grey, i: grey,
    j: [null, token('--line'), token('--ink-3')], k: [null, token('--line'), token('--ink-3')],
  };
}

/** The symbol of a mark as the map has it. */
export function markIcon(letter) {
  const canvas = h('canvas', { width: 32, height: 32, 'aria-hidden': 'true' });
  const context = canvas.getContext('2d');
  drawMark(context, letter, 32, markColours()[letter]);
  return canvas;
}

/** Draw the symbol of a mark into a square of this size: its shape tells it without its colour. */
export function drawMark(context, letter, size, [ground, line]) {
  const middle = size / 2;
  const radius = size * 0.36;
  context.lineWidth = Math.max(1.25, size * 0.1);
  context.strokeStyle = line;
  context.fillStyle = ground ?? 'transparent';
  context.setLineDash([]);
  context.beginPath();
  const triangle = () => {
    context.moveTo(middle, middle - radius);
    context.lineTo(middle + radius * 1.1, middle + radius * 0.85);
    context.lineTo(middle - radius * 1.1, middle + radius * 0.85);
    context.closePath();
  };
  const square = (half) => context.rect(middle - half, middle - half, 2 * half, 2 * half);
  const circle = (r) => context.arc(middle, middle, r, 0, 2 * Math.PI);
  const draw = {
    a: () => square(radius), b: triangle, d: () => square(radius * 0.9), e: triangle,
    c: () => circle(radius * 0.9), f: () => circle(radius * 0.95), g: () => circle(radius * 0.9),
    h: () => square(radius * 0.62), i: () => square(radius * 0.62),
    j: () => circle(radius * 0.5), k: () => circle(radius * 0.25),
  }[letter];
  draw();
  if (letter === 'h') context.fillStyle = line; // a full grey square: nothing is asked of anybody
  if ('abh'.includes(letter)) context.fill();
  context.stroke();
  const across = radius * 0.62;
  if (letter === 'f') {
    context.beginPath();
    context.moveTo(middle - across, middle - across);
    context.lineTo(middle + across, middle + across);
    context.moveTo(middle + across, middle - across);
    context.lineTo(middle - across, middle + across);
    context.stroke();
  }
  if (letter === 'g' || letter === 'c') {
    context.beginPath();
    context.moveTo(middle - across * 0.7, middle);
    context.lineTo(middle + across * 0.7, middle);
    context.stroke();
  }
}
