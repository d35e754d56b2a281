// What one code of `GET /fleet/map` means: its words, its symbol, and how it looks on the map.
import { token } from '../parts/dom.js';
import { v } from '../parts/panel.js';

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

export const markIcon = (code) => v('canvas', { width: 32, height: 32, 'aria-hidden': 'true',
  ref: (canvas) => { if (canvas) drawMark(canvas.getContext('2d'), code, 32, markColours()[code]); } });

const square = (half) => `M${-half} ${-half}H${half}V${half}H${-half}Z`;
const circle = (r) => `M${r} 0A${r} ${r} 0 1 1 ${-r} 0A${r} ${r} 0 1 1 ${r} 0Z`;
const TRIANGLE = 'M0 -1L1.1 .85H-1.1Z';
/** Outlines of the marks in units of their radius. */
const OUTLINES = {
  a: square(1), b: TRIANGLE, c: circle(0.9), d: square(0.9), e: TRIANGLE, f: circle(0.95), g: circle(0.9),
  h: square(0.62), i: square(0.62), j: circle(0.5), k: circle(0.25),
};
const DASH = 'M-.434 0H.434';
/** What is drawn on top of them. */
const STROKES = { c: DASH, f: 'M-.62 -.62L.62 .62M.62 -.62L-.62 .62', g: DASH };

export function drawMark(context, code, size, [ground, line]) {
  const radius = size * 0.36;
  const placed = (path) => {
    const whole = new Path2D();
    whole.addPath(new Path2D(path), new DOMMatrix([radius, 0, 0, radius, size / 2, size / 2]));
    return whole;
  };
  context.lineWidth = Math.max(1.25, size * 0.1);
  context.strokeStyle = line;
  context.setLineDash([]);
  const outline = placed(OUTLINES[code]);
  context.fillStyle = code === 'h' ? line : ground ?? 'transparent'; // a full grey square: no action is required
  if ('abh'.includes(code)) context.fill(outline);
  context.stroke(outline);
  if (code in STROKES) context.stroke(placed(STROKES[code]));
}
