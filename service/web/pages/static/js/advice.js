// What to measure next: the panel that asks the twin how to learn about a high-risk point.
import { assetPath, call } from './api.js';
import { h, put, scrollable, setText } from './dom.js';
import { celsius, channelName, fixed, isNumber, labelText, percent, spanText } from './format.js';
import { icon } from './icons.js';
import { marginText, marginTitle } from './runaway.js';

const SHOWN = 6;
const PATIENCE_MS = 60000;

const kelvin = (value) => ['± ', fixed(value), h('span', { class: 'u' }, 'K')];

/** The levels of a step in words: "4200 rpm, 2000 N 45 min, then 3400 N 45 min". */
export function stepText(levels) {
  return levels.map(({ speed_rpm: speed, load_n: load, duration_s: duration }, i) => {
    const same = i > 0 && levels[i - 1].speed_rpm === speed;
    return [i ? 'then ' : '', same ? '' : `${fixed(speed, 0)} rpm, `, `${fixed(load, 0)} N `,
      spanText(duration)].join('');
  }).join(', ');
}

export class AdvicePanel {
  /** page: of the application; `wish` on it may name the point: { speed_rpm, load_n }. */
  constructor(page) {
    this.page = page;
    const field = (name, title, unit, most) => {
      const input = h('input', {
        type: 'number', min: 0, max: most, step: 50, 'aria-label': `${title} of the point, ${unit}`,
      });
      return [input, h('label', {}, title, ' ', input, ' ', h('span', { class: 's mut' }, unit))];
    };
    const [speed, speedLabel] = field('speed_rpm', 'Speed', 'rpm', 20000);
    const [load, loadLabel] = field('load_n', 'Load', 'N', 200000);
    this.inputs = { speed_rpm: speed, load_n: load };
    this.button = h('button', { class: 'btn', type: 'submit' }, 'Suggest');
    this.status = h('p', { class: 's mut', role: 'status' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.result = scrollable('adv wide', 'Suggested test steps');
    this.element = h('section', { class: 'panel e-adv' },
      h('header', {}, h('h2', {}, 'Suggested test steps'),
        h('span', { class: 's mut' }, 'to narrow the forecast at a high-risk point')),
      h('form', {
        class: 'row ask',
        onsubmit: (event) => {
          event.preventDefault();
          this.ask();
        },
      }, speedLabel, loadLabel, this.button), this.status, this.problem, this.result);
    this.fill();
  }

  /** Begin with the point another view asked for, else one well beyond the low-risk region. */
  fill() {
    const { wish } = this.page;
    const region = this.page.store.get('asset')?.low_risk;
    const beyond = region && {
      speed_rpm: Math.round(region.speed_rpm_max * 1.4 / 100) * 100,
      load_n: Math.round(region.load_n_max * 1.6 / 100) * 100,
    };
    for (const [name, input] of Object.entries(this.inputs)) {
      input.value = (wish ?? beyond)?.[name] ?? '';
    }
    if (wish) {
      this.page.wish = null;
      requestAnimationFrame(() => this.element.scrollIntoView({ block: 'start' }));
      this.ask();
    }
  }

  /** Answer for the point that is there already, once there is something to answer with. */
  begin() {
    if (this.asked) return;
    this.ask();
  }

  async ask() {
    this.asked = true;
    const query = {};
    for (const [name, input] of Object.entries(this.inputs)) query[name] = Number(input.value);
    this.button.disabled = true;
    setText(this.problem, '');
    setText(this.status, 'Comparing steps …');
    try {
      const answer = await call(assetPath(this.page.live.assetId, '/advice'),
        { query, timeoutMs: PATIENCE_MS });
      setText(this.status, '');
      this.show(answer);
    } catch (error) {
      setText(this.status, '');
      put(this.result);
      setText(this.problem, `No advice: ${error.message}.`);
    } finally {
      this.button.disabled = false;
    }
  }

  show(answer) {
    const { target, steps, excluded, stop_rule: rule } = answer;
    const { sensor } = target;
    const now = target.sensors[sensor];
    put(this.result,
      h('p', { class: 's' }, `${channelName(sensor)} at ${fixed(target.speed_rpm, 0)} rpm, `
        + `${fixed(target.load_n, 0)} N: `, h('b', {}, celsius(now.q50)), ' ', kelvin(now.half_width_k),
      target.labels.map((label) => [' ', h('span', { class: 'chip dash' }, labelText(label))])),
      target.runaway_margin && h('p', { class: 's', title: marginTitle(target.runaway_margin) },
        marginText(target.runaway_margin),
        answer.ranked_by === 'runaway'
          && '. Steps that leave the least probability of a runaway come first, then those that '
          + 'narrow the interval most.'),
      !answer.worth_while && h('p', { class: 's b' },
        steps.length ? 'No low-risk step narrows this forecast by 10 % or more.'
          : 'All steps are refused now.'),
      steps.length > 0 && this.stepTable(answer, now.half_width_k),
      excluded.length > 0 && this.refusals(excluded),
      this.approach(rule, sensor));
  }

  stepTable({ steps, target: { sensor }, ranked_by: rankedBy }, now) {
    const away = rankedBy === 'runaway';
    const row = (step) => h('tr', {},
      h('td', { class: 'b' }, stepText(step.levels)),
      h('td', { class: 'r nw' }, kelvin(now)),
      h('td', { class: 'r nw b' }, kelvin(step.cautious_half_width_k[sensor])),
      h('td', { class: 'nb' }, h('div', { class: 'bar' },
        h('i', { style: { width: `${Math.max(0, step.narrower_by) * 100}%` } }))),
      away && h('td', { class: 'r nw b' },
        isNumber(step.runaway_probability) ? percent(step.runaway_probability) : '–'),
      h('td', { class: 'r nw' }, celsius(step.peak_c[sensor])),
      h('td', {}, step.why));
    const heads = ['Low-risk step', 'Now', 'After', 'Narrower by', away && 'Runaway after',
      'Peak, 97.5 %', 'Reason'].filter(Boolean);
    const more = steps.length - SHOWN;
    return h('table', {}, h('thead', {}, h('tr', {},
      heads.map((text, i) =>
        h('th', { class: i > 0 && i < heads.length - 1 && i !== 3 ? 'r' : null }, text)))),
    h('tbody', {}, steps.slice(0, SHOWN).map(row),
      more > 0 && h('tr', {}, h('td', { class: 'mut', colspan: heads.length },
        `${more} more, down to ${stepText(steps.at(-1).levels)} `
        + `(± ${fixed(steps.at(-1).cautious_half_width_k[sensor])} K)`))));
  }

  refusals(excluded) {
    const byReason = Map.groupBy(excluded, (step) => step.reason);
    return h('details', { class: 's' },
      h('summary', {}, `${excluded.length} ${excluded.length > 1 ? 'steps' : 'step'} refused`),
      [...byReason].map(([reason, steps]) => h('p', {}, h('b', {},
        steps.map((step) => stepText(step.levels)).slice(0, 3).join('; '),
        steps.length > 3 && ' …'), `: ${reason}.`)));
  }

  approach(rule, sensor) {
    const row = (level, i) => h('tr', {},
      h('td', { class: 'b' }, String(i + 1)),
      h('td', { class: 'nw' }, `${fixed(level.speed_rpm, 0)} rpm, ${fixed(level.load_n, 0)} N`),
      h('td', { class: 'r nw' }, celsius(level.expected_c[sensor])),
      h('td', { class: 'r nw b' }, celsius(level.stop_above_c[sensor])),
      h('td', {}, level.allowed ? [icon('ok'), ' allowed'] : [icon(2, 'dashed'), ' ', level.reason],
        level.runaway_not_excluded && level.allowed
          && [' ', h('span', { class: 'chip dash' }, labelText('runaway not excluded'))]));
    return h('details', { class: 's' }, h('summary', {}, 'Approach to the point'),
      h('ol', {}, rule.rules.map((text) => h('li', {}, text))),
      h('table', {}, h('thead', {}, h('tr', {},
        ['', 'Level', `${channelName(sensor)} expected`, 'Stop above', ''].map((text, i) =>
          h('th', { class: i === 2 || i === 3 ? 'r' : null }, text)))),
      h('tbody', {}, rule.levels.map(row))));
  }
}
