// Asking a service that answers more slowly than questions come: the latest question wins.
const BUSY_STATUS = 429;
const BUSY_WAIT_MS = 1000;

/**
 * One question at a time is on its way. Of those that come meanwhile only the latest is asked
 * next, so that every answer that is shown is younger than the one before.
 */
export class LatestQuestion {
  /**
   * ask(question, signal) gives a promise; answered(answer, question, ms) and failed(error) are
   * called with what came of it, ms being how long the answer took.
   */
  constructor({ ask, answered, failed }) {
    this.parts = { ask, answered, failed };
    this.waiting = null;
    this.running = null;
  }

  put(question) {
    this.waiting = { question };
    if (!this.running) this.run();
  }

  /** Forget what is on its way. */
  stop() {
    this.waiting = null;
    this.running?.abort();
  }

  async run() {
    const { ask, answered, failed } = this.parts;
    const running = new AbortController();
    this.running = running;
    while (this.waiting) {
      const { question } = this.waiting;
      this.waiting = null;
      const begunMs = performance.now();
      try {
        const answer = await ask(question, running.signal);
        answered(answer, question, performance.now() - begunMs);
      } catch (error) {
        if (running.signal.aborted) break;
        if (error.status === BUSY_STATUS) {
          this.waiting ??= { question };
          await new Promise((resolve) => setTimeout(resolve, BUSY_WAIT_MS));
        } else {
          failed(error);
        }
      }
    }
    if (this.running === running) this.running = null;
    if (this.waiting && !this.running) this.run();
  }
}
