// What to measure next: the panel that asks the twin how to learn about a high-risk point.
import { assetPath, call } from '../app/api.js';
import { marginText, marginTitle } from '../forecast/verdict.js';
import { celsius, channelName, fixed, isNumber, labelText, percent, spanText } from '../parts/format.js';
import { icon } from '../parts/icons.js';
import { NumberField } from '../parts/number_field.js';
import { form, Panel, plainTable, problem, quiet, scrolled, v } from '../parts/panel.js';

const SHOWN = 6;
const PATIENCE_MS = 60000;
const kelvin = (value) => ['± ', fixed(value), v('span', { class: 'u' }, 'K')];

/** The levels of a step in words: "4200 rpm, 2000 N 45 min, then 3400 N 45 min". */
export function stepText(levels) {
  return levels.map(({ speed_rpm: speed, load_n: load, duration_s: duration }, i) => {
    const same = i > 0 && levels[i - 1].speed_rpm === speed;
    return [i ? 'then ' : '', same ? '' : `${fixed(speed, 0)} rpm, `, `${fixed(load, 0)} N `,
      spanText(duration)].join('');
  }).join(', ');
}

/**
 * page: of the application; `wish` on it may name the point: { speed_rpm, load_n }. isReady: there
 * is something to answer with.
 */
export class AdvicePanel extends Panel {
  /** Begin with the point another view asked for, else one well beyond the low-risk region. */
  constructor(attributes) {
    super(attributes);
    const { wish } = this.page;
    const region = this.page.store.get('asset')?.low_risk;
    this.point = wish ?? (region ? {
      speed_rpm: Math.round(region.speed_rpm_max * 1.4 / 100) * 100,
      load_n: Math.round(region.load_n_max * 1.6 / 100) * 100,
    } : {});
    this.wanted = null;
    this.page.wish = null;
    this.isWished = Boolean(wish);
  }

  componentDidMount() {
    if (this.isWished) requestAnimationFrame(() => this.section.scrollIntoView({ block: 'start' }));
    this.componentDidUpdate();
  }

  /** Answer for the point that is there already, as soon as that is possible. */
  componentDidUpdate() {
    if (!this.isAsked && (this.isWished || this.props.isReady)) this.ask();
  }

  async ask() {
    const { speed_rpm: speed, load_n: load } = this.point;
    if (!Number.isFinite(speed) || !Number.isFinite(load) || Number.isNaN(this.wanted)) return;
    const query = { ...this.point, ...(this.wanted && { half_width_k: this.wanted }) };
    const signal = this.newSignal();
    this.set({ isAsked: true, isAsking: true, problem: '' });
    try {
      this.answer = await call(assetPath(this.page.live.assetId, '/advice'),
        { query, timeoutMs: PATIENCE_MS, signal });
    } catch (error) {
      if (signal.aborted) return;
      Object.assign(this, { answer: null, problem: `No advice: ${error.message}.` });
    }
    this.set({ isAsking: false });
  }

  render() {
    const field = (name, title, unit, most) => v('label', {}, title, ' ', v(NumberField, {
      least: 0, most, step: 50, unit, unitShown: true, required: true, value: this.point[name],
      'aria-label': `${title} of the point, ${unit}`,
      oninput: (value) => { this.point = { ...this.point, [name]: value }; },
    }));
    return v('section', { class: 'panel e-adv', ref: (section) => { this.section = section; } },
      v('header', {}, v('h2', {}, 'Suggested test steps'), quiet('to narrow the forecast at a high-risk point')),
      form({ class: 'row ask' }, () => this.ask(), field('speed_rpm', 'Speed', 'rpm', 20000),
        field('load_n', 'Load', 'N', 200000),
        v('label', {}, 'Wanted within ± ', v(NumberField, {
          least: 0.1, most: 1000, step: 0.5, unit: 'K', unitShown: true, value: this.wanted,
          'aria-label': 'Wanted half-width, K',
          oninput: (value) => { this.wanted = value; },
        })),
        v('button', { class: 'btn', disabled: this.isAsking }, 'Suggest')),
      v('p', { class: 's mut', role: 'status' }, this.isAsking && 'Comparing steps …'),
      problem(this.problem),
      scrolled('Suggested test steps', 'adv wide', this.answer && this.shown(this.answer)));
  }

  shown(answer) {
    const { target, steps, excluded, stop_rule: rule } = answer;
    const { sensor } = target;
    const now = target.sensors[sensor];
    return [
      v('p', { class: 'b' }, answer.next_step.text),
      v('p', { class: 's' }, `${channelName(sensor)} at ${fixed(target.speed_rpm, 0)} rpm, `
        + `${fixed(target.load_n, 0)} N: `, v('b', {}, celsius(now.q50)), ' ', kelvin(now.half_width_k),
      target.labels.map((label) => [' ', v('span', { class: 'chip dash' }, labelText(label))])),
      target.runaway_margin && v('p', { class: 's', title: marginTitle(target.runaway_margin) },
        marginText(target.runaway_margin),
        answer.ranked_by === 'runaway'
          && '. Steps that leave the least probability of a runaway come first, then those that '
          + 'narrow the interval most.'),
      steps.length === 0 && v('p', { class: 's b' }, 'All steps are refused now.'),
      steps.length > 0 && this.stepTable(answer, now.half_width_k),
      excluded.length > 0 && this.refusals(excluded),
      this.approach(rule, sensor),
    ];
  }

  stepTable({ steps, target: { sensor }, ranked_by: rankedBy }, now) {
    const more = steps.length - SHOWN;
    const after = (step) => step.cautious_half_width_k[sensor];
    const columns = [
      ['Low-risk step', (step) => stepText(step.levels), 'b'], ['Now', () => kelvin(now), 'r nw', 'r'],
      ['After', (step) => kelvin(after(step)), 'r nw b', 'r'],
      ['Narrower by', (step) => v('div', { class: 'bar' },
        v('i', { style: { width: `${Math.max(0, step.narrower_by) * 100}%` } })), 'nb'],
      rankedBy === 'runaway' && ['Runaway after', ({ runaway_probability: probability }) =>
        (isNumber(probability) ? percent(probability) : '–'), 'r nw b', 'r'],
      ['Peak, 97.5 %', (step) => celsius(step.peak_c[sensor]), 'r nw', 'r'], ['Reason', (step) => step.why],
    ];
    return plainTable(columns, steps.slice(0, SHOWN), { last:
      more > 0 && v('tr', {}, v('td', { class: 'mut', colspan: 7 },
      `${more} more, down to ${stepText(steps.at(-1).levels)} (± ${fixed(after(steps.at(-1)))} K)`)) });
  }

  refusals(excluded) {
    const byReason = Map.groupBy(excluded, (step) => step.reason);
    return v('details', { class: 's' },
      v('summary', {}, `${excluded.length} ${excluded.length > 1 ? 'steps' : 'step'} refused`),
      [...byReason].map(([reason, steps]) => v('p', {}, v('b', {},
        steps.map((step) => stepText(step.levels)).slice(0, 3).join('; '),
        steps.length > 3 && ' …'), `: ${reason}.`)));
  }

  approach(rule, sensor) {
    return v('details', { class: 's' }, v('summary', {}, 'Approach to the point'),
      v('ol', {}, rule.rules.map((text) => v('li', {}, text))), plainTable([
        [v('th'), (_, i) => String(i + 1), 'b'],
        ['Level', (level) => `${fixed(level.speed_rpm, 0)} rpm, ${fixed(level.load_n, 0)} N`, 'nw'],
        [`${channelName(sensor)} expected`, (level) => celsius(level.expected_c[sensor]), 'r nw', 'r'],
        ['Stop above', (level) => celsius(level.stop_above_c[sensor]), 'r nw b', 'r'],
        [v('th'), (level) => [level.allowed ? [icon('ok'), ' allowed'] : [icon(2, 'dashed'), ' ', level.reason],
          level.runaway_not_excluded && level.allowed
            && [' ', v('span', { class: 'chip dash' }, labelText('runaway not excluded'))]]],
      ], rule.levels));
  }
}
