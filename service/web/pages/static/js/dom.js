// Elements are built from parts, never from HTML text: whatever the server sends stays text.
const SVG_NAMESPACE = 'http://www.w3.org/2000/svg';

export const find = (selector, root = document) => root.querySelector(selector);

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else if (name === 'style') Object.assign(element.style, value);
    else element.setAttribute(name, value === true ? '' : value);
  }
  append(element, children);
  return element;
}

function append(element, children) {
  for (const child of children.flat(Infinity)) {
    if (child !== null && child !== undefined && child !== false) element.append(child);
  }
}

/** An HTML element; `on…` attributes are listeners, `style` is an object, children may nest. */
export const h = (tag, attributes = {}, ...children) =>
  fill(document.createElement(tag), attributes, children);

/** An SVG element. */
export const s = (tag, attributes = {}, ...children) =>
  fill(document.createElementNS(SVG_NAMESPACE, tag), attributes, children);

/** Replace everything in an element. */
export function put(element, ...children) {
  element.replaceChildren();
  append(element, children);
  return element;
}

/** Set text only when it differs, so that nothing is laid out again for nothing. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A box that may scroll: reached with the keyboard, and named for who does not see it. */
export const scrollable = (look, label, ...children) =>
  h('div', { class: look, tabindex: 0, role: 'region', 'aria-label': label }, children);

export const bold = (...children) => h('b', {}, ...children);
export const unit = (text) => h('span', { class: 'u' }, text);

/** The value of a design token. */
export const token = (name) =>
  getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Pixels of one rem. */
export const rem = () => parseFloat(getComputedStyle(document.documentElement).fontSize);
