// The (speed, load) plane of the envelope: values between grid points, contours. Pure functions.

export const planeOf = ({ speed_rpm: speeds, load_n: loads }) => ({
  speeds, loads,
  low: { speed: speeds[0], load: loads[0] },
  high: { speed: speeds.at(-1), load: loads.at(-1) },
});

function place(axis, value) {
  const last = axis.length - 1;
  if (last === 0) return [0, 0, 0];
  const at = (value - axis[0]) / (axis[last] - axis[0]) * last;
  const below = Math.min(Math.max(Math.floor(at), 0), last - 1);
  return [below, below + 1, Math.min(Math.max(at - below, 0), 1)];
}

/** Value of a matrix (rows are loads, columns speeds) between its points; null if one is null. */
export function valueAt(plane, matrix, speed, load) {
  const [i, i1, a] = place(plane.speeds, speed);
  const [j, j1, b] = place(plane.loads, load);
  const corners = [matrix[j][i], matrix[j][i1], matrix[j1][i], matrix[j1][i1]];
  if (corners.some((value) => value === null)) return null;
  const [p, q, r, t] = corners;
  return (p * (1 - a) + q * a) * (1 - b) + (r * (1 - a) + t * a) * b;
}

/** The grid point nearest to a point: [row, column] of the matrices. */
function nearest(plane, speed, load) {
  const [i, i1, a] = place(plane.speeds, speed);
  const [j, j1, b] = place(plane.loads, load);
  return [b < 0.5 ? j : j1, a < 0.5 ? i : i1];
}

export function nearestAt(plane, matrix, speed, load) {
  const [row, column] = nearest(plane, speed, load);
  return matrix[row][column];
}

/**
 * How probably a sensor is at or over a limit at a point { speed, load }: certain at `present`,
 * { speed, load, reading }, where it reads so now, whatever the map shows; else as the map has it.
 */
export function chanceAt(plane, map, { speed, load }, present) {
  const [here, there] = [nearest(plane, speed, load), nearest(plane, present.speed, present.load)];
  const isHere = here[0] === there[0] && here[1] === there[1];
  return isHere && present.reading !== null && present.reading >= map.limit_c ? 1
    : valueAt(plane, map.steady_probability, speed, load);
}

/**
 * Segments [[speed, load], [speed, load]] of the line at which a matrix crosses a level
 * (marching squares on a grid made finer). Cells next to a null have none.
 */
export function contour(plane, matrix, level, fine = 60) {
  const { low, high } = plane;
  const speed = (i) => low.speed + (high.speed - low.speed) * i / fine;
  const load = (j) => low.load + (high.load - low.load) * j / fine;
  const values = Array.from({ length: fine + 1 }, (_, j) =>
    Array.from({ length: fine + 1 }, (__, i) => valueAt(plane, matrix, speed(i), load(j))));
  const segments = [];
  for (let j = 0; j < fine; j += 1) {
    for (let i = 0; i < fine; i += 1) {
      const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
      const around = corners.map(([x, y]) => values[y][x]);
      if (around.some((value) => value === null)) continue;
      const ends = [];
      for (let k = 0; k < 4; k += 1) {
        const [from, to] = [around[k], around[(k + 1) % 4]];
        if ((from > level) === (to > level)) continue;
        const share = (level - from) / (to - from);
        const [[x0, y0], [x1, y1]] = [corners[k], corners[(k + 1) % 4]];
        ends.push([speed(x0 + share * (x1 - x0)), load(y0 + share * (y1 - y0))]);
      }
      for (let k = 0; k + 1 < ends.length; k += 2) segments.push([ends[k], ends[k + 1]]);
    }
  }
  return segments;
}

const keyOf = ([speed, load]) => `${speed.toFixed(6)} ${load.toFixed(6)}`;

/** Segments that share an end, joined to lines [[point, point, …], …]: a dash runs on along them. */
export function joined(segments) {
  const ends = new Map(); // where a segment begins or ends -> the segments there
  segments.forEach((segment, number) => segment.forEach((point) => {
    const key = keyOf(point);
    ends.set(key, [...(ends.get(key) ?? []), number]);
  }));
  const taken = new Set();
  const follow = (from) => {
    const points = [];
    let at = from;
    for (;;) {
      const next = ends.get(keyOf(at)).find((number) => !taken.has(number));
      if (next === undefined) return points;
      taken.add(next);
      const [one, other] = segments[next];
      at = keyOf(one) === keyOf(at) ? other : one;
      points.push(at);
    }
  };
  const lines = [];
  segments.forEach(([one, other], number) => {
    if (taken.has(number)) return;
    taken.add(number);
    lines.push([...follow(one).reverse(), one, other, ...follow(other)]);
  });
  return lines;
}
