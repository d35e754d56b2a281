// Style sheets that are fetched with what needs them.
import { h } from './dom.js';

const styles = new Map();

/** Fetch a style sheet once; resolves when it is in force. */
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
