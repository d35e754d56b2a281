// Process time in the browser: set by the stream, extrapolated between its messages.
const MINIMUM_SPAN_MS = 2000;

export class ProcessClock {
  rate = 1;
  first = null; // { process, wall } of the first message of this connection
  offset = null; // process time at local time 0

  reset() {
    this.first = null;
    this.offset = null;
  }

  setRate(rate) {
    if (!(rate > 0) || rate === this.rate) return;
    const now = this.now();
    this.rate = rate;
    if (now !== null) this.offset = now - performance.now() * rate;
  }

  /** A message of process time `processMs`, sent at wall time `wallMs` of the service. */
  update(processMs, wallMs) {
    if (!Number.isFinite(processMs)) return;
    const local = performance.now();
    this.first ??= { process: processMs, wall: wallMs };
    const span = wallMs - this.first.wall;
    if (span > MINIMUM_SPAN_MS) {
      const measured = (processMs - this.first.process) / span;
      // The message times carry milliseconds of delay: only a real change of rate counts.
      if (Math.abs(measured / this.rate - 1) > 0.1 && measured > 0.5) {
        this.setRate(measured > 1.5 ? Math.round(measured) : 1);
      }
    }
    const offset = processMs - local * this.rate;
    // The least delayed message is the best; a late one corrects slowly, a jump at once.
    const jump = this.offset === null || Math.abs(offset - this.offset) > 5000 * this.rate;
    if (jump || offset > this.offset) this.offset = offset;
    else this.offset += 0.05 * (offset - this.offset);
  }

  now() {
    return this.offset === null ? null : this.offset + performance.now() * this.rate;
  }
}
