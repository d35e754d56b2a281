// The map of the safe operating envelope on a canvas: regions, contours, plan, probe.
import { h, rem, token } from '../parts/dom.js';
import { percent, wholeSpan } from '../parts/format.js';
import { pixelRatio, trace, write } from '../charts/paint.js';
import { contour, joined, planeOf, valueAt } from './plane.js';
import { ALARM_LIKELY } from '../forecast/verdict.js';

const TEMPERATURES = [30, 40, 50, 60, 70, 80, 90, 100, 110];
const MINUTES = [15, 30, 60, 120, 240];
const NEVER = 2; // beyond the horizon a time counts as twice the horizon, for the contours
const STEPS = [50, 100, 200, 250, 500, 1000, 2000, 2500, 5000, 10000, 20000, 50000];
const CELL = 3; // pixels: as fine as an edge is seen

export class EnvelopeMap {
  constructor(box, onProbe) {
    this.canvas = h('canvas', { tabindex: 0, role: 'application',
      'aria-label': 'Envelope map. Arrow keys move the probe, with Shift in large steps.',
      onpointerdown: (event) => this.point(event),
      onpointermove: (event) => event.buttons && this.point(event), onkeydown: (event) => this.key(event) });
    box.append(this.canvas);
    this.onProbe = onProbe;
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
  }

  destroy() {
    this.observer.disconnect();
  }

  /**
   * scene: { answer (of the service), maps (of one sensor), limits { warning, alarm } or null,
   * mode 'temperature' | 'time', probe, present, steps, safe (below this probability) }; points are
   * { speed, load }.
   */
  update(scene) {
    this.scene = scene;
    this.plane = planeOf(scene.answer);
    this.draw();
  }

  // -- where
  layout() {
    const size = rem();
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.pad = { left: size * 4.7, right: 14, top: 10, bottom: size * 2.9 };
    this.text = size * 0.875;
  }

  x(speed) {
    const { left, right } = this.pad;
    return left + speed / this.plane.high.speed * (this.width - left - right);
  }

  y(load) {
    const { top, bottom } = this.pad;
    return this.height - bottom - load / this.plane.high.load * (this.height - top - bottom);
  }

  point(event) {
    if (!this.plane) return;
    const box = this.canvas.getBoundingClientRect();
    const { left, right, top, bottom } = this.pad;
    const speed = (event.clientX - box.left - left) / (this.width - left - right);
    const load = (box.bottom - bottom - event.clientY) / (this.height - top - bottom);
    this.probe(speed * this.plane.high.speed, load * this.plane.high.load);
  }

  key(event) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const [right, up] = moves[event.key] ?? [];
    if (right === undefined || !this.scene) return;
    event.preventDefault();
    const by = event.shiftKey ? 500 : 100;
    this.probe(this.scene.probe.speed + right * by, this.scene.probe.load + up * by);
  }

  probe(speed, load) {
    const { low, high } = this.plane;
    const within = (value, name) => Math.min(high[name], Math.max(low[name], Math.round(value / 50) * 50));
    this.onProbe({ speed: within(speed, 'speed'), load: within(load, 'load') });
  }

  // -- drawing
  draw() {
    if (!this.scene || !this.canvas.isConnected) return;
    this.layout();
    if (this.width < 50 || this.height < 50) return;
    this.drawMap();
    const { width, height } = this.map;
    [this.canvas.width, this.canvas.height] = [width, height];
    this.context = this.canvas.getContext('2d');
    this.context.drawImage(this.map, 0, 0);
    this.scaled(this.context);
    this.drawPlan();
    this.drawProbe();
  }

  scaled(context) {
    context.setTransform(pixelRatio(), 0, 0, pixelRatio(), 0, 0);
    return context;
  }

  /** What stays while the probe moves is drawn once, on a canvas of its own. */
  drawMap() {
    const { answer, maps, mode, limits, safe } = this.scene;
    const look = [this.width, this.height, pixelRatio(), token('--panel'), mode,
      JSON.stringify([limits, safe, answer.made_at, answer.model_version])].join();
    if (look === this.mapLook && maps === this.drawnMaps) return;
    this.mapLook = look;
    this.drawnMaps = maps;
    this.map = document.createElement('canvas');
    this.map.width = Math.round(this.width * pixelRatio());
    this.map.height = Math.round(this.height * pixelRatio());
    this.context = this.scaled(this.map.getContext('2d'));
    this.drawGround();
    if (limits) this.drawRegions();
    this.drawAxes();
    this.drawContours();
    this.drawLowRisk();
  }

  drawGround() {
    const { high, low } = this.plane;
    const { context } = this;
    context.fillStyle = token('--panel-2');
    context.fillRect(this.x(low.speed), this.y(high.load), this.x(high.speed) - this.x(low.speed),
      this.y(low.load) - this.y(high.load));
  }

  region(test, styles) {
    const { context, plane: { low, high } } = this;
    const columns = Math.ceil((this.x(high.speed) - this.x(low.speed)) / CELL);
    const rows = Math.ceil((this.y(low.load) - this.y(high.load)) / CELL);
    const speed = (i) => low.speed + (high.speed - low.speed) * i / columns;
    const load = (j) => low.load + (high.load - low.load) * j / rows;
    context.beginPath();
    for (let j = 0; j < rows; j += 1) {
      let begun = -1;
      for (let i = 0; i <= columns; i += 1) {
        const inside = i < columns && test(speed(i + 0.5), load(j + 0.5));
        if (inside && begun < 0) begun = i;
        if (!inside && begun >= 0) {
          const [left, right] = [this.x(speed(begun)), this.x(speed(i))];
          const [top, base] = [this.y(load(j + 1)), this.y(load(j))];
          context.rect(left, top, right - left, base - top + 0.5);
          begun = -1;
        }
      }
    }
    for (const [style, alpha] of styles) {
      context.fillStyle = style;
      context.globalAlpha = alpha;
      context.fill();
    }
    context.globalAlpha = 1;
  }

  drawRegions() {
    const { warning, alarm } = this.scene.maps.limits;
    const over = (limit, speed, load) => valueAt(this.plane, limit.steady_probability, speed, load);
    const { safe } = this.scene;
    const red = (s, l) => over(warning, s, l) >= safe && over(alarm, s, l) >= ALARM_LIKELY;
    this.region((s, l) => over(warning, s, l) >= safe && !red(s, l), [[token('--p2'), 0.42]]);
    this.region(red, [[token('--p1'), 0.62]]);
  }

  drawAxes() {
    const { context, pad, plane: { high } } = this;
    const look = { size: this.text, colour: token('--ink-2') };
    const stepOf = (most) => STEPS.find((size) => size >= most / 7) ?? 100000;
    const places = (most, step) => Array.from({ length: Math.floor(most / step) + 1 }, (_, i) => i * step);
    const speeds = places(high.speed, stepOf(high.speed) * (this.width < 560 ? 2 : 1));
    const loads = places(high.load, stepOf(high.load));
    const [base, right] = [this.height - pad.bottom, this.width - pad.right];
    trace(context, { colour: token('--grid'), width: 1 },
      ...speeds.map((speed) => [[this.x(speed), pad.top], [this.x(speed), base]]),
      ...loads.map((load) => [[pad.left, this.y(load)], [right, this.y(load)]]));
    for (const speed of speeds) write(context, String(speed), this.x(speed), base + 7,
      { ...look, align: this.x(high.speed) - this.x(speed) < 20 ? 'right' : 'center', base: 'top' });
    for (const load of loads) {
      const y = this.y(load) + (this.y(load) - pad.top < 6 ? 6 : 0);
      write(context, String(load), pad.left - 8, y, { ...look, align: 'right', base: 'middle' });
    }
    write(context, 'Speed, rpm', (this.width + pad.left) / 2, this.height - 1, { ...look, align: 'center' });
    context.save();
    context.translate(this.text, this.height / 2);
    context.rotate(-Math.PI / 2);
    write(context, 'Load, N', 0, 4, { ...look, align: 'center' });
    context.restore();
  }

  drawContours() {
    const { scene: { maps, limits, mode, answer } } = this;
    if (mode === 'temperature') {
      const levels = TEMPERATURES.filter((level) =>
        !limits || Math.min(...Object.values(limits).map((own) => Math.abs(own - level))) > 3);
      for (const level of levels) this.line(maps.steady_c.q50, level, `${level} °C`, '');
      if (limits) {
        this.line(maps.steady_c.q50, limits.warning, `${limits.warning} °C`, 'p2');
        this.line(maps.steady_c.q50, limits.alarm, `${limits.alarm} °C`, 'p1');
        this.drawChances(maps.limits);
      }
      return;
    }
    const never = Math.log(NEVER * answer.horizon_s);
    const times = maps.limits.warning.median_s.map((row) =>
      row.map((second) => (second === null ? never : Math.log(Math.max(second, 60)))));
    MINUTES.forEach((minutes, place) =>
      this.line(times, Math.log(minutes * 60), wholeSpan(minutes * 60), 'time', place));
  }

  /** From where on a warning changes the word for a point, and an alarm its colour. */
  drawChances({ warning, alarm }) {
    const { safe } = this.scene;
    this.line(warning.steady_probability, safe, percent(safe), 'chance', -3);
    this.line(alarm.steady_probability, ALARM_LIKELY, `alarm ${percent(ALARM_LIKELY)}`, 'chance1', -5);
  }

  line(matrix, level, text, look, place = 0) {
    const { context, pad } = this;
    const lines = joined(contour(this.plane, matrix, level))
      .map((points) => points.map(([speed, load]) => [this.x(speed), this.y(load)]));
    const priority = { p1: 1, chance1: 1, p2: 2, chance: 2 }[look];
    const isLimit = look === 'p1' || look === 'p2';
    const colour = priority ? `--p${priority}-line` : look === 'time' ? '--ink' : '--ink-2';
    trace(context, { colour: token(colour), width: isLimit ? 3.5 : 1.6, dash: look === 'p2' ? [10, 6] : [] }, ...lines);
    const [base, left] = [this.y(this.plane.low.load), this.x(this.plane.low.speed)];
    const open = lines.flat().filter(([x, y]) => x > left + 24 && x < this.width - 60
      && y > pad.top + 16 && y < base - this.text * 2);
    if (!open.length) return;
    const wanted = this.width * 0.42 + this.height * 0.42 + place * 50;
    const far = ([x, y]) => Math.abs(x * 0.55 + y - wanted);
    const [x, y] = open.reduce((best, one) => (far(one) < far(best) ? one : best));
    write(context, text, x, y + this.text * 0.45, {
      size: this.text, strong: look !== '', align: 'center', base: 'alphabetic', halo: token('--panel'),
      colour: token(priority ? `--p${priority}-text` : '--ink'),
    });
  }

  drawLowRisk() {
    const { context, scene: { answer }, plane: { low } } = this;
    const { speed_rpm_max: speed, load_n_max: load } = answer.low_risk;
    context.strokeStyle = token('--twin');
    context.lineWidth = 2.5;
    context.strokeRect(this.x(low.speed), this.y(load), this.x(speed) - this.x(low.speed),
      this.y(low.load) - this.y(load));
    write(context, 'low-risk region', this.x(low.speed) + 8, this.y(low.load) - 6,
      { size: this.text, strong: true, colour: token('--twin'), ground: token('--panel-2') });
  }

  drawPlan() {
    const { context, scene: { present, steps } } = this;
    const ink = token('--ink');
    const way = [present, ...steps];
    context.strokeStyle = ink;
    context.lineWidth = 2.5;
    context.setLineDash([8, 6]);
    context.beginPath();
    way.forEach((step, i) => {
      const [x, y] = [this.x(step.speed), this.y(step.load)];
      if (i === 0) context.moveTo(x, y);
      else if (step.speed < way[i - 1].speed) {
        // The way back is an arc, so that it does not hide the way there.
        const middle = (this.x(way[i - 1].speed) + x) / 2;
        context.quadraticCurveTo(middle, Math.max(y, this.y(way[i - 1].load)) + rem() * 4, x, y);
      } else context.lineTo(x, y);
    });
    context.stroke();
    context.setLineDash([]);
    const circle = (x, y, radius, { fill = '', colour = '', width = 0 }) => {
      context.beginPath();
      context.arc(x, y, radius, 0, 2 * Math.PI);
      Object.assign(context, { fillStyle: fill, strokeStyle: colour, lineWidth: width });
      if (fill) context.fill();
      if (colour) context.stroke();
    };
    const ground = token('--panel');
    steps.forEach((step, i) => {
      const [x, y] = [this.x(step.speed), this.y(step.load)];
      circle(x, y, rem() * 0.82, { fill: ground, colour: ink, width: 2.5 });
      write(context, String(i + 1), x, y + 1,
        { size: this.text, strong: true, colour: ink, align: 'center', base: 'middle' });
    });
    const [x, y] = [this.x(present.speed), this.y(present.load)];
    circle(x, y, rem() * 0.8, { colour: ground, width: 7 });
    circle(x, y, rem() * 0.8, { colour: ink, width: 4 });
    circle(x, y, 4, { fill: ink });
    write(context, 'now', x - rem() * 1.2, y - rem() * 0.6,
      { size: this.text * 1.1, strong: true, colour: ink, align: 'right', ground });
  }

  drawProbe() {
    const { context, pad, scene: { probe } } = this;
    const [x, y] = [this.x(probe.speed), this.y(probe.load)];
    trace(context, { colour: token('--ink'), width: 1, dash: [2, 3] }, [[x, pad.top], [x, this.height - pad.bottom]],
      [[pad.left, y], [this.width - pad.right, y]]);
  }
}
