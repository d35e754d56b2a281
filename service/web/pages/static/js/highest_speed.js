// The highest speed of one step at which a limit is still improbable: found by asking the twin.
import { THRESHOLDS } from './verdict.js';

const COARSE_S = 120; // the answer needs a probability only, not a fine line
const PARTS = 8;

/** The likeliest warning of an answer: { probability, limit, sensor }. */
function worstWarning(answer) {
  const all = Object.entries(answer.time_to_limit).map(([sensor, levels]) => ({
    sensor, probability: levels.warning.probability, limit: answer.limits[sensor].warning,
  }));
  return all.toSorted((a, b) => b.probability - a.probability)[0] ?? null;
}

/**
 * From the highest speed down to the first that is allowed, then halve the interval above it until
 * the speed is known to one slider step. (From below it could not be found: a machine that stands
 * or creeps is forecast worse than one that runs slowly.)
 *
 * ask(profile, step_s) gives an answer of the service; profileAt(speed) the profile up to the end
 * of the step in question. Gives { speed, limit, sensor, open } where `open` says that even the
 * highest speed is allowed, `speed` is null where none is; null where there are no limits.
 */
export async function highestSpeed({ ask, profileAt, low, high, step }) {
  const chanceAt = async (number) => worstWarning(await ask(profileAt(number * step), COARSE_S));
  const allowed = (worst) => worst.probability < THRESHOLDS.atRisk;
  const [lowest, top] = [Math.ceil(low / step), Math.floor(high / step)];
  let bad = null;
  let worst = null;
  for (let part = PARTS; part >= 0; part -= 1) {
    const number = lowest + Math.round((top - lowest) * part / PARTS);
    const found = await chanceAt(number);
    if (!found) return null;
    if (allowed(found)) {
      if (bad === null) return { ...found, speed: number * step, open: true };
      let good = number;
      while (bad - good > 1) {
        const middle = Math.floor((good + bad) / 2);
        const between = await chanceAt(middle);
        if (allowed(between)) good = middle;
        else [bad, worst] = [middle, between];
      }
      return { ...worst, speed: good * step, open: false };
    }
    [bad, worst] = [number, found];
  }
  return { ...worst, speed: null, open: false };
}
