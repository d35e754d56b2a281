// From the store to what the views draw: readings, what lies ahead, the service's answers.
import { isStanding } from '../alarms/alarm.js';
import { OPERATION } from '../parts/channels.js';
import { distinctSteps, fanFrom, stepsFrom, timeToLimit } from '../forecast/forecast.js';
import { ageText, milliseconds } from '../parts/format.js';
import { currentVerdict, missingChannels, missingText } from './verdict.js';
import { chartSensors, limitedReadings, readChannel } from './readings.js';

export const LOADING = 'loading the forecast';
export const NEVER_IDENTIFIED = 'the model was never identified';
const OLDEST_FORECAST_S = 900;
const OLDEST_FORECAST_WALL_S = 30;
const COLD_C = 20;

function whyNoForecast(state, clock, fan, missing) {
  if (!state.loaded && !state.forecast) return LOADING;
  if (!state.asset?.active_model) return 'no model yet';
  if (state.asset.active_model.trusted === false) return 'the model is not trusted';
  if (!state.asset.active_model.identified) return NEVER_IDENTIFIED;
  // Without the operation the twin holds what it knew last: no forecast of what is happening.
  const blind = missing.filter((name) => OPERATION.includes(name));
  if (blind.length) return missingText(state, clock, blind);
  if (!state.forecast) return 'the twin waits for its first data';
  const ageS = (clock.now() - milliseconds(state.forecast.made_at)) / 1000;
  if (ageS > Math.max(OLDEST_FORECAST_S, OLDEST_FORECAST_WALL_S * clock.rate)) {
    return `the last forecast is ${ageText(ageS)} old`;
  }
  return fan ? null : 'the last forecast has expired';
}

/** The median crossings that lie ahead, for the chart: [{ timeMs, value, priority }]. */
export function crossingsAhead(forecast, fan, limits, nowMs) {
  if (!fan) return [];
  return Object.entries(limits).flatMap(([sensor, own]) =>
    [['warning', 2], ['alarm', 1]].flatMap(([level, priority]) => {
      const { median } = timeToLimit(forecast, sensor, level, nowMs);
      const ahead = median !== null && median > 0 && fan.bands[sensor]?.q50[0] < own[level];
      return ahead ? [{ timeMs: nowMs + median * 1000, value: own[level], priority }] : [];
    }));
}

/**
 * The temperature that is shown next to the word for now: the one that the verdict is about, else
 * one that is lost, else the one that has come furthest from a cold machine to its own warning.
 */
function shownReading(readings, { limit }) {
  const nearness = ({ value, limits }) => (value - COLD_C) / (limits.warning - COLD_C);
  return readings.find((one) => one.sensor === limit?.channel) ?? readings.find((one) => !one.usable)
    ?? readings.toSorted((a, b) => nearness(b) - nearness(a))[0] ?? null;
}

function standingPriority(alarms) {
  const standing = [...alarms.values()].filter(isStanding).map((alarm) => alarm.priority);
  return standing.length ? Math.min(...standing) : null;
}

/** Everything that the operator's screen shows at this moment; null before the first data. */
export function situation(state, clock) {
  const nowMs = clock.now();
  if (!state.asset || nowMs === null) return null;
  const live = state.link.status === 'live';
  const verdict = currentVerdict(state);
  const readings = limitedReadings(state, clock);
  const { limits } = state.asset;
  const names = [...new Set([...chartSensors(state.asset), ...Object.keys(limits)])];
  const wholeFan = fanFrom(state.forecast, nowMs, names);
  const noForecast = whyNoForecast(state, clock, wholeFan, verdict.missing);
  const fan = noForecast || !live ? null : wholeFan;
  const steps = distinctSteps(stepsFrom(state.forecast, nowMs));
  const lost = readings.filter((reading) => !reading.usable);
  return {
    nowMs, live, readings, limits, fan, noForecast, verdict,
    forecast: fan && state.forecast,
    speed: readChannel(state, clock, 'speed_rpm'),
    load: readChannel(state, clock, 'load_n'),
    missing: verdict.missing,
    missingText: missingText(state, clock, verdict.missing) || verdict.now.reasons[0],
    lostChannels: missingChannels(verdict.missing),
    lostText: missingText(state, clock, missingChannels(verdict.missing)),
    planned: state.forecast?.planned !== false,
    steps: fan || (live && noForecast === NEVER_IDENTIFIED) ? steps : [], // a plan needs no model
    endMs: wholeFan?.times.at(-1) ?? null,
    crossings: crossingsAhead(state.forecast, fan, limits, nowMs),
    lostMs: lost.length ? Math.min(...lost.map((reading) => reading.timeMs ?? nowMs)) : null,
    alone: lost.length > 0 && lost.length === readings.length,
    reading: shownReading(readings, verdict.now),
    standing: standingPriority(state.alarms),
  };
}

/** What forecast and sensors say this moment about the subject of an alarm. */
export const liveDetail = (state, clock) => ({
  nowMs: clock.now(),
  value(channel) {
    const reading = readChannel(state, clock, channel);
    return reading.usable ? reading.value : null;
  },
  crossing(channel, level) {
    if (!state.forecast?.time_to_limit?.[channel]?.[level] || clock.now() === null) return null;
    return timeToLimit(state.forecast, channel, level, clock.now());
  },
});
