// Which windows the next identification learns from: all of them, or those chosen by hand.
import { h, put, scrollable, setText } from './dom.js';
import { counted, dayTime, milliseconds, spanText, timeElement } from './format.js';
import { isUsed, overlaps, pointText, windowOf, WindowTimeline } from './windows.js';

const key = (look, text) => h('span', { class: 'key' }, h('i', { class: look }), text);

/** A time for an input of local date and time, and back. */
function localInput(ms) {
  const local = new Date(ms - new Date(ms).getTimezoneOffset() * 60000);
  return local.toISOString().slice(0, 16);
}

export class WindowPanel {
  /** onChange() is called when the choice has changed. */
  constructor(onChange) {
    this.onChange = onChange;
    this.windows = [];
    this.byHand = null; // null: automatic, else the chosen windows
    this.text = h('span', { class: 's mut' }, 'loading …');
    this.plot = h('div', { class: 'wtl' });
    this.table = scrollable('wt', 'Selected windows');
    this.button = h('button', {
      class: 'btn sm', type: 'button', disabled: true, onclick: () => this.switch(),
    }, 'Select manually');
    this.element = h('section', { class: 'panel e-win' },
      h('header', {}, h('h2', {}, 'Low-risk windows'), this.text,
        h('span', { class: 'keys' }, key('box chosen', 'trains the next model'),
          key('box', 'excluded'), key('risky', 'high-risk, never used'),
          key('learned', 'in the active model'), this.button)),
      this.plot, this.table);
    this.timeline = new WindowTimeline(this.plot, {
      toggle: (window) => this.toggle(window),
      drag: (fromMs, toMs) => this.addSpan(fromMs, toMs),
    });
  }

  destroy() {
    this.timeline.destroy();
  }

  /** given: { windows, active (model or undefined), nowMs, minutes, region }. */
  update(given) {
    const before = this.windows;
    this.given = given;
    this.windows = given.windows;
    // The service sends new windows each time; the selection stays.
    this.byHand &&= this.byHand.map((one) => (before.includes(one)
      ? this.windows.find((other) => other.start === one.start) ?? one : one));
    this.show();
  }

  /** The windows of a request for an identification. */
  request() {
    if (!this.byHand) return 'auto';
    return this.chosen().map(({ start, end }) => ({ start, end }));
  }

  /** Why no identification can be started from this choice, or ''. */
  problem() {
    if (this.byHand) return this.byHand.length ? '' : 'No window is selected.';
    return this.windows.length ? ''
      : 'No low-risk window in the store yet: at least 30 min of good data inside the region.';
  }

  chosen() {
    return (this.byHand ?? this.windows).toSorted((a, b) =>
      milliseconds(a.start) - milliseconds(b.start));
  }

  switch() {
    this.byHand = this.byHand ? null : [...this.windows];
    this.show();
  }

  toggle(window) {
    if (!window) return;
    this.byHand = this.byHand.includes(window) ? this.byHand.filter((one) => one !== window)
      : [...this.byHand.filter((one) => !overlaps(one, window)), window];
    this.show();
  }

  /** A span by hand takes the place of what it overlaps: data must not count twice. */
  addSpan(fromMs, toMs) {
    const minute = 60000;
    const span = windowOf(Math.round(fromMs / minute) * minute, Math.round(toMs / minute) * minute);
    this.byHand = [...this.byHand.filter((one) => !overlaps(one, span)), span];
    this.show();
  }

  show() {
    if (!this.given) return;
    const { region, active, nowMs, minutes } = this.given;
    this.button.disabled = false;
    setText(this.button, this.byHand ? 'Use all windows' : 'Select manually');
    setText(this.text, region ? [`up to ${region.speed_rpm_max} rpm and ${region.load_n_max} N`,
      this.byHand ? 'click a window to include or exclude it; drag to add a range'
        : 'filled windows train the next model'].join('; ') : '');
    this.timeline.update({
      windows: this.windows, used: active?.windows ?? [], chosen: this.chosen(),
      byHand: Boolean(this.byHand), nowMs, minutes, region,
    });
    // Not while a time is typed.
    if (!this.table.contains(document.activeElement) || !this.byHand) this.showTable();
    this.onChange();
  }

  showTable() {
    const used = this.given.active?.windows ?? [];
    if (this.byHand) {
      this.showChosen();
      return;
    }
    const latest = this.chosen().reverse();
    put(this.table, latest.length > 0 && h('details', { class: 's' },
      h('summary', {}, counted(latest.length, 'window')),
      h('table', {},
        h('thead', {}, h('tr', {}, ['From', 'Length', 'Operating points', 'Score', '']
          .map((text) => h('th', {}, text)))),
        h('tbody', {}, latest.map((window) => h('tr', {},
          this.timeCell(window), this.lengthCell(window),
          h('td', {}, window.operating_points.map(pointText).join(' · ')),
          h('td', {}, window.score.toFixed(2)),
          h('td', { class: 'mut' }, isUsed(window, used) ? 'in the active model' : '')))))));
  }

  timeCell({ start }) {
    const ms = milliseconds(start);
    return h('td', { class: 'nw' }, timeElement(ms, dayTime(ms)));
  }

  lengthCell({ start, end }) {
    return h('td', { class: 'nw' }, spanText((milliseconds(end) - milliseconds(start)) / 1000));
  }

  showChosen() {
    const row = (window) => h('tr', {}, this.timeCell(window), this.lengthCell(window),
      h('td', {}, window.operating_points?.map(pointText).join(' · ') ?? 'added manually'),
      h('td', { class: 'r' }, h('button', {
        class: 'btn sm', type: 'button', onclick: () => {
          this.byHand = this.byHand.filter((one) => one !== window);
          this.show();
        },
      }, 'Exclude')));
    const chosen = this.chosen();
    const { nowMs } = this.given;
    const field = (name, ms) => h('input', {
      type: 'datetime-local', name, required: true, value: localInput(ms), 'aria-label': name,
    });
    const [from, to] = [field('From', nowMs - 2 * 3600e3), field('To', nowMs - 3600e3)];
    put(this.table, h('div', { class: 'chosen' }, h('table', {}, h('thead', {}, h('tr', {},
      ['From', 'Length', 'Operating points', ''].map((text) => h('th', {}, text)))),
    h('tbody', {}, chosen.length ? chosen.map(row)
      : h('tr', {}, h('td', { colspan: 4, class: 'mut' }, 'No window is selected.'))))),
    h('form', {
      class: 'row addspan',
      onsubmit: (event) => {
        event.preventDefault();
        const [fromMs, toMs] = [from, to].map((input) => new Date(input.value).getTime());
        to.setCustomValidity(toMs > fromMs ? '' : 'later than the start');
        if (to.reportValidity()) this.addSpan(fromMs, toMs);
        this.showTable();
      },
    }, h('label', { class: 's mut' }, 'From ', from), h('label', { class: 's mut' }, 'to ', to),
    h('button', { class: 'btn sm', type: 'submit' }, 'Add range')));
    to.addEventListener('input', () => to.setCustomValidity(''));
  }
}
