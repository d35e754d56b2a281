// What lies ahead, cut at the present moment. Pure functions over the forecast's JSON.
import { milliseconds } from '../parts/format.js';

export const QUANTILES = ['q025', 'q25', 'q50', 'q75', 'q975'];
const between = (a, b, share) => a + (b - a) * share;

/**
 * The fan from `nowMs` on: { times (ms), bands: { name: { q025: [], …, whole } } }, with the first
 * point exactly at now; `whole` is { low: [], high: [] } of the whole run, null for a node. Null
 * when nothing of the forecast is left.
 */
export function fanFrom(forecast, nowMs, names) {
  if (!forecast) return null;
  const start = milliseconds(forecast.made_at);
  const times = forecast.time_s.map((second) => start + second * 1000);
  const known = usableLength(forecast, names);
  times.length = known;
  const next = times.findIndex((time) => time > nowMs);
  if (next < 0) return null;
  const share = next ? (nowMs - times[next - 1]) / (times[next] - times[next - 1]) : 0;
  const cut = (values) => [
    next ? between(values[next - 1], values[next], share) : values[0],
    ...values.slice(next, known),
  ];
  const bands = {};
  for (const name of names.filter((one) => forecast.nodes[one])) {
    bands[name] = {};
    for (const quantile of QUANTILES) bands[name][quantile] = cut(forecast.nodes[name][quantile]);
    const factors = forecast.whole_run?.factors[name];
    bands[name].whole = factors ? wholeRun(bands[name], cut(factors)) : null;
  }
  return { times: [nowMs, ...times.slice(next)], bands };
}

const wholeRun = ({ q025, q50, q975 }, factors) => ({
  low: q50.map((value, i) => value - factors[i] * (value - q025[i])),
  high: q50.map((value, i) => value + factors[i] * (q975[i] - value)),
});

/** A fan whose outer band is that of the whole run, and that says so; it has no inner one. */
export function ofWholeRun(fan) {
  const bands = Object.entries(fan.bands).map(([name, band]) => [name, band.whole
    ? { ...band, q025: band.whole.low, q25: band.q50, q75: band.q50, q975: band.whole.high } : band]);
  return { ...fan, stated: '90 % whole run', bands: Object.fromEntries(bands) };
}

/** Rows before the first one that has no figures (a model that ran away). */
function usableLength(forecast, names) {
  const holes = names.filter((name) => forecast.nodes[name])
    .flatMap((name) => QUANTILES.map((quantile) => forecast.nodes[name][quantile].indexOf(null)));
  return Math.min(forecast.time_s.length, ...holes.filter((index) => index >= 0));
}

/**
 * The steps ahead: [{ from, to (ms), speed_rpm, load_n, duration_s }], the first one under way.
 * `duration_s` is the whole of a coming step and what is left of the present one.
 */
export function stepsFrom(forecast, nowMs) {
  const steps = [];
  let from = milliseconds(forecast?.made_at);
  for (const step of forecast?.profile ?? []) {
    const to = from + step.duration_s * 1000;
    if (to > nowMs) {
      const begin = Math.max(from, nowMs);
      const { speed_rpm, load_n } = step;
      steps.push({ from: begin, to, speed_rpm, load_n, duration_s: (to - begin) / 1000 });
    }
    from = to;
  }
  return steps;
}

export function distinctSteps(steps) {
  const merged = [];
  for (const step of steps) {
    const last = merged.at(-1);
    const same = last && Math.abs(last.speed_rpm - step.speed_rpm) < 1
      && Math.abs(last.load_n - step.load_n) < 1;
    if (same) {
      last.to = step.to;
      last.duration_s += step.duration_s;
    } else {
      merged.push({ ...step });
    }
  }
  return merged;
}

/** Places of a fan within a span. */
const placesIn = ({ times }, fromMs, toMs) => times.map((_, i) => i)
  .filter((i) => times[i] >= fromMs && times[i] <= toMs);

/** The highest median of a fan, or of a span of it, and the highest edges of its 95 % band. */
export function overSpan(fan, name, fromMs = -Infinity, toMs = Infinity) {
  const inside = placesIn(fan, fromMs, toMs);
  const most = (quantile) => Math.max(...inside.map((i) => fan.bands[name][quantile][i]));
  return { median: most('q50'), low: most('q025'), high: most('q975') };
}

const LET_RISE_K = 0.5; // of the upper bound, above which a span does not count as cooling

/**
 * A span that begins with the median over the warning limit, brings it below and makes nothing
 * worse: { fromC, belowMs, surelyMs } with the times from which the median and the 97.5 % bound
 * stay below (the latter null when not within the span). Null for any other span.
 */
export function coolsBelow(fan, name, limit, fromMs = -Infinity, toMs = Infinity) {
  const { q50, q975 } = fan.bands[name];
  const inside = placesIn(fan, fromMs, toMs);
  const [first] = inside;
  if (inside.length < 2 || q50[first] < limit) return null;
  const rise = Math.max(...inside.map((i) => q975[i])) - q975[first];
  const belowMs = staysBelow(fan.times, q50, limit, inside);
  if (rise > LET_RISE_K || belowMs === null) return null;
  return { fromC: q50[first], belowMs, surelyMs: staysBelow(fan.times, q975, limit, inside) };
}

/** When values that begin above a limit are below it for good, null if they are not at the end. */
function staysBelow(times, values, limit, inside) {
  const last = inside.findLast((i) => values[i] >= limit);
  if (last === undefined) return times[inside[0]];
  if (last === inside.at(-1)) return null;
  const share = (values[last] - limit) / (values[last] - values[last + 1]);
  return between(times[last], times[last + 1], share);
}

/** Time to a limit counted from now: { probability, median, earliest } in seconds or null. */
export function timeToLimit(forecast, name, level, nowMs) {
  const crossing = forecast?.time_to_limit?.[name]?.[level];
  if (!crossing) return { probability: 0, median: null, earliest: null };
  const elapsedS = (nowMs - milliseconds(forecast.made_at)) / 1000;
  const left = (second) => (Number.isFinite(second) ? Math.max(0, second - elapsedS) : null);
  return {
    probability: crossing.probability, median: left(crossing.median_s), earliest: left(crossing.earliest_s),
  };
}
