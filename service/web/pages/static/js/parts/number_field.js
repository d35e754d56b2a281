// Fields of forms; numbers are typed with a decimal point or a decimal comma, in every browser and language.
import { newId, Panel, v } from './panel.js';

const TYPED_NUMBER = /^[-+\u2212]?(\d+([.,]\d*)?|[.,]\d+)(e[-+]?\d+)?$/i;
const PERHAPS_THOUSANDS = /^[-+\u2212]?[1-9]\d{0,2},\d{3}$/;
const WITH_THOUSANDS = /^([-+\u2212]?)(\d{1,3}(?:[., ']\d{3})+)(?:([.,])(\d*))?$/;
const numberByPoint = (text) => Number(text.replace('\u2212', '-').replace(',', '.'));

/** What a text means: { value }, null for an empty one, or { wrong } with what to write in its place. */
export function readNumber(text) {
  const typed = text.trim();
  if (!typed) return { value: null };
  if (PERHAPS_THOUSANDS.test(typed)) {
    const other = typed.replace(',', '');
    return { wrong: `“${typed}” can mean ${typed.replace(',', '.')} or ${other}: write one of these` };
  }
  if (TYPED_NUMBER.test(typed)) return { value: numberByPoint(typed) };
  const [, sign = '', whole = '', , rest = ''] = WITH_THOUSANDS.exec(typed) ?? [];
  const plain = whole && `${sign}${whole.replace(/\D/g, '')}${rest && `.${rest}`}`;
  return { wrong: plain ? `“${typed}” has marks of thousands: write ${plain}`
    : `“${typed}” is not a number: write one such as 70.5` };
}

function beyondBounds(value, { least = -Infinity, most = Infinity, whole, unit = '' }) {
  if (value === null) return '';
  if (whole && !Number.isInteger(value)) return 'expected a whole number';
  if (value >= least && value <= most) return '';
  const range = most === Infinity ? `${least} or more` : least === -Infinity ? `${most} or less`
    : `${least} to ${most}`;
  return `expected ${range} ${unit}`.trim();
}

/**
 * An input for a number, and next to it the number with its unit while it is typed. `step`: what an
 * arrow key adds; `unitShown`: nothing else shows the unit. oninput(number, wrong): null for an empty
 * text, NaN for one that may not be.
 */
export class NumberField extends Panel {
  constructor(attributes) {
    super(attributes);
    this.id = newId('reading');
    this.text = String(attributes.value ?? '');
  }

  judge(bounds = this.props) {
    const { value, wrong } = readNumber(this.text);
    const fault = wrong ?? beyondBounds(value, bounds);
    return { value, wrong: fault, number: fault ? NaN : value };
  }

  type(text) {
    Object.assign(this, { text, isTyped: true });
    this.draw();
    const { number, wrong } = this.judge();
    this.props.oninput?.(number, wrong);
  }

  press(event) {
    const steps = { ArrowUp: 1, ArrowDown: -1 }[event.key];
    const { value, wrong } = this.judge();
    if (!steps || wrong) return;
    event.preventDefault();
    const { least = -Infinity, most = Infinity, step = 1 } = this.props;
    const next = Number(((value ?? 0) + steps * step).toPrecision(12));
    this.type(String(Math.min(most, Math.max(least, next))));
  }

  shouldComponentUpdate({ value }) {
    if (!Object.is(value, this.props.value) && !Object.is(value ?? null, this.judge().number)) {
      Object.assign(this, { text: String(value ?? ''), isTyped: false });
    }
    return true;
  }

  componentDidMount() {
    this.componentDidUpdate();
  }

  componentDidUpdate() {
    this.input.setCustomValidity(this.judge().wrong);
  }

  render({ least, most, whole, unit = '', unitShown, step, value: given, oninput, ref, ...attributes }) {
    const { value, wrong } = this.judge({ least, most, whole, unit });
    const isRepeated = this.isTyped && value !== null && (unit || !whole);
    return [v('input', {
      type: 'text', inputmode: whole ? 'numeric' : 'decimal', role: 'spinbutton', autocomplete: 'off',
      'aria-valuemin': least, 'aria-valuemax': most, 'aria-describedby': this.id, ...attributes,
      'aria-invalid': Boolean(wrong), 'aria-valuenow': wrong ? null : value, value: this.text,
      onkeydown: (event) => this.press(event), oninput: ({ target }) => this.type(target.value),
      ref: (input) => { this.input = input ?? this.input; },
    }), v('span', { class: `reading${wrong ? ' wrong' : ''}`, 'aria-live': 'polite', id: this.id },
      wrong ? `${wrong}.` : isRepeated ? `= ${value} ${unit}`.trim() : unitShown && unit)];
  }
}

class Field extends Panel {
  id = newId('field');

  render({ label, hint, children: control }) {
    const described = hint ? { 'aria-describedby': `${this.id}-hint` } : {};
    return v('div', { class: 'field' }, v('label', { for: this.id }, label),
      v(control.type, { ...control.props, ...described, id: this.id }),
      hint && v('p', { class: 'xs mut', id: `${this.id}-hint` }, hint));
  }
}

/** Where `which` differs, the control is another one. */
export const field = (label, control, hint = '', which = '') =>
  v(Field, { label, hint, key: `${label} ${which}` }, control);
