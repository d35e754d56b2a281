// Conditions that are watched and normal: each can be shelved before it is raised.
import { call } from './api.js';
import { refuse } from './alarm_list.js';
import { bold, h, put, setText } from './dom.js';
import { fixed, isNumber, joined } from './format.js';
import { icon } from './icons.js';

export class WatchedPanel {
  constructor(page) {
    this.page = page;
    this.several = page.assets.length > 1;
    this.list = h('ul', { class: 'alist' });
    this.note = h('p', { class: 'mut s pad', role: 'status' });
    this.title = h('summary', {}, 'Normal (inactive) alarms');
    this.element = h('details', { class: 'watched', ontoggle: () => this.refresh() }, this.title,
      h('p', { class: 's mut pad' },
        'Shelve one before work that would raise it, or take it out of service.'),
      this.note, this.list);
  }

  /** Ask again while the panel is open. */
  async refresh() {
    if (!this.element.open) return;
    if (!this.list.children.length) setText(this.note, 'Loading …');
    try {
      const { items } = await call('/alarms', { query: { state: 'NORM' } });
      setText(this.note, items.length ? '' : 'No alarm is normal now.');
      this.show(items);
    } catch (error) {
      setText(this.note, `Cannot be read: ${error.message}.`);
      put(this.list);
    }
    this.note.hidden = !this.note.textContent;
  }

  show(alarms) {
    const at = document.activeElement?.dataset?.of;
    put(this.list, alarms.map((alarm) => this.row(alarm)));
    const { connection } = this.page;
    this.leaveOut(new Set(connection.alarms().map(({ alarm }) => alarm.id)));
    if (at) this.list.querySelector(`[data-of="${CSS.escape(at)}"]`)?.focus();
  }

  /** What has been raised meanwhile stands in the list of alarms; `ids`: a Set or a Map by id. */
  leaveOut(ids) {
    [...this.list.children].filter((row) => ids.has(row.dataset.alarm)).forEach((row) => row.remove());
  }

  row(alarm) {
    const { desk } = this.page;
    const name = this.several ? `${this.page.nameOf(alarm.asset)}: ` : '';
    const value = isNumber(alarm.value) && !alarm.predicted
      ? `${alarm.kind}, ${fixed(alarm.value)} ${alarm.unit ?? '°C'} at last change` : alarm.kind;
    return h('li', { class: 'al NORM', 'data-alarm': alarm.id, 'data-state': 'NORM' },
      h('span', {}, icon('none', 'filled', '1.5em')),
      h('div', { class: 'm' }, bold(joined(`${name}${alarm.message}`)),
        h('span', {}, joined(`priority ${alarm.priority}, ${value}`))),
      h('div', { class: 'ac' }, desk.actionsOf(alarm).map((name) => {
        const button = h('button', {
          class: 'btn sm', type: 'button', 'data-of': `${alarm.id} ${name}`,
          'aria-label': `${desk.text(name)}: ${alarm.message}`,
          onclick: () => this.take(name, alarm),
        }, desk.text(name));
        refuse(button, desk.refusal(name, alarm));
        return button;
      })));
  }

  async take(name, alarm) {
    await this.page.desk.take(name, alarm);
    await this.refresh();
  }
}
