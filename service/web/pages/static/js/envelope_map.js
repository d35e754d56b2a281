// The map of the safe operating envelope on a canvas: regions, contours, plan, probe.
import { rem, token } from './dom.js';
import { wholeSpan } from './format.js';
import { hatching, pixelRatio, write } from './paint.js';
import { contour, joined, planeOf, valueAt } from './plane.js';
import { THRESHOLDS } from './verdict.js';

const TEMPERATURES = [30, 40, 50, 60, 70, 80, 90, 100, 110];
const MINUTES = [15, 30, 60, 120, 240];
const NEVER = 2; // beyond the horizon a time counts as twice the horizon, for the contours
const CELL = 3; // pixels: as fine as an edge is seen

export class EnvelopeMap {
  /** onProbe({ speed, load }) is called when the user points somewhere. */
  constructor(box, onProbe) {
    this.canvas = document.createElement('canvas');
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute('role', 'application');
    this.canvas.setAttribute('aria-label',
      'Envelope map. Arrow keys move the probe, with Shift in large steps.');
    box.append(this.canvas);
    this.onProbe = onProbe;
    this.canvas.addEventListener('pointerdown', (event) => this.point(event));
    this.canvas.addEventListener('pointermove', (event) => event.buttons && this.point(event));
    this.canvas.addEventListener('keydown', (event) => this.key(event));
    this.observer = new ResizeObserver(() => this.draw());
    this.observer.observe(this.canvas);
  }

  destroy() {
    this.observer.disconnect();
  }

  /**
   * scene: { answer (of the service), maps (of one sensor), limits { warning, alarm } or null,
   * mode 'temperature' | 'time', probe, present, steps }; points are { speed, load }.
   */
  update(scene) {
    this.scene = scene;
    this.plane = planeOf(scene.answer);
    this.draw();
  }

  // ---------------------------------------------------------------- where
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
    const move = moves[event.key];
    if (!move || !this.scene) return;
    event.preventDefault();
    const by = event.shiftKey ? 500 : 100;
    this.probe(this.scene.probe.speed + move[0] * by, this.scene.probe.load + move[1] * by);
  }

  probe(speed, load) {
    const within = (value, low, high) =>
      Math.min(high, Math.max(low, Math.round(value / 50) * 50));
    const { low, high } = this.plane;
    this.onProbe({
      speed: within(speed, low.speed, high.speed), load: within(load, low.load, high.load),
    });
  }

  // ---------------------------------------------------------------- drawing
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
    const { answer, maps, mode, limits } = this.scene;
    const look = [this.width, this.height, pixelRatio(), token('--panel'), mode,
      JSON.stringify([limits, answer.made_at, answer.model_version])].join();
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

  /** Fill wherever `test(speed, load)` holds. */
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
    const { atRisk, notSafe } = THRESHOLDS;
    const amber = token('--p2');
    const unsure = (s, l) => over(warning, s, l) >= atRisk && over(warning, s, l) < notSafe;
    this.region(unsure, [[amber, 0.14], [hatching(this.context, amber), 0.42]]);
    this.region((s, l) => over(warning, s, l) >= notSafe && over(alarm, s, l) < notSafe,
      [[amber, 0.42]]);
    this.region((s, l) => over(alarm, s, l) >= notSafe, [[token('--p1'), 0.62]]);
  }

  drawAxes() {
    const { context, pad, plane: { high } } = this;
    const look = { size: this.text, colour: token('--ink-2') };
    const step = (most) => {
      const wanted = most / 7;
      return [50, 100, 200, 250, 500, 1000, 2000, 2500, 5000, 10000, 20000, 50000]
        .find((size) => size >= wanted) ?? 100000;
    };
    context.strokeStyle = token('--grid');
    context.lineWidth = 1;
    context.beginPath();
    const speedStep = step(high.speed) * (this.width < 560 ? 2 : 1);
    for (let speed = 0; speed <= high.speed; speed += speedStep) {
      context.moveTo(this.x(speed), pad.top);
      context.lineTo(this.x(speed), this.height - pad.bottom);
      const end = this.x(high.speed) - this.x(speed) < 20;
      write(context, String(speed), this.x(speed), this.height - pad.bottom + 7,
        { ...look, align: end ? 'right' : 'center', base: 'top' });
    }
    for (let load = 0; load <= high.load; load += step(high.load)) {
      context.moveTo(pad.left, this.y(load));
      context.lineTo(this.width - pad.right, this.y(load));
      const end = this.y(load) - pad.top < 6;
      write(context, String(load), pad.left - 8, this.y(load) + (end ? 6 : 0),
        { ...look, align: 'right', base: 'middle' });
    }
    context.stroke();
    write(context, 'Speed, rpm', (this.width + pad.left) / 2, this.height - 1,
      { ...look, align: 'center' });
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

  /** From where on a warning and an alarm are likely enough to change the word for a point. */
  drawChances({ warning, alarm }) {
    const percent = (share) => `${Math.round(share * 100)} %`;
    const { atRisk, alarm: near } = THRESHOLDS;
    this.line(warning.steady_probability, atRisk, percent(atRisk), 'chance', -3);
    this.line(alarm.steady_probability, near, `alarm ${percent(near)}`, 'chance1', -5);
  }

  line(matrix, level, text, look, place = 0) {
    const { context, pad } = this;
    const lines = joined(contour(this.plane, matrix, level))
      .map((points) => points.map(([speed, load]) => [this.x(speed), this.y(load)]));
    const colour = { p1: token('--p1-line'), p2: token('--p2-line'), time: token('--ink'),
      chance: token('--p2-line'), chance1: token('--p1-line') }[look] ?? token('--ink-2');
    context.strokeStyle = colour;
    context.lineWidth = look === 'p1' || look === 'p2' ? 3.5 : 1.6;
    context.setLineDash(look === 'p2' ? [10, 6] : []);
    context.beginPath();
    for (const [first, ...rest] of lines) {
      context.moveTo(...first);
      rest.forEach((point) => context.lineTo(...point));
    }
    context.stroke();
    context.setLineDash([]);
    const [base, left] = [this.y(this.plane.low.load), this.x(this.plane.low.speed)];
    const open = lines.flat().filter(([x, y]) => x > left + 24 && x < this.width - 60
      && y > pad.top + 16 && y < base - this.text * 2);
    if (!open.length) return;
    const wanted = this.width * 0.42 + this.height * 0.42 + place * 50;
    const [x, y] = open.reduce((best, one) =>
      (Math.abs(one[0] * 0.55 + one[1] - wanted) < Math.abs(best[0] * 0.55 + best[1] - wanted)
        ? one : best));
    write(context, text, x, y + this.text * 0.45, {
      size: this.text, strong: look !== '', align: 'center', base: 'alphabetic',
      halo: token('--panel'),
      colour: { p1: token('--p1-text'), p2: token('--p2-text'), chance: token('--p2-text'),
        chance1: token('--p1-text') }[look] ?? token('--ink'),
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
    steps.forEach((step, i) => {
      const [x, y] = [this.x(step.speed), this.y(step.load)];
      context.beginPath();
      context.arc(x, y, rem() * 0.82, 0, 2 * Math.PI);
      context.fillStyle = token('--panel');
      context.fill();
      context.stroke();
      write(context, String(i + 1), x, y + 1,
        { size: this.text, strong: true, colour: ink, align: 'center', base: 'middle' });
    });
    const [x, y] = [this.x(present.speed), this.y(present.load)];
    for (const [width, colour] of [[7, token('--panel')], [4, ink]]) {
      context.lineWidth = width;
      context.strokeStyle = colour;
      context.beginPath();
      context.arc(x, y, rem() * 0.8, 0, 2 * Math.PI);
      context.stroke();
    }
    context.fillStyle = ink;
    context.beginPath();
    context.arc(x, y, 4, 0, 2 * Math.PI);
    context.fill();
    write(context, 'now', x - rem() * 1.2, y - rem() * 0.6, {
      size: this.text * 1.1, strong: true, colour: ink, align: 'right', ground: token('--panel'),
    });
  }

  drawProbe() {
    const { context, pad, scene: { probe } } = this;
    const [x, y] = [this.x(probe.speed), this.y(probe.load)];
    context.strokeStyle = token('--ink');
    context.lineWidth = 1;
    context.setLineDash([2, 3]);
    context.beginPath();
    context.moveTo(x, pad.top);
    context.lineTo(x, this.height - pad.bottom);
    context.moveTo(pad.left, y);
    context.lineTo(this.width - pad.right, y);
    context.stroke();
    context.setLineDash([]);
  }
}
