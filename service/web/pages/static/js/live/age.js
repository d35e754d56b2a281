// How long ago something was, also over a sleep of the machine that shows the page.

/** Of an asset that is followed there is a verdict every 5 s at least: more silence is no live line. */
export const LONGEST_SILENCE_MS = 7000;

/** The present moment, for `ageMs` later. */
export const thisMoment = () => ({ wallMs: Date.now(), runningMs: performance.now() });

/**
 * Milliseconds since a moment. `performance.now()` stands still in most browsers while the machine
 * sleeps, and `Date.now()` goes back where the clock is set: the longer span is never too short.
 */
export const ageMs = ({ wallMs, runningMs }) =>
  Math.max(Date.now() - wallMs, performance.now() - runningMs);
