// All alarms that wait for an acknowledgement, to be answered one by one from any view.
import { AlarmList } from './alarm_list.js';
import { needsAcknowledge } from './alarms.js';
import { openDialog } from './dialogs.js';
import { h, setText } from './dom.js';

const UPDATE_MS = 500;

/** Open it; alarms(): all of them, live(alarm): what is known now, nameOf(alarm): its asset or ''. */
export async function showWaiting(desk, { alarms, live, nameOf }) {
  const box = h('div', { class: 'alarmbox' });
  const count = h('p', { class: 's mut', role: 'status' });
  const list = new AlarmList(box, desk, { nameOf });
  const update = () => {
    const waiting = alarms().filter(needsAcknowledge);
    setText(count, `${waiting.length} unacknowledged`);
    list.update(new Map(waiting.map((alarm) => [alarm.id, alarm])), live);
  };
  update();
  const timer = setInterval(update, UPDATE_MS);
  const { value } = await openDialog({
    title: 'Unacknowledged alarms', body: [count, box], look: 'wide',
    buttons: [h('button', { class: 'btn', value: 'all' }, 'Alarms view'),
      h('button', { class: 'btn pri', value: 'close' }, 'Close')],
  });
  clearInterval(timer);
  if (value === 'all') location.hash = '#alarms';
}
