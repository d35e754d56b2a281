// Many assets: what needs attention first, and a map with a cell for each.
import { assetPath, call } from '../app/api.js';
import { button, Hosted, Panel, problem, quiet, scrolled, section, v } from '../parts/panel.js';
import { FleetBar, FleetChoice, groupOf } from './bar.js';
import { markIcon, MARKS, meaningOf } from './marks.js';
import { ageText, fixed, isNumber, joined, milliseconds, percent, spanText } from '../parts/format.js';
import { StateMap } from './state_map.js';
import { headline } from '../alarms/alarm.js';
import { icon } from '../parts/icons.js';
import { ageMs, thisMoment } from '../live/age.js';
import { isDistrust } from '../live/readings.js';
import { assetHash } from '../app/route.js';

const MOST_NAMES = 8;
const WORDS = {
  lost: 'No data', unknown: 'Unknown', waiting: 'Waiting', unread: 'Unknown', safe: 'Unknown',
};
const NOW = { 'not safe': 'Not safe', recovering: 'Recovering', unknown: 'Unknown', safe: 'Safe now' };

/** Priority of what is measured over a limit now: a prediction never looks like a measurement. */
const overPriority = ({ limit, alarm }) => Math.min(limit?.level === 'alarm' ? 1 : 2,
  alarm && !alarm.predicted && !isDistrust(alarm) ? alarm.priority : 3);

function symbolOf(asset) {
  const { state, alarm, limit } = asset;
  if (state === 'over') return [overPriority(asset), 'filled'];
  if (alarm && isDistrust(alarm)) return ['bad', 'filled'];
  if (alarm) return [alarm.priority, alarm.predicted ? 'dashed' : 'hollow'];
  if (state === 'ahead') return [limit?.level === 'alarm' ? 1 : 2, 'dashed'];
  return { lost: ['bad', 'hollow'], safe: ['ok'] }[state] ?? ['none'];
}

/** The word before the reason; none where the reason says it itself. */
function wordOf({ state, alarm, now }) {
  if (state === 'over') return NOW[now];
  if (alarm?.predicted) return 'PREDICTED';
  if (state === 'lost' && alarm) return '';
  return now === 'unknown' ? WORDS[state] : NOW[now];
}

/** The one figure of a row: time to the limit ahead, else the temperature, else the age of it. */
function figureOf(asset, nowMs) {
  if (asset.state === 'ahead' && isNumber(asset.seconds_to_limit)) {
    return [spanText(asset.seconds_to_limit), v('small', {}, joined(` ${percent(asset.probability)}`))];
  }
  const value = isNumber(asset.value_c) && [fixed(asset.value_c), v('span', { class: 'u' }, '°C')];
  if (asset.state !== 'lost') return value || '';
  const ageS = asset.value_at && nowMs !== null ? (nowMs - milliseconds(asset.value_at)) / 1000 : null;
  return [value && v('s', {}, value), ageS !== null && v('small', {}, ` ${ageText(Math.max(0, ageS))} old`)];
}

const lookOf = (asset) => ({ over: `p${overPriority(asset)}`, lost: 'bad' }[asset.state] ?? '');

/** Assets in groups of one alarm, where that is all that is wrong with them; else each alone. */
export const grouped = (items) => [...Map.groupBy(items, (asset) =>
  (asset.state !== 'over' && asset.alarm ? asset.alarm.id : asset.id)).values()];

function causeRow(assets) {
  const [{ alarm }] = assets;
  const names = assets.slice(0, MOST_NAMES).map(({ name }) => name).join(', ');
  return v('li', { key: alarm.id }, v('a', { class: 'bad', href: '#alarms', 'data-asset': alarm.id },
    v('span', { class: 'sy blink' }, icon('bad', 'filled', '1.5em')),
    v('span', { class: 'm' }, v('b', {}, alarm.message), v('span', { class: 's mut' })),
    v('span', { class: 'why' }, `${names}${assets.length > MOST_NAMES ? ', …' : ''}`)));
}

/** items: of `GET /fleet`; nowMs: process time, for the age of what is lost. */
const AttentionList = ({ items, nowMs }) => v('ol', { class: 'attn' }, grouped(items).map((assets) => {
  if (assets.length > 1) return causeRow(assets);
  const [asset] = assets;
  const { id, name, alarm, reason, unacknowledged: waits } = asset;
  const word = wordOf(asset);
  const said = headline({ message: reason });
  return v('li', { key: id }, v('a', { class: lookOf(asset), href: assetHash('operator', id), 'data-asset': id },
    v('span', { class: alarm ? 'sy blink' : 'sy' }, icon(...symbolOf(asset), '1.5em')),
    v('span', { class: 'm' }, v('b', {}, name), v('span', { class: 's mut' }, groupOf(asset))),
    v('b', { class: 'r' }, figureOf(asset, nowMs)),
    v('span', { class: 'why' }, joined(word ? `${word}: ${said}` : said), waits > 1 && ` · + ${waits - 1} more`)));
}));

const STATES = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['unknown', 'unknown', ['none']],
  ['safe', 'safe now', ['ok']], ['waiting', 'waiting for data', ['none']],
];
const ASK_EVERY_MS = 2000;
const PATIENCE_MS = 4000;
const OLD_MS = 4500; // a page that has heard nothing for so long says so
const OLD_STATE_S = 10; // and so does one whose states are that old
const ROWS = 50;
const ROWS_OF_PHONE = 10;
const MOST_ROWS = 1000;

export class View extends Panel {
  constructor(attributes) {
    super(attributes);
    Object.assign(this, { heard: null, problem: '',
      choice: new FleetChoice(STATES.map(([state]) => state), this.page.assets) });
    this.map = new StateMap({
      open: (id) => this.page.openAsset(id, 'operator'), explain: (asset) => this.explain(asset),
    });
    this.legend = legend();
    this.endings.push(() => this.map.destroy());
    this.every(ASK_EVERY_MS, () => this.ask());
    this.every(500);
    this.assetsChanged = () => this.changed();
  }

  componentDidMount() {
    this.changed();
  }

  /** What frame and banner need to know of the whole. */
  get overall() {
    const { counts } = this.answer ?? {};
    const words = [counts?.over && 'not safe', (counts?.lost || counts?.unknown) && 'unknown'];
    return { words: words.filter(Boolean), blind: Boolean(counts?.lost) };
  }

  changed() {
    this.choice.learn(this.page.assets);
    this.rows = matchMedia('(max-width: 760px)').matches ? ROWS_OF_PHONE : ROWS;
    this.showMap(true);
    this.ask(true);
  }

  query() {
    const { group, state, text } = this.choice;
    const chosen = Boolean(state || text);
    return {
      limit: this.rows, ...(group && { group }), ...(text && { search: text }), ...(state && { state }),
      ...(!chosen && { attention: true }),
    };
  }

  /** Ask for the list and the map; an answer to an earlier choice is left. */
  async ask(now = false) {
    if (!now && (this.asking || document.hidden)) return;
    const mine = Symbol('question');
    this.asking = mine;
    const options = { timeoutMs: PATIENCE_MS };
    try {
      const [answer, map] = await Promise.all([
        call('/fleet', { ...options, query: this.query() }), call('/fleet/map', options)]);
      if (mine !== this.asking || this.ended) return;
      this.take(answer, map);
    } catch (error) {
      if (!(error.status >= 0)) throw error;
      if (mine === this.asking) this.problem = error.status ? error.message : 'the service does not answer';
      if (error.status === 422) this.learnAssets(); // a group is gone
    } finally {
      if (mine === this.asking) this.asking = null;
    }
    this.draw();
  }

  take(answer, map) {
    Object.assign(this, { heard: thisMoment(), problem: '', answer });
    const { assets, connection } = this.page;
    if (answer.revision !== connection.revision) this.learnAssets();
    if (map.revision === connection.revision && map.marks.length === assets.length) {
      assets.forEach((asset, index) => { asset.mark = map.marks[index]; });
      this.showMap(Boolean(this.choice.state));
    }
  }

  /** Other assets, or another name of one: their list is read again, and then the map fits it. */
  learnAssets() {
    const { connection } = this.page;
    this.learning ??= connection.guarded(() => connection.loadAssets())
      .finally(() => { this.learning = null; });
  }

  render({ page }) {
    const { answer, choice } = this;
    const { items = [], found = 0, counts = {}, next, total = 0, age_s: ageS } = answer ?? {};
    const chosen = Boolean(choice.state || choice.text);
    const figure = (count) => count.toLocaleString('en');
    // How old the states are; what is too old is said, and looks so.
    const silentMs = this.heard && ageMs(this.heard);
    // However soon the answer came: it is the states in it that may be old.
    const stateS = silentMs === null ? 0 : ageS + silentMs / 1000;
    const late = !document.hidden && (silentMs > OLD_MS || stateS > OLD_STATE_S);
    const old = Boolean(this.problem) || (silentMs !== null && late);
    document.querySelector('main').classList.toggle('old', old);
    const since = silentMs === null ? '' : ` for ${ageText(Math.max(silentMs / 1000, stateS))}`;
    const age = answer ? `states up to ${ageText(stateS)} old` : 'loading';
    return [
      v('h1', { class: 'vh' }, 'Fleet'),
      v(FleetBar, { page, states: STATES, choice, counts, onchange: () => this.changed() }),
      old && problem(`States are not current${since}: ${this.problem
        || (silentMs > OLD_MS ? 'no answer from the service' : 'the service is busy')}.`),
      v('div', { class: 'fmany' },
        section('p-attn', chosen ? 'Found' : 'Assets by priority',
          quiet(answer && (items.length < found ? `${items.length} of ${figure(found)}` : figure(found)), 'status'),
          scrolled('Assets by urgency', 'scroll', v(AttentionList, { items, nowMs: page.clock.now() }),
            answer && !items.length && v('p', { class: 'mut pad' }, chosen ? 'No asset fits what is chosen above.'
              : counts.unread > 0 ? 'Reading …' : 'No active alarms, all data good.'),
            next && this.rows < MOST_ROWS && button('Show more', () => {
              this.rows = Math.min(MOST_ROWS, this.rows * 5);
              this.ask(true);
            }))),
        section('p-states', 'All assets', quiet(counts.unread
          ? `${age}; ${figure(counts.unread)} of ${figure(total)} not read yet` : age),
        v(Hosted, { class: 'kept', make: (box) => box.append(this.map.status, this.map.element) }), this.legend)),
    ];
  }

  /** Draw the map; changed: other assets than before. */
  showMap(changed) {
    const { choice, map } = this;
    const known = this.page.assets;
    known.forEach((asset) => { asset.mark ??= 'k'; });
    const shown = known.filter((asset) => choice.fits(asset)
      && (!choice.state || meaningOf(asset.mark).state === choice.state));
    const key = changed || !this.key ? shown.map(({ id }) => id).join() : this.key;
    if (key !== this.key) map.show(shown);
    else map.repaint();
    this.key = key;
    const over = shown.filter(({ mark }) => meaningOf(mark).state === 'over').length;
    map.element.setAttribute('aria-label', `Map of ${shown.length} assets, ${over} over a limit. `
      + 'Arrow keys choose an asset, Enter opens it.');
  }

  async explain({ id }) {
    try {
      const { now } = await call(assetPath(id, '/verdict'), { timeoutMs: PATIENCE_MS });
      return now.reasons[0] ?? '';
    } catch {
      return '';
    }
  }
}

const legend = () => v('ul', { class: 'legend', 'aria-label': 'Symbols of the map' },
  Object.entries(MARKS).map(([code, { words }]) => v('li', {}, markIcon(code), ' ', words)),
  v('li', {}, v('i', { class: 'framed' }), ' frame: alarm unacknowledged'));
