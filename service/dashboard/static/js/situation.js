// From the store to what the views draw: readings, what lies ahead, the three answers.
import { distinctSteps, fanFrom, stepsFrom, timeToLimit } from './forecast.js';
import { ageText, milliseconds } from './format.js';
import { limitedReadings, readChannel } from './readings.js';
import { chartSensors } from './sensors.js';
import { answerNextStep, answerNow, answerTimeToLimit } from './verdict.js';

export const LOADING = 'asking for the forecast';

const OLDEST_FORECAST_S = 900;
const OLDEST_FORECAST_WALL_S = 30;

/** Why there is no forecast to be shown, or null when there is one. */
function whyNoForecast(state, clock, fan) {
  if (!state.loaded && !state.forecast) return LOADING;
  if (!state.asset?.active_model) return 'there is no model yet';
  if (state.asset.active_model.trusted === false) return 'the model is not trusted';
  if (!state.forecast) return 'the twin waits for its first data';
  const ageS = (clock.now() - milliseconds(state.forecast.made_at)) / 1000;
  if (ageS > Math.max(OLDEST_FORECAST_S, OLDEST_FORECAST_WALL_S * clock.rate)) {
    return `the last one is ${ageText(ageS)} old`;
  }
  return fan ? null : 'the last one has run out';
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

/** Everything that the operator's screen shows at this moment; null before the first data. */
export function situation(state, clock) {
  const nowMs = clock.now();
  if (!state.asset || nowMs === null) return null;
  const live = state.link.status === 'live';
  const readings = limitedReadings(state, clock);
  const { limits } = state.asset;
  const names = [...new Set([...chartSensors(state.asset), ...Object.keys(limits)])];
  const wholeFan = fanFrom(state.forecast, nowMs, names);
  const noForecast = whyNoForecast(state, clock, wholeFan);
  const fan = noForecast || !live ? null : wholeFan;
  const steps = distinctSteps(stepsFrom(state.forecast, nowMs));
  const speed = readChannel(state, clock, 'speed_rpm');
  const lost = readings.filter((reading) => !reading.usable);
  return {
    nowMs, live, readings, limits, fan, noForecast, speed,
    planned: state.forecast?.planned !== false,
    steps: fan ? steps : [],
    endMs: wholeFan?.times.at(-1) ?? null,
    crossings: crossingsAhead(state.forecast, fan, limits, nowMs),
    load: readChannel(state, clock, 'load_n'),
    lostMs: lost.length ? Math.min(...lost.map((reading) => reading.timeMs ?? nowMs)) : null,
    alone: lost.length > 0 && lost.length === readings.length,
    now: answerNow({
      readings, speedRpm: speed.usable ? speed.value : null,
      trusted: state.asset.active_model?.trusted !== false,
    }),
    next: answerNextStep({ forecast: state.forecast, fan, steps, limits, nowMs }),
    toLimit: answerTimeToLimit({ forecast: state.forecast, fan, readings, limits, nowMs }),
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
