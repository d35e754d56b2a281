// The first steps of commissioning: sources, the registers and signals that they really give.
import {
  CHANNELS, isPlausible, listenTo, readRegisters, registerChannel, scanUnits, scaled, shortNumber,
  TYPES, unitOf, uploadDbc, ORDERS,
} from './commissioning.js';
import { openDialog } from './dialogs.js';
import { h, put, scrollable, setText } from './dom.js';

const READ_EVERY_MS = 2000;
const LISTEN_S = 2;
const UNITS_AT_ONCE = 8;

const KINDS = [['modbus-tcp', 'Modbus TCP'], ['modbus-rtu', 'Modbus RTU (serial line)'], ['can', 'CAN bus']];
const INTERFACES = [
  ['socketcand', 'socketcand server'], ['slcan', 'slcan adapter'], ['socketcan', 'SocketCAN of this machine'],
];
const FIELDS = {
  'modbus-tcp': [['host', 'Host', '192.168.0.10'], ['port', 'Port', 502, 'number']],
  'modbus-rtu': [['device', 'Serial port', '/dev/ttyUSB0'], ['baudrate', 'Baud rate', 19200, 'number']],
  socketcand: [['host', 'Host', '192.168.0.11'], ['port', 'Port', 29536, 'number'], ['channel', 'Bus', 'can0']],
  slcan: [['channel', 'Address or serial port', 'socket://192.168.0.11:2000']],
  socketcan: [['channel', 'Interface', 'can0']],
};
let count = 0;

/** A label above its control. */
export function field(label, control, hint = '') {
  count += 1;
  control.id = `commissioning-${count}`;
  if (hint) control.setAttribute('aria-describedby', `${control.id}-hint`);
  return h('div', { class: 'field' }, h('label', { for: control.id }, label), control,
    hint && h('p', { class: 'xs mut', id: `${control.id}-hint` }, hint));
}

export const options = (pairs, chosen) => pairs.map(([value, text]) =>
  h('option', { value, selected: value === chosen }, text));

/** The form that makes a source. */
export class SourceForm {
  /** done is called with the table of the new source */
  constructor(done) {
    this.done = done;
    this.kind = h('select', { onchange: () => this.show() }, options(KINDS));
    this.interface = h('select', { onchange: () => this.show() }, options(INTERFACES));
    this.body = h('div', { class: 'fields' });
    this.problem = h('p', { class: 'problem', role: 'alert' });
    this.element = h('form', { class: 'sub', 'aria-label': 'Add a source', onsubmit: (event) => {
      event.preventDefault();
      this.submit();
    } }, h('div', { class: 'fields' }, field('Kind of source', this.kind)), this.body, this.problem,
    h('div', { class: 'row' }, h('button', { class: 'btn pri' }, 'Add source')));
    this.show();
  }

  show() {
    const can = this.kind.value === 'can';
    this.inputs = new Map();
    const input = ([key, label, example, type = 'text']) => {
      const control = h('input', { required: true, type, placeholder: type === 'text' ? example : null,
        value: type === 'number' ? example : key === 'channel' && can ? example : '', autocomplete: 'off' });
      this.inputs.set(key, control);
      return field(label, control);
    };
    const name = h('input', { required: true, value: can ? 'drive' : 'sensors', autocomplete: 'off' });
    this.inputs.set('name', name);
    this.file = can ? h('input', { type: 'file', accept: '.dbc', required: true }) : null;
    put(this.body, field('Name', name, 'Channels name the source by it.'),
      can && field('Reached through', this.interface),
      FIELDS[can ? this.interface.value : this.kind.value].map(input),
      can && field('DBC file', this.file, 'Describes the frames of the bus.'));
  }

  async submit() {
    const source = { name: '', driver: this.kind.value };
    for (const [key, control] of this.inputs) {
      source[key] = control.type === 'number' ? Number(control.value) : control.value.trim();
    }
    setText(this.problem, '');
    try {
      if (this.file) {
        source.interface = this.interface.value;
        const [file] = this.file.files;
        const name = file.name.replace(/[^A-Za-z0-9._-]/g, '_').replace(/(\.dbc)?$/i, '.dbc');
        source.dbc = (await uploadDbc(name, await file.text())).name;
      }
      this.done(source);
    } catch (error) {
      setText(this.problem, `The source was not added: ${error.message}`);
    }
  }
}

/** Asks which channel a value is; resolves with { name, scale, offset } or null. */
async function askChannel(what, raw, taken) {
  const choice = h('select', { name: 'channel', id: 'use-channel' },
    CHANNELS.map(([name, label, unit]) => h('option', { value: name },
      `${label} (${unit})${taken.includes(name) ? ', in place of the present one' : ''}`)));
  const free = CHANNELS.find(([name]) => !taken.includes(name));
  if (free) [choice.value] = free;
  const number = (name, value) => h('input', {
    id: `use-${name}`, name, type: 'number', step: 'any', value, required: true,
  });
  const [scale, offset] = [number('scale', 1), number('offset', 0)];
  const shown = h('p', { class: 'preview', role: 'status' });
  const show = () => setText(shown, raw === null ? 'No value came yet.' : `The channel shows ${shortNumber(scaled(raw, {
    scale: Number(scale.value), offset: Number(offset.value),
  }))} ${unitOf(choice.value)} now.`);
  for (const one of [choice, scale, offset]) one.addEventListener('input', show);
  show();
  const { value, data } = await openDialog({
    title: `Use ${what}`,
    body: [h('label', { for: 'use-channel' }, 'Channel'), choice,
      h('label', { for: 'use-scale' }, 'Scale (value = raw × scale + offset)'), scale,
      h('label', { for: 'use-offset' }, 'Offset'), offset, shown],
    buttons: [h('button', { class: 'btn', value: '', formnovalidate: true }, 'Cancel'),
      h('button', { class: 'btn pri', value: 'ok' }, 'Use as this channel')],
  });
  return value === 'ok' ? { name: data.channel, scale: Number(data.scale), offset: Number(data.offset) } : null;
}

/** Keys of a scale that is not the usual one. */
const scaling = ({ scale, offset }) => ({ ...(scale === 1 ? {} : { scale }), ...(offset ? { offset } : {}) });

/** Units and registers of a Modbus source, live. */
export class RegisterPanel {
  /** actions: { taken(), use(name, channel, value) } */
  constructor(source, actions) {
    Object.assign(this, { source, actions });
    const number = (value, most) => h('input', { type: 'number', value, min: 0, max: most, required: true });
    this.unit = number(source.unit ?? 1, 255);
    this.first = number(0, 65535);
    this.many = number(32, 125);
    this.kind = h('select', {}, options([['holding', 'holding registers'], ['input', 'input registers']]));
    this.type = h('select', { onchange: () => this.show() }, options(TYPES.map((one) => [one, one])));
    this.found = h('p', { class: 's', role: 'status' });
    this.units = h('div', { class: 'row' });
    this.status = h('p', { class: 's mut', role: 'status' });
    this.body = h('div', {});
    this.scan = h('button', { class: 'btn', type: 'button', onclick: () => this.findUnits() }, 'Find units');
    this.reader = h('button', { class: 'btn', type: 'button', onclick: () => this.toggle() }, 'Show registers');
    this.element = h('div', { class: 'sub', role: 'group', 'aria-label': `Registers of ${source.name}` },
      h('div', { class: 'row' }, this.scan, this.found), this.units,
      h('div', { class: 'fields narrow' }, field('Unit', this.unit), field('Table', this.kind),
        field('First register', this.first), field('How many', this.many), field('Two registers as', this.type)),
      h('div', { class: 'row' }, this.reader, this.status), this.body);
    this.from = 1;
  }

  async findUnits() {
    this.scan.disabled = true;
    setText(this.found, `Asking units ${this.from} to ${this.from + UNITS_AT_ONCE - 1} …`);
    try {
      const { detail, units } = await scanUnits(this.source, this.from, UNITS_AT_ONCE);
      const there = units.filter(({ answers }) => answers);
      for (const { unit } of there) {
        this.units.append(h('button', { class: 'chip', type: 'button', onclick: () => {
          this.unit.value = unit;
        } }, `Unit ${unit}`));
      }
      if (there.length) this.unit.value = there[0].unit;
      const last = this.from + units.length - 1;
      setText(this.found, detail !== 'ok' ? detail : there.length
        ? `Answer: ${there.map(({ unit }) => `unit ${unit}`).join(', ')} (asked ${this.from} to ${last}).`
        : `None of the units ${this.from} to ${last} answers.`);
      if (detail === 'ok') {
        this.from = last >= 255 ? 1 : last + 1;
        setText(this.scan, `Find units from ${this.from}`);
      }
    } catch (error) {
      setText(this.found, error.message);
    } finally {
      this.scan.disabled = false;
    }
  }

  toggle() {
    if (this.timer) this.stop();
    else this.start();
  }

  async start() {
    this.timer = -1;
    setText(this.reader, 'Stop reading');
    await this.read();
  }

  stop() {
    clearTimeout(this.timer);
    this.timer = null;
    setText(this.reader, 'Show registers');
  }

  async read() {
    const asked = { source: this.source, unit: Number(this.unit.value), kind: this.kind.value,
      first: Number(this.first.value), count: Number(this.many.value) };
    try {
      const { detail, registers } = await readRegisters(asked);
      this.asked = asked;
      this.registers = registers;
      const there = registers.filter(({ word }) => word !== null).length;
      setText(this.status, detail !== 'ok' ? detail : there
        ? `${there} of ${registers.length} registers are there; read every 2 s. Choose a value that makes sense.`
        : 'The unit has none of these registers; try another table or another first register.');
      this.show();
    } catch (error) {
      setText(this.status, error.message);
    }
    if (this.timer && this.element.isConnected) this.timer = setTimeout(() => this.read(), READ_EVERY_MS);
  }

  show() {
    const rows = (this.registers ?? []).filter(({ word }) => word !== null);
    const columns = ['int16', 'uint16', ...Object.keys(ORDERS).map((order) => `${this.type.value} ${order}`)];
    const look = JSON.stringify([columns, rows.map(({ register }) => register), this.asked]);
    if (look !== this.look) {
      this.look = look;
      this.cells = new Map();
      put(this.body, rows.length > 0 && scrollable('scroll', 'Registers', h('table', { class: 'registers' },
        h('thead', {}, h('tr', {}, ['Register', ...columns].map((text) => h('th', { scope: 'col' }, text)))),
        h('tbody', {}, rows.map(({ register }) => h('tr', {}, h('th', { scope: 'row' }, register),
          columns.map((type) => h('td', {}, this.cell(register, type)))))))));
    }
    for (const { register, values } of rows) {
      for (const type of columns) this.fillCell(this.cells.get(`${register} ${type}`), values[type]);
    }
  }

  cell(register, type) {
    const button = h('button', { class: 'val', type: 'button', onclick: () => this.use(register, type) });
    this.cells.set(`${register} ${type}`, button);
    button.dataset.what = `register ${register} as ${type}`;
    return button;
  }

  fillCell(button, value) {
    button.hidden = value === undefined;
    setText(button, shortNumber(value ?? null));
    button.classList.toggle('odd', !isPlausible(value ?? null));
    button.setAttribute('aria-label', `Use ${button.dataset.what}: ${shortNumber(value ?? null)}`);
  }

  async use(register, type) {
    const raw = this.registers.find((one) => one.register === register)?.values[type] ?? null;
    const answer = await askChannel(`register ${register} as ${type}`, raw, this.actions.taken());
    if (!answer) return;
    const { unit, kind } = this.asked;
    const channel = registerChannel({
      source: this.source.name, unit, usual: this.source.unit ?? 1, kind, register, type,
    });
    this.actions.use(answer.name, { ...channel, ...scaling(answer) }, raw === null ? null : scaled(raw, answer));
  }
}

/** Signals of a CAN source, and which of them arrive. */
export class SignalPanel {
  constructor(source, actions) {
    Object.assign(this, { source, actions });
    this.status = h('p', { class: 's', role: 'status' });
    this.button = h('button', { class: 'btn', type: 'button', onclick: () => this.listen() }, 'Listen');
    this.body = h('div', {});
    this.element = h('div', { class: 'sub', role: 'group', 'aria-label': `Signals of ${source.name}` },
      h('div', { class: 'row' }, this.button, this.status), this.body);
  }

  stop() {}

  async listen() {
    this.button.disabled = true;
    setText(this.status, `Listening for ${LISTEN_S} s …`);
    try {
      const { detail, frames, unknown, signals } = await listenTo(this.source, LISTEN_S);
      const there = signals.filter((one) => one.frames).length;
      setText(this.status, detail !== 'ok' ? `${detail}.`
        : `${frames} frames in ${LISTEN_S} s; ${there} of ${signals.length} signals arrive.`
        + (unknown.length ? ` Not in the DBC file: ${unknown.join(', ')}.` : ''));
      this.show(signals);
    } catch (error) {
      setText(this.status, error.message);
    } finally {
      this.button.disabled = false;
      setText(this.button, 'Listen again');
    }
  }

  show(signals) {
    const sorted = [...signals].sort((a, b) => Number(b.frames > 0) - Number(a.frames > 0));
    put(this.body, signals.length > 0 && scrollable('scroll', 'Signals', h('table', {},
      h('thead', {}, h('tr', {}, ['Message', 'Signal', 'Value now', 'Frames', 'Use']
        .map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, sorted.map((one) => h('tr', { class: one.frames ? '' : 'mut' },
        h('td', {}, one.message), h('td', {}, one.signal),
        h('td', {}, one.value === null ? one.detail : `${shortNumber(one.value)} ${one.unit}`),
        h('td', {}, one.frames), h('td', {}, h('button', { class: 'btn sm', type: 'button',
          'aria-label': `Use ${one.message}.${one.signal}`, onclick: () => this.use(one) }, 'Use…'))))))));
  }

  async use({ message, signal, value, unit }) {
    const answer = await this.ask(`${message}.${signal}`, value, unit);
    if (answer) this.actions.use(answer.name, { source: this.source.name, message, signal }, value);
  }

  /** The DBC file scales a signal: only its channel is asked for. */
  async ask(what, value, unit) {
    const taken = this.actions.taken();
    const choice = h('select', { name: 'channel', id: 'use-channel' }, CHANNELS.map(([name, label, own]) =>
      h('option', { value: name }, `${label} (${own})`)));
    const fits = CHANNELS.find(([name, , own]) => own === unit && !taken.includes(name));
    if (fits) [choice.value] = fits;
    const { value: button, data } = await openDialog({
      title: `Use ${what}`,
      body: [h('label', { for: 'use-channel' }, 'Channel'), choice,
        h('p', { class: 'preview' }, value === null ? 'No value came yet.'
          : `It is ${shortNumber(value)} ${unit} now. Choose a channel of the same unit.`)],
      buttons: [h('button', { class: 'btn', value: '' }, 'Cancel'),
        h('button', { class: 'btn pri', value: 'ok' }, 'Use as this channel')],
    });
    return button === 'ok' ? { name: data.channel } : null;
  }
}

