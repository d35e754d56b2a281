// Which band of the forecast a chart shows: that of each moment, or that of the whole run.
import { h, setText } from './dom.js';
import { ofWholeRun } from './forecast.js';

const BANDS = [
  [false, 'each moment', '95 % of the readings are expected inside'],
  [true, 'whole run', 'With 90 % all readings of the run are inside, from the first to the last'],
];

/** Key and switch of the band. The choice is the page's, so that every chart shows the same. */
export class BandChoice {
  /** page: where the choice is kept; changed(): draws again. */
  constructor(page, changed) {
    this.page = page;
    this.changed = changed;
    this.inner = h('span', { class: 'key' }, h('i', { class: 'f50' }), '50 %');
    this.text = h('span', {});
    this.outer = h('span', { class: 'key' }, h('i', { class: 'f95' }), this.text);
    this.buttons = BANDS.map(([whole, name, title]) =>
      h('button', { type: 'button', title, onclick: () => this.choose(whole) }, name));
    this.element = h('span', { class: 'bandkeys' }, this.inner, this.outer,
      h('span', { class: 'seg', role: 'group', 'aria-label': 'Band of the forecast' }, this.buttons));
    this.show();
  }

  choose(whole) {
    this.page.wholeRun = whole;
    this.show();
    this.changed();
  }

  show() {
    const whole = Boolean(this.page.wholeRun);
    this.inner.hidden = whole;
    setText(this.text, whole ? '90 % whole run' : '95 %');
    BANDS.forEach(([of], i) => this.buttons[i].setAttribute('aria-pressed', String(of === whole)));
  }

  /** The fan as it is to be drawn. */
  drawn(fan) {
    return this.page.wholeRun && fan ? ofWholeRun(fan) : fan;
  }
}
