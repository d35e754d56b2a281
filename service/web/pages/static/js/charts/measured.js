// What the store answers about a span of the past, made ready for charts.
import { assetPath, callPages } from '../app/api.js';
import { highestOf, isNumber, lowestOf, milliseconds } from '../parts/format.js';
import { GOOD } from '../live/readings.js';

export const EMPTY_LINE = { times: [], values: [], low: [], high: [], gaps: [] };
const GAP = 5; // a line is broken where this many usual distances lie between two rows

const BUCKET_S = { s: 1, min: 60, h: 3600, d: 86400 };

/** Length of a bucket in ms from its name (15s, 1min, 2h, 1d); null for raw samples. */
export function bucketMs(resolution) {
  const [, number, name] = /^(\d+)(s|min|h|d)$/.exec(resolution) ?? [];
  return number ? Number(number) * BUCKET_S[name] * 1000 : null;
}

/**
 * The lines of channels over a span: { lines, resolution, count }; page: of the application, query: of
 * the measurements.
 */
export async function fetchLines({ live, clock }, query, bridgeWallMs, signal = undefined) {
  let resolution = '';
  const items = await callPages(assetPath(live.assetId, '/measurements'), query,
    (answer) => { resolution = answer.resolution; }, signal);
  return { lines: byChannel(items, resolution, bridgeWallMs * clock.rate), resolution, count: items.length };
}

/**
 * Rows of `GET measurements` by channel: { channel: { times, values, low, high, gaps } }.
 *
 * Times are ms, those of buckets their middle. A hole in the data longer than `bridgeMs` is a null
 * between two times, and `gaps` lists [from, to, why].
 */
export function byChannel(items, resolution, bridgeMs = 0) {
  const bucket = bucketMs(resolution);
  return Object.fromEntries([...Map.groupBy(items, ({ channel }) => channel)]
    .map(([name, rows]) => [name, lineOf(rows, bucket, bridgeMs)]));
}

function lineOf(rows, bucket, bridgeMs) {
  const starts = rows.map((row) => milliseconds(row.time));
  const usual = Math.max(bucket ?? 0, median(starts.slice(1).map((time, i) => time - starts[i])));
  const most = Math.max(bridgeMs, usual * (usual === bucket ? 1.5 : GAP));
  const line = { times: [], values: [], low: [], high: [], gaps: [] };
  const add = (time, value, low, high) => {
    line.times.push(time);
    line.values.push(value);
    line.low.push(low);
    line.high.push(high);
  };
  let bad = null; // [from, why]
  rows.forEach((row, i) => {
    const start = starts[i];
    const value = bucket ? row.mean : row.value;
    const good = row.quality >= GOOD && isNumber(value);
    const before = starts[i - 1];
    if (i && start - before > most) {
      const end = before + (bucket ?? 0);
      add(end + (start - end) / 2, null, null, null);
      line.gaps.push([end, start, 'no data']);
    }
    if (good && bad) line.gaps.push([bad[0], start, bad[1]]);
    if (good) bad = null;
    else bad ??= [start, row.quality < 64 ? 'bad' : 'uncertain'];
    const at = start + (bucket ?? 0) / 2;
    // An uncertain value is shown in its hatching, a bad one never.
    const shown = isNumber(value) && row.quality >= 64 ? value : null;
    if (bucket && shown !== null) add(at, shown, row.min, row.max);
    else add(at, shown, shown, shown);
  });
  if (bad) line.gaps.push([bad[0], starts.at(-1) + (bucket ?? usual), bad[1]]);
  return line;
}

function median(values) {
  if (!values.length) return 1000;
  return values.toSorted((a, b) => a - b)[Math.floor(values.length / 2)];
}

/**
 * Lines on one common axis, as uPlot wants them: [seconds, values, low, high, values, …].
 * A time that only another line has is undefined, which is no hole.
 */
export function joined(lines) {
  const times = [...new Set(lines.flatMap((line) => line.times))].sort((a, b) => a - b);
  const places = new Map(times.map((time, i) => [time, i]));
  const columns = lines.flatMap((line) => [line.values, line.low, line.high].map((values) => {
    const column = Array(times.length).fill(undefined);
    line.times.forEach((time, i) => { column[places.get(time)] = values[i]; });
    return column;
  }));
  return [times.map((time) => time / 1000), ...columns];
}

export function extremes(line) {
  const values = line.values.filter(isNumber);
  if (!values.length) return null;
  return {
    low: lowestOf(line.low), high: highestOf(line.high),
    mean: values.reduce((sum, value) => sum + value, 0) / values.length,
  };
}
