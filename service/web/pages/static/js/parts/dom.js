// Elements for code that draws without panels, such as a chart, and what it reads of the style.
import { nodesOf, v } from './panel.js';

export const find = (selector, root = document) => root.querySelector(selector);

/** An element that does not change later. @returns {any} */
export const h = (tag, attributes = {}, ...children) => nodesOf(v(tag, attributes, ...children)).firstChild;

export const token = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
export const rem = () => parseFloat(getComputedStyle(document.documentElement).fontSize);
