// A small line of the past and of what lies ahead, for tiles without room for axes.
import { put, s } from './dom.js';
import { isNumber } from './format.js';

const WIDTH = 100;
const HEIGHT = 30;
const SPARE_K = 2;
const LEAST_SPAN_K = 12; // noise of a tenth of a kelvin is no mountain

/** Path through [time, value] points; a null value breaks the line. */
function path(points, x, y) {
  let pen = 'M';
  return points.map(([time, value]) => {
    if (value === undefined) return '';
    if (value === null) {
      pen = 'M';
      return '';
    }
    const command = `${pen}${x(time).toFixed(1)} ${y(value).toFixed(1)}`;
    pen = 'L';
    return command;
  }).join('');
}

/**
 * Draw into `svg`. past, ahead: [[time, value], …]; span: { fromMs, nowMs, endMs }; limits of the
 * sensor are drawn where they lie within the range of the values.
 */
export function drawSparkline(svg, { past, ahead, span, limits }) {
  const values = [...past, ...ahead].map(([, value]) => value).filter(isNumber);
  svg.setAttribute('viewBox', `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute('preserveAspectRatio', 'none');
  if (!values.length) {
    put(svg);
    return;
  }
  const [least, greatest] = [Math.min(...values), Math.max(...values)];
  const spare = Math.max(SPARE_K, (LEAST_SPAN_K - (greatest - least)) / 2);
  const [low, high] = [least - spare, greatest + spare];
  const x = (time) => (time - span.fromMs) / (span.endMs - span.fromMs) * WIDTH;
  const y = (value) => HEIGHT - (value - low) / (high - low) * HEIGHT;
  const line = (name, points) => s('path', { class: name, d: path(points, x, y) });
  const level = (value, name) => value > low && value < high
    && s('path', { class: name, d: `M0 ${y(value)}H${WIDTH}` });
  put(svg, level(limits?.warning, 'lw'), level(limits?.alarm, 'la'),
    s('path', { class: 'now', d: `M${x(span.nowMs)} 0V${HEIGHT}` }),
    line('past', past), line('ahead', ahead));
}

export const createSparkline = () => s('svg', { class: 'spark', 'aria-hidden': 'true' });
