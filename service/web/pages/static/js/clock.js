// Process time in the browser: told by the stream, run on in between.
const MINIMUM_SPAN_MS = 2000;

export class ProcessClock {
  constructor() {
    this.rate = 1;
    this.told = null; // { process, wall, local } of the first message of this connection
    this.offset = null; // process time at local time 0
  }

  /** Forget the past: a service that came back may have another clock. */
  reset() {
    this.told = null;
    this.offset = null;
  }

  /** The rate that the service itself names. */
  setRate(rate) {
    if (!(rate > 0) || rate === this.rate) return;
    const now = this.now();
    this.rate = rate;
    if (now !== null) this.offset = now - performance.now() * rate;
  }

  /** A message of process time `processMs`, sent at wall time `wallMs` of the service. */
  tell(processMs, wallMs) {
    if (!Number.isFinite(processMs)) return;
    const local = performance.now();
    this.told ??= { process: processMs, wall: wallMs };
    const span = wallMs - this.told.wall;
    if (span > MINIMUM_SPAN_MS) {
      const measured = (processMs - this.told.process) / span;
      // The message times carry milliseconds of delay: only a real change of rate counts.
      if (Math.abs(measured / this.rate - 1) > 0.1 && measured > 0.5) {
        this.setRate(measured > 1.5 ? Math.round(measured) : 1);
      }
    }
    const offset = processMs - local * this.rate;
    // The least delayed message knows best; late ones pull only slowly, a jump is followed.
    const jump = this.offset === null || Math.abs(offset - this.offset) > 5000 * this.rate;
    if (jump || offset > this.offset) this.offset = offset;
    else this.offset += 0.05 * (offset - this.offset);
  }

  /** Process time in milliseconds, null before the first message. */
  now() {
    return this.offset === null ? null : this.offset + performance.now() * this.rate;
  }
}
