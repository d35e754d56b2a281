// The controls of what-if: the steps to try, each with speed, load and duration.
import { h, put, setText } from './dom.js';
import { fixed, hourMinute, wholeMinute } from './format.js';
import { MOST_STEPS, problemWith } from './profile.js';

export class ProfilePanel {
  /**
   * actions: { preset(name), add(), copyLink(), save(), tryFrom(fromEnd), remove(index),
   * change(index, name, value), useSpeed() }.
   */
  constructor(actions) {
    this.actions = actions;
    const preset = (name) =>
      h('button', { type: 'button', onclick: () => actions.preset(name) }, name);
    const button = (text, action, look = 'btn') =>
      h('button', { class: look, type: 'button', disabled: true, onclick: action }, text);
    this.stepList = h('div', { class: 'steps' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.add = button('Add step', actions.add);
    this.link = button('Copy link', actions.copyLink);
    this.file = button('Save as CSV', actions.save);
    this.hint = h('p', { class: 's mut' });
    this.figure = h('p', { class: 'v', role: 'status' });
    this.take = button('Use this speed', actions.useSpeed);
    this.element = h('section', { class: 'panel p-profile' },
      h('header', {}, h('h2', {}, 'Test profile'), h('span', { class: 'sp' }),
        h('span', { class: 'seg' }, ['planned', 'hold', 'cool down'].map(preset))),
      this.stepList, this.problem,
      h('div', { class: 'row foot' }, this.add, h('span', { class: 'sp' }), this.link, this.file),
      h('div', { class: 'hint' }, this.hint, h('div', { class: 'row' }, this.figure,
        h('span', { class: 'sp' }), this.take)));
  }

  /**
   * Make the steps. fields: of `fieldsFor`; `end` is when the present step ends (ms), null
   * where it does not; `canGoOn` says whether there is one to be waited for.
   */
  build(steps, fields, { fromEnd, endMs }) {
    this.starts = steps.map(() => h('span', { class: 'hd' }));
    put(this.stepList, this.presentRow(fromEnd, endMs),
      steps.map((step, i) => h('div', { class: 'step' },
        h('header', {}, h('b', {}, `Step ${i + 1}`), this.starts[i],
          steps.length > 1 && h('button', {
            class: 'btn sm', type: 'button', 'aria-label': `Remove step ${i + 1}`,
            onclick: () => this.actions.remove(i),
          }, 'Remove')),
        Object.entries(fields).map(([name, field]) => this.slider(step, i, name, field)))));
    this.add.disabled = steps.length >= MOST_STEPS;
    this.add.title = this.add.disabled ? `At most ${MOST_STEPS} steps` : '';
    this.link.disabled = false;
    this.file.disabled = false;
    setText(this.problem, '');
  }

  presentRow(fromEnd, endMs) {
    const choose = (value, text) => h('button', {
      type: 'button', 'aria-pressed': String(fromEnd === value),
      onclick: () => this.actions.tryFrom(value),
    }, text);
    this.present = h('b', {});
    return h('div', { class: 'step cur' }, h('header', {}, this.present),
      h('div', { class: 'row' }, h('span', { class: 'hd' }, 'Try from'),
        h('span', { class: 'seg' }, choose(false, 'now'),
          endMs !== null && choose(true, `end of current step (${hourMinute(wholeMinute(endMs))})`))));
  }

  slider(step, index, name, field) {
    const { name: title, unit, low, high, step: by, least = low, most } = field;
    const id = `step${index}-${name}`;
    const change = (event, other) => {
      const wrong = problemWith(event.target.value, field);
      number.setAttribute('aria-invalid', String(Boolean(wrong)));
      setText(this.problem, wrong && `Step ${index + 1}, ${wrong}.`);
      if (wrong) return;
      const value = Number(event.target.value);
      if (other) other.value = value;
      this.actions.change(index, name, value);
    };
    const range = h('input', {
      id, type: 'range', min: low, max: Math.max(high, step[name]), step: by, value: step[name],
      'aria-valuetext': `${step[name]} ${unit}`,
      oninput: (event) => {
        range.setAttribute('aria-valuetext', `${range.value} ${unit}`);
        change(event, number);
      },
    });
    const number = h('input', {
      type: 'number', 'aria-label': `${title}, step ${index + 1}, ${unit}`, min: least, max: most,
      step: 'any', value: step[name], oninput: (event) => change(event, range),
    });
    return h('div', { class: 'sl' }, h('label', { for: id }, title), range,
      h('span', { class: 'num' }, number, h('span', { class: 's mut' }, unit)));
  }

  /** What changes with time alone: the present point, and when each step begins. */
  showTimes(speedRpm, loadN, beginsMs) {
    setText(this.present, `Running: ${fixed(speedRpm, 0)} rpm, ${fixed(loadN, 0)} N`);
    beginsMs.forEach((ms, i) => setText(this.starts[i], `from ${hourMinute(wholeMinute(ms))}`));
  }

  /** What is wrong, '' for nothing; a figure that cannot be taken stays said. */
  showProblem(text) {
    if (!this.stepList.querySelector('[aria-invalid=true]')) setText(this.problem, text);
  }

  /** text, figure (null while it is sought), and whether it can be used. */
  showHint(text, figure, usable) {
    setText(this.hint, text);
    put(this.figure, figure ?? '…');
    this.take.disabled = !usable;
    this.take.hidden = !usable;
  }
}
