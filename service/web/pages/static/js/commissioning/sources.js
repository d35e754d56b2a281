// The first steps of commissioning: sources, the registers and signals that they really give.
import { openDialog } from '../parts/dialogs.js';
import { field, NumberField, readNumber } from '../parts/number_field.js';
import { button, form, options, Panel, problem, select, table, v } from '../parts/panel.js';
import {
  CHANNELS, completedSource, isPlausible, isTemperature, listenTo, ORDERS, readRegisters,
  registerChannel, scaled, scanUnits, shortNumber, TYPES, unitOf, uploadDbc,
} from './configuration.js';

const READ_EVERY_MS = 2000;
const LISTEN_S = 2;
const UNITS_AT_ONCE = 8;
const KINDS = [['modbus-tcp', 'Modbus TCP'], ['modbus-rtu', 'Modbus RTU (serial line)'], ['can', 'CAN bus']];
const INTERFACES = [
  ['socketcand', 'socketcand server'], ['slcan', 'slcan adapter'], ['socketcan', 'SocketCAN of this machine'],
];
const FIELDS = {
  'modbus-tcp': [['host', 'Host', '192.168.0.10'], ['port', 'Port', 502]],
  'modbus-rtu': [['device', 'Serial port', '/dev/ttyUSB0'], ['baudrate', 'Baud rate', 19200]],
  socketcand: [['host', 'Host', '192.168.0.11'], ['port', 'Port', 29536], ['channel', 'Bus', 'can0']],
  slcan: [['channel', 'Address or serial port', '192.168.0.11:2000']],
  socketcan: [['channel', 'Interface', 'can0']],
};

export class SourceForm extends Panel {
  driver = 'modbus-tcp';
  interface = 'socketcand';

  get kind() {
    return this.driver === 'can' ? this.interface : this.driver;
  }

  render() {
    const can = this.driver === 'can';
    const input = ([name, label, example]) => field(label, typeof example === 'number'
      ? v(NumberField, { name, required: true, least: 1, whole: true, value: example })
      : v('input', { name, required: true, placeholder: example, autocomplete: 'off',
        defaultValue: name === 'channel' && can ? example : '' }), '', this.kind);
    return form({ class: 'sub', 'aria-label': 'Add a source' }, (filled) => this.submit(filled),
      v('div', { class: 'fields' }, field('Kind of source',
        select(null, KINDS, this.driver, (driver) => this.set({ driver })))),
      v('div', { class: 'fields' },
        field('Name', v('input', { name: 'name', required: true, autocomplete: 'off',
          defaultValue: can ? 'drive' : 'sensors' }), 'Channels name the source by it.', String(can)),
        can && field('Connection',
          select(null, INTERFACES, this.interface, (chosen) => this.set({ interface: chosen }))),
        FIELDS[this.kind].map(input),
        can && field('DBC file', v('input', { name: 'dbc', type: 'file', accept: '.dbc', required: true }),
          'Describes the frames of the bus.')),
      problem(this.problem),
      v('div', { class: 'row' }, v('button', { class: 'btn pri' }, 'Add source')));
  }

  async submit(filled) {
    /** @type {any} */
    const { dbc, ...data } = Object.fromEntries(new FormData(filled));
    const given = { name: data.name.trim(), driver: this.driver, ...(dbc ? { interface: this.interface } : {}) };
    for (const [key, , example] of FIELDS[this.kind]) {
      given[key] = typeof example === 'number' ? readNumber(data[key]).value : data[key].trim();
    }
    this.set({ problem: '' });
    try {
      const source = completedSource(given);
      if (dbc) {
        const name = dbc.name.replace(/[^A-Za-z0-9._-]/g, '_').replace(/(\.dbc)?$/i, '.dbc');
        source.dbc = (await uploadDbc(name, await dbc.text())).name;
      }
      this.props.done(source);
    } catch (error) {
      this.set({ problem: `The source was not added: ${error.message}` });
    }
  }
}

/** By its size alone: what is offered first; speeds and loads are larger. */
const looksLikeTemperature = (raw) => raw !== null && raw >= 5 && raw <= 150;

/** Which channel a value is, and its scale where the source gives none (`unit` is null then). */
class ChannelQuestion extends Panel {
  constructor(attributes) {
    super(attributes);
    const { raw, unit, taken } = attributes;
    const free = CHANNELS.filter(([name]) => !taken.includes(name));
    [this.name] = free.find(([name, , own]) => (unit === null ? isTemperature(name) === looksLikeTemperature(raw)
      : own === unit)) ?? free[0] ?? CHANNELS[0];
    Object.assign(this, { scale: 1, offset: 0 });
  }

  get preview() {
    const { raw, unit } = this.props;
    const value = scaled(raw, { scale: this.scale ?? NaN, offset: this.offset ?? NaN });
    if (raw === null) return 'No value came yet.';
    if (unit !== null) return `It is ${shortNumber(raw)} ${unit} now. Choose a channel of the same unit.`;
    return Number.isNaN(value) ? 'Give scale and offset.'
      : `The channel shows ${shortNumber(value)} ${unitOf(this.name)} now.`;
  }

  render({ unit, taken }) {
    // The keypads of some telephones have no minus, which an offset needs.
    const number = (label, name, inputmode = 'decimal') => [v('label', { for: `use-${name}` }, label),
      v(NumberField, { id: `use-${name}`, name, value: this[name], required: true, inputmode,
        oninput: (value) => this.set({ [name]: value }) })];
    return [v('label', { for: 'use-channel' }, 'Channel'),
      v('select', { name: 'channel', id: 'use-channel', onchange: ({ target }) => this.set({ name: target.value }) },
        options(CHANNELS.map(([name, label, own]) => [name,
          `${label} (${own})${taken.includes(name) ? ', in place of the present one' : ''}`]), this.name)),
      unit === null && [number('Scale (value = raw × scale + offset)', 'scale'), number('Offset', 'offset', 'text')],
      v('p', { class: 'preview', role: 'status' }, this.preview)];
  }
}

async function useValue({ taken, use, what, raw, unit = null }, channel) {
  const { value, data } = await openDialog({
    title: `Use ${what}`, body: v(ChannelQuestion, { taken, raw, unit }), confirm: 'Use as this channel',
  });
  if (value !== 'ok') return;
  const [scale, offset] = unit === null ? [data.scale, data.offset].map((text) => readNumber(text).value) : [1, 0];
  use(data.channel, { ...channel, ...(scale === 1 ? {} : { scale }), ...(offset ? { offset } : {}) },
    raw === null ? null : scaled(raw, { scale, offset }));
}

/** The values of a source; the first control of one that was added has the focus. */
class SourceValues extends Panel {
  constructor(attributes) {
    super(attributes);
    this.source = attributes.source;
    this.first = (control) => {
      if (control && attributes.added) control.focus();
    };
  }
}

export class RegisterPanel extends SourceValues {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { unit: this.source.unit ?? 1, first_register: 0, many: 32, kind: 'holding', type: TYPES[0],
      from: 1, units: [], registers: [] });
    this.endings.push(() => this.stop());
  }

  render({ taken, use }) {
    const number = (label, key, most) => field(label, v(NumberField, { value: this[key], least: 0, most, whole: true,
      required: true, oninput: (value) => this.set({ [key]: value }) }));
    const choice = (label, key, pairs) =>
      field(label, select(null, pairs, this[key], (value) => this.set({ [key]: value })));
    const rows = this.registers.filter(({ word }) => word !== null);
    const types = ['int16', 'uint16', ...Object.keys(ORDERS).map((order) => `${this.type} ${order}`)];
    const cell = (register, type, value = null) => {
      const what = `register ${register} as ${type}`;
      return button(shortNumber(value), () => useValue({ taken, use, what, raw: value }, registerChannel({
        ...this.asked, source: this.source.name, usual: this.source.unit ?? 1, register, type,
      })), { class: `val${isPlausible(value) ? '' : ' odd'}`, 'aria-label': `Use ${what}: ${shortNumber(value)}` });
    };
    return v('div', { class: 'sub', role: 'group', 'aria-label': `Registers of ${this.source.name}` },
      v('div', { class: 'row' },
        button(this.from > 1 || this.isScanned ? `Find units from ${this.from}` : 'Find units', () => this.findUnits(),
          { class: 'btn', disabled: this.isScanning, ref: this.first }),
        v('p', { class: 's', role: 'status' }, this.found)),
      v('div', { class: 'row' }, this.units.map((unit) =>
        button(`Unit ${unit}`, () => this.set({ unit }), { class: 'chip' }))),
      v('div', { class: 'fields narrow' }, number('Unit', 'unit', 255),
        choice('Table', 'kind', [['holding', 'holding registers'], ['input', 'input registers']]),
        number('First register', 'first_register', 65535), number('How many', 'many', 125),
        choice('Two registers as', 'type', TYPES.map((one) => [one, one]))),
      v('div', { class: 'row' }, button(this.timer ? 'Stop reading' : 'Show registers',
        () => (this.timer ? this.stop() : this.read(true)), { class: 'btn' }),
      v('p', { class: 's mut', role: 'status' }, this.status)),
      rows.length > 0 && table('Registers', [['Register', ({ register }) => v('th', { scope: 'row' }, register)],
        ...types.map((type) => [type, ({ register, values }) => type in values && cell(register, type, values[type])])],
      rows, { look: 'registers', attributesOf: ({ register }) => ({ key: register }) }));
  }

  async findUnits() {
    this.set({ isScanning: true, found: `Asking units ${this.from} to ${this.from + UNITS_AT_ONCE - 1} …` });
    await this.tried('', async () => {
      const { detail, units } = await scanUnits(this.source, this.from, UNITS_AT_ONCE);
      const there = units.filter(({ answers }) => answers).map(({ unit }) => unit);
      this.units.push(...there);
      if (there.length) [this.unit] = there;
      const last = this.from + units.length - 1;
      this.found = detail !== 'ok' ? detail : there.length
        ? `Answer: ${there.map((unit) => `unit ${unit}`).join(', ')} (asked ${this.from} to ${last}).`
        : `None of the units ${this.from} to ${last} answers.`;
      if (detail === 'ok') Object.assign(this, { isScanned: true, from: last >= 255 ? 1 : last + 1 });
    }, (found) => { this.found = found; });
    this.set({ isScanning: false });
  }

  stop() {
    clearTimeout(this.timer);
    this.set({ timer: null });
  }

  async read(isBegin = false) {
    if (isBegin) this.set({ timer: -1 });
    const asked = { source: this.source, unit: this.unit, kind: this.kind, first: this.first_register,
      count: this.many };
    if (![asked.unit, asked.first, asked.count].every(Number.isFinite)) {
      this.status = 'Not read: unit, first register or number of registers is not right.';
      this.stop();
      return;
    }
    await this.tried('', async () => {
      const { detail, registers } = await readRegisters(asked);
      const there = registers.filter(({ word }) => word !== null).length;
      this.set({ registers, asked: { unit: asked.unit, kind: asked.kind }, status: detail !== 'ok' ? detail : there
        ? `${there} of ${registers.length} registers are there; read every 2 s. Choose a value that makes sense.`
        : 'The unit has none of these registers; try another table or another first register.' });
    }, (status) => this.set({ status }));
    if (this.timer) this.timer = this.after(READ_EVERY_MS, () => this.read());
  }
}

export class SignalPanel extends SourceValues {
  render({ taken, use }) {
    const signals = (this.signals ?? []).toSorted((a, b) => Number(b.frames > 0) - Number(a.frames > 0));
    const columns = [['Message', ({ message }) => message], ['Signal', ({ signal }) => signal],
      ['Value now', ({ value, unit, detail }) => (value === null ? detail : `${shortNumber(value)} ${unit}`)],
      ['Frames', ({ frames }) => frames],
      ['Use', ({ message, signal, value: raw, unit }) => button('Use…', () =>
        useValue({ taken, use, what: `${message}.${signal}`, raw, unit },
          { source: this.source.name, message, signal }),
      { 'aria-label': `Use ${message}.${signal}` })]];
    return v('div', { class: 'sub', role: 'group', 'aria-label': `Signals of ${this.source.name}` },
      v('div', { class: 'row' }, button(this.signals ? 'Listen again' : 'Listen', () => this.listen(),
        { class: 'btn', disabled: this.isListening, ref: this.first }),
      v('p', { class: 's', role: 'status' }, this.status)),
      signals.length > 0 && table('Signals', columns, signals,
        { attributesOf: (one) => ({ class: one.frames ? '' : 'mut', key: `${one.message}.${one.signal}` }) }));
  }

  async listen() {
    this.set({ isListening: true, status: `Listening for ${LISTEN_S} s …` });
    await this.tried('', async () => {
      const { detail, frames, unknown, signals } = await listenTo(this.source, LISTEN_S);
      const there = signals.filter((one) => one.frames).length;
      this.set({ signals, status: detail !== 'ok' ? `${detail}.`
        : `${frames} frames in ${LISTEN_S} s; ${there} of ${signals.length} signals arrive.`
        + (unknown.length ? ` Not in the DBC file: ${unknown.join(', ')}.` : '') });
    }, (status) => { this.status = status; });
    this.set({ isListening: false });
  }
}
