// The service's verdict on one asset, as the page shows it: its four words, and what is missing.
// Whether it is safe is judged by the service alone; the page only finds figures to show with it.
import { ageText, lowerName } from '../parts/format.js';
import { ageMs } from './age.js';
import { readChannel } from './readings.js';

// The service sends one every 5 s at least: one may be late on a line that is otherwise heard.
const OLDEST_MS = 10000;
const WHY = {
  twin: 'the twin does not run',
  limits: 'no temperature has a limit',
  'identified model': 'the model was never identified',
  forecast: 'there is no recent forecast',
};
/** Of what is missing, that which makes no measured value doubtful. */
const OF_THE_MODEL = ['identified model', 'forecast'];
const unknown = (reason) => ({ word: 'unknown', reasons: [reason], limit: null, probability: null });
const withoutWord = (reason) => ({
  now: unknown(reason), present_step: unknown(reason), next_step: unknown(reason),
  time_to_limit: null, missing: [],
});

export function currentVerdict({ link, verdict }) {
  if (link.status !== 'live') return withoutWord('the service does not answer');
  if (!verdict) return withoutWord('loading');
  return ageMs(verdict.heard) > OLDEST_MS ? withoutWord('no verdict from the service') : verdict;
}

export const missingChannels = (missing) => missing.filter((name) => !Object.hasOwn(WHY, name));

/** Whether only the model keeps a verdict from being known, and no measured value. */
export const lacksModelOnly = (missing) =>
  missing.length > 0 && missing.every((name) => OF_THE_MODEL.includes(name));

export const listed = (names) => [names.slice(0, -1).join(', '), names.at(-1)].filter(Boolean).join(' and ');

/** What is missing, in words and without its age: "speed and load lost". */
export function missingNames(missing) {
  const names = missingChannels(missing).map(lowerName);
  return joinedTexts([names.length && `${listed(names)} lost`], missing);
}

/** Texts about channels, and what else is missing. */
const joinedTexts = (texts, missing) => [...texts,
  ...missing.filter((name) => Object.hasOwn(WHY, name)).map((name) => WHY[name])].filter(Boolean).join('; ');

/** What is missing, in words: "speed and load lost for 1 min 02 s". */
export function missingText(state, clock, missing) {
  // Without its inputs there is no forecast either.
  const causes = missing.length > 1 ? missing.filter((name) => name !== 'forecast') : missing;
  const readings = missingChannels(causes).map((name) => readChannel(state, clock, name));
  const lost = readings.filter((reading) => reading.ageS !== null);
  const never = readings.filter((reading) => reading.ageS === null);
  const names = (some) => listed(some.map((reading) => lowerName(reading.name)));
  return joinedTexts([lost.length && `${names(lost)} lost for ${ageText(Math.max(...lost.map((one) => one.ageS)))}`,
    never.length && `no value yet for ${names(never)}`], causes);
}
