// Questions to the twin: the latest of many, and the highest speed of a step at which a limit is still improbable.
const COARSE_S = 120; // the answer needs a probability only, not a fine line
const PARTS = 8;

function worstWarning(answer) {
  const all = Object.entries(answer.time_to_limit).map(([sensor, levels]) => ({
    sensor, probability: levels.warning.probability, limit: answer.limits[sensor].warning,
  }));
  return all.toSorted((a, b) => b.probability - a.probability)[0] ?? null;
}

/**
 * From the highest speed down to the first that is allowed (a machine that creeps is forecast worse
 * than one that runs slowly), then halve the interval above it to one slider step.
 *
 * profileAt(speed): the profile to the end of the step; allowed is a probability below `safe`. Gives
 * { speed (null: none), limit, sensor, open (even the highest) }; null where there are no limits.
 */
export async function highestSpeed({ ask, profileAt, low, high, step, safe }) {
  const chanceAt = async (number) => worstWarning(await ask(profileAt(number * step), COARSE_S));
  const allowed = (worst) => worst.probability < safe;
  const [lowest, top] = [Math.ceil(low / step), Math.floor(high / step)];
  let [bad, worst] = [null, null];
  for (let part = PARTS; part >= 0; part -= 1) {
    let good = lowest + Math.round((top - lowest) * part / PARTS);
    const found = await chanceAt(good);
    if (!found) return null;
    if (!allowed(found)) {
      [bad, worst] = [good, found];
      continue;
    }
    if (bad === null) return { ...found, speed: good * step, open: true };
    while (bad - good > 1) {
      const middle = Math.floor((good + bad) / 2);
      const between = await chanceAt(middle);
      if (allowed(between)) good = middle;
      else [bad, worst] = [middle, between];
    }
    return { ...worst, speed: good * step, open: false };
  }
  return { ...worst, speed: null, open: false };
}

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
