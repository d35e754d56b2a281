// What the views are made of: the elements of Preact, and a panel that ends what it has begun.
import { Component, h as createNode, isValidElement, render } from '../../vendor/preact.js';

/**
 * An element or a component of a view: v('p', { class: 's' }, 'text'). Text stays text. A value that
 * the user may change is given as `defaultValue` or `defaultChecked`.
 */
export const v = createNode;
export const isNode = isValidElement;

let ids = 0;

/** An id that no other element has. */
export const newId = (of) => {
  ids += 1;
  return `${of}-${ids}`;
};

/** A part of a page that follows the service; `draw` shows it as it is now. */
export class Panel extends Component {
  constructor(attributes) {
    super(attributes);
    this.page = attributes.page;
    this.endings = [];
    attributes.ref?.(this);
    this.draw = () => this.forceUpdate();
  }

  /** Not drawn again for the same attributes. */
  shouldComponentUpdate(next) {
    return Object.keys(next).some((name) => name !== 'ref' && next[name] !== this.props[name]);
  }

  /** Draw, or do something else, after a change of topics of a store, at most once per interval. */
  follow(store, topics, intervalMs, action = this.draw) {
    this.endings.push(store.on(topics, () => this.ended || action(), intervalMs));
  }

  /** Once, unless the panel has ended by then. */
  after(ms, action) {
    return setTimeout(() => this.ended || action(), ms);
  }

  /** A signal for a request: it ends with the panel, and when another one is asked for. */
  newSignal() {
    this.request?.abort();
    this.request = new AbortController();
    return this.request.signal;
  }

  every(intervalMs, action = this.draw) {
    const timer = setInterval(action, intervalMs);
    this.endings.push(() => clearInterval(timer));
  }

  /** Now, and again and again. */
  poll(intervalMs, action) {
    action();
    this.every(intervalMs, action);
  }

  set(fields) {
    Object.assign(this, fields);
    this.draw();
  }

  /** Do what the service may refuse: `say` what it said then, and give undefined. */
  async tried(failure, action, say = this.page?.notify) {
    try {
      return await action();
    } catch (error) {
      if (this.ended) return undefined;
      if (!(error.status >= 0)) throw error;
      say(failure ? `${failure}: ${error.message}.` : error.message);
      return undefined;
    }
  }

  componentWillUnmount() {
    this.ended = true;
    this.request?.abort();
    this.endings.forEach((end) => end());
  }
}

/** Show a component in a box of other code: { update(attributes), destroy(), part }. */
export function place(box, type, attributes = {}) {
  const shown = {
    part: null,
    update(changes) {
      Object.assign(attributes, changes);
      render(v(type, { ...attributes, ref: (part) => { shown.part = part; } }), box);
      return shown;
    },
    destroy: () => render(null, box),
  };
  return shown.update();
}

export const draw = (box, ...nodes) => render(nodes, box);

/** Elements that do not change later, for other code to append. */
export function nodesOf(node) {
  const fragment = document.createDocumentFragment();
  render(node, fragment);
  return fragment;
}

/**
 * A box whose inside other code draws, such as a chart: make(box) gives what draws it, with its
 * destroy(); show(it) is called whenever the panel is drawn.
 */
export class Hosted extends Component {
  componentDidMount() {
    this.inside = this.props.make(this.box);
    this.componentDidUpdate();
  }

  componentDidUpdate() {
    this.props.show?.(this.inside);
  }

  componentWillUnmount() {
    this.inside?.destroy?.();
  }

  render({ make, show, tag = 'div', ...attributes }) {
    return v(tag, { ...attributes, ref: (box) => { this.box = box; } });
  }
}

/** What keeps a control from being used: { disabled, title } for its attributes. */
export const unless = (reason) => ({ disabled: Boolean(reason), title: reason || null });

/** A small button; other attributes, also its class, may follow. */
export const button = (text, onclick, attributes = {}) =>
  v('button', { class: 'btn sm', type: 'button', onclick, ...attributes }, text);

export const options = (pairs, chosen) => pairs.map(([value, text]) =>
  v('option', { value, selected: value === chosen }, text));

/** One of several values, [[value, text], …], in a list that opens; choose(value as a text). */
export const select = (label, pairs, chosen, choose, attributes = {}) => v('select', {
  'aria-label': label, onchange: ({ target }) => choose(target.value), ...attributes }, options(pairs, chosen));

/** Values as buttons, [[value, text, title], …]: one is chosen, or (undefined) they only act; choose(value). */
export const choice = (label, values, chosen, choose, look = '') => v('span', {
  class: `seg${look}`, role: 'group', 'aria-label': label }, values.map(([value, text, title]) => v('button', {
  type: 'button', title, key: value, 'aria-pressed': chosen === undefined ? null : value === chosen,
  onclick: () => choose(value) }, text)));

/** An input that searches; found(text) with each key. */
export const search = (label, found, attributes = {}) => v('input', { type: 'search', placeholder: label,
  'aria-label': label, oninput: ({ target }) => found(target.value), ...attributes });

/** Whether values have a text, in upper or lower case. */
export const hasText = (values, text) => values.join(' ').toLowerCase().includes(text.trim().toLowerCase());
export const tick = (label, checked, ticked, attributes = {}) => v('input', { type: 'checkbox', 'aria-label': label,
  checked, onchange: ({ target }) => ticked(target.checked), ...attributes });

/** A form that other code sends: submitted(its element, the button). */
export const form = (attributes, submitted, ...inside) => v('form', { ...attributes, onsubmit: (event) => {
  event.preventDefault();
  submitted(event.target, event.submitter);
} }, inside);

export const gap = () => v('span', { class: 'sp' });

/** A panel of a view with its heading, and what stands next to it. */
export const section = (look, title, beside, ...inside) => v('section', { class: `panel ${look}`.trim() },
  v('header', {}, v('h2', {}, title), beside), inside);

/** What is wrong; read out when it changes. */
export const problem = (text, look = '') => v('p', { class: `problem${look}`, role: 'alert' }, text);

/** A word in small grey letters; `status` is read out when it changes. */
export const quiet = (text, role = null) => v('span', { class: 's mut', role }, text);
export const key = (look, ...text) => v('span', { class: 'key' }, v('i', { class: look }), text);

export const scrolled = (label, look, ...inside) =>
  v('div', { class: look, tabindex: 0, role: 'region', 'aria-label': label }, inside);

/**
 * A table of rows. Columns are [title, cell(row), its look, look of the title]; a title '' is of controls,
 * a cell may be a whole td or th. attributesOf(row) are those of a row; empty: a text in place of rows;
 * last: more rows.
 */
export function plainTable(columns, rows, /** @type {any} */ more = {}) {
  const { look = null, attributesOf = (_) => ({}), empty = '', last } = more;
  const shown = columns.filter(Boolean);
  const isCell = (one) => isNode(one) && (one.type === 'td' || one.type === 'th');
  return v('table', { class: look }, shown.some(([title]) => title) && v('thead', {}, v('tr', {},
    shown.map(([title, , , titleLook]) => (isCell(title) ? title
      : v('th', { scope: 'col', class: titleLook }, title || v('span', { class: 'vh' }, 'Actions')))))),
  v('tbody', {}, rows.map((row, place) => v('tr', attributesOf(row), shown.map(([, cell, cellLook]) => {
    const inside = cell(row, place);
    return isCell(inside) ? inside : v('td', { class: cellLook }, inside);
  }))), empty && !rows.length && v('tr', {}, v('td', { colspan: shown.length, class: 'mut pad' }, empty)), last));
}

/** The same in a box that may scroll, with what follows it there. */
export const table = (label, columns, rows, /** @type {any} */ { boxLook = 'scroll', ...more } = {}, ...after) =>
  scrolled(label, boxLook, plainTable(columns, rows, more), after);
