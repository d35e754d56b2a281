// Style sheets that are fetched with what needs them, and the theme of paper.
import { h } from '../parts/dom.js';

const styles = new Map();

export function fetchStyle(href) {
  if (!styles.has(href)) {
    styles.set(href, new Promise((resolve, reject) => {
      const forget = (event) => {
        styles.delete(href);
        event.target.remove();
        reject(new Error(`no ${href}`));
      };
      document.head.append(h('link', { rel: 'stylesheet', href, onload: resolve, onerror: forget }));
    }));
  }
  return styles.get(href);
}

// Paper is light, whatever the theme of the screen is.
const dataset = document.documentElement.dataset;

window.addEventListener('beforeprint', () => {
  dataset.drawn = dataset.theme; // what the canvases keep their colours of
  dataset.theme = 'light';
});
window.addEventListener('afterprint', () => {
  dataset.theme = dataset.drawn;
  delete dataset.drawn;
});
