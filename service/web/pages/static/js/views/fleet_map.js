// Many assets: what needs attention first, and a map with a cell for each.
import { AttentionList } from '../attention_list.js';
import { assetPath, call } from '../api.js';
import { h, put, scrollable, setText } from '../dom.js';
import { FleetBar } from '../fleet_bar.js';
import { markIcon, MARKS, meaningOf } from '../fleet_marks.js';
import { ageText } from '../format.js';
import { StateMap } from '../state_map.js';

const STATES = [
  ['over', 'over a limit', [2, 'filled']], ['ahead', 'limit ahead', [2, 'dashed']],
  ['lost', 'without data', ['bad', 'hollow']], ['unknown', 'unknown', ['none']],
  ['safe', 'safe now', ['ok']], ['waiting', 'waiting for data', ['none']],
];
const ASK_EVERY_MS = 2000;
const PATIENCE_MS = 4000;
const OLD_MS = 4500; // a page that has heard nothing for so long says so
const ROWS = 50;
const ROWS_OF_PHONE = 10;
const MOST_ROWS = 1000;

export class FleetMapView {
  constructor(box, page) {
    this.page = page;
    this.heardMs = null;
    this.problem = '';
    this.bar = new FleetBar(page, STATES, page.assets, () => this.changed());
    this.list = new AttentionList();
    this.map = new StateMap({
      open: (id) => page.openAsset(id, 'operator'), explain: (asset) => this.explain(asset),
    });
    this.title = h('h2', {}, 'Needs attention first');
    this.found = h('span', { class: 's mut', role: 'status' });
    this.more = h('button', { class: 'btn sm', type: 'button', hidden: true, onclick: () => this.showMore() },
      'Show more');
    this.nothing = h('p', { class: 'mut pad', hidden: true });
    this.age = h('span', { class: 's mut' });
    this.old = h('p', { class: 'problem', role: 'alert', hidden: true });
    put(box, h('h1', { class: 'vh' }, 'Fleet'), this.bar.element, this.old,
      h('div', { class: 'fmany' },
        h('section', { class: 'panel p-attn' }, h('header', {}, this.title, this.found),
          scrollable('scroll', 'Assets by urgency', this.list.element, this.nothing, this.more)),
        h('section', { class: 'panel p-states' },
          h('header', {}, h('h2', {}, 'All assets'), this.age), this.map.told, this.map.element, legend())));
    this.changed();
    this.timers = [setInterval(() => this.ask(), ASK_EVERY_MS), setInterval(() => this.tick(), 500)];
  }

  destroy() {
    this.timers.forEach(clearInterval);
    this.bar.destroy();
    this.map.destroy();
    this.ended = true;
  }

  /** What frame and banner need to know of the whole. */
  get overall() {
    const { counts } = this.answer ?? {};
    const words = [counts?.over && 'not safe', (counts?.lost || counts?.unknown) && 'unknown'];
    return { words: words.filter(Boolean), blind: Boolean(counts?.lost) };
  }

  assetsChanged() {
    this.changed();
  }

  /** Another choice was made above. */
  changed() {
    this.rows = matchMedia('(max-width: 760px)').matches ? ROWS_OF_PHONE : ROWS;
    this.showMap(true);
    this.ask(true);
  }

  showMore() {
    this.rows = Math.min(MOST_ROWS, this.rows * 5);
    this.ask(true);
  }

  query() {
    const { group, state, text } = this.bar;
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
    } finally {
      if (mine === this.asking) this.asking = null;
    }
    if (!this.ended) this.tick();
  }

  take(answer, map) {
    this.heardMs = performance.now();
    this.problem = '';
    this.answer = answer;
    const { assets } = this.page;
    const { connection } = this.page;
    // Other assets, or another name of one: their list is read again, and then the map fits it.
    if (answer.revision !== connection.revision) {
      this.learning ??= connection.guarded(() => connection.loadAssets())
        .finally(() => { this.learning = null; });
    }
    if (map.revision === connection.revision && map.marks.length === assets.length) {
      assets.forEach((asset, index) => { asset.mark = map.marks[index]; });
      this.showMap(Boolean(this.bar.state));
    }
    this.bar.show(answer.counts);
    this.list.show(answer.items, this.page.clock.now());
    this.showFound(answer);
  }

  showFound({ items, found, counts, next }) {
    const chosen = Boolean(this.bar.state || this.bar.text);
    setText(this.title, chosen ? 'Found' : 'Needs attention first');
    const many = found.toLocaleString('en');
    setText(this.found, items.length < found ? `${items.length} of ${many}` : many);
    this.more.hidden = !next || this.rows >= MOST_ROWS;
    const reading = counts.unread > 0;
    this.nothing.hidden = items.length > 0;
    setText(this.nothing, chosen ? 'No asset fits what is chosen above.'
      : reading ? 'Reading …' : 'Nothing needs attention.');
  }

  /** Draw the map; changed: other assets than before. */
  showMap(changed) {
    const { bar, map } = this;
    const known = this.page.assets;
    known.forEach((asset) => { asset.mark ??= 'k'; });
    const shown = known.filter((asset) => bar.fits(asset)
      && (!bar.state || meaningOf(asset.mark).state === bar.state));
    const key = changed || !this.key ? shown.map(({ id }) => id).join() : this.key;
    if (key !== this.key) map.show(shown);
    else map.repaint();
    this.key = key;
    const over = shown.filter(({ mark }) => meaningOf(mark).state === 'over').length;
    map.element.setAttribute('aria-label', `Map of ${shown.length} assets, ${over} over a limit. `
      + 'Arrow keys choose an asset, Enter opens it.');
  }

  /** How old the states are; what is too old is said, and looks so. */
  tick() {
    const silentMs = this.heardMs === null ? null : performance.now() - this.heardMs;
    const old = Boolean(this.problem) || (silentMs !== null && silentMs > OLD_MS && !document.hidden);
    this.old.hidden = !old;
    this.old.closest('main').classList.toggle('old', old);
    if (old) {
      const since = silentMs === null ? '' : ` for ${ageText(silentMs / 1000)}`;
      setText(this.old, `States are not current${since}: ${this.problem || 'no answer from the service'}.`);
    }
    const { counts, total, age_s: ageS } = this.answer ?? {};
    const age = silentMs === null ? 'loading' : `states up to ${ageText(ageS + silentMs / 1000)} old`;
    const [unread, all] = [counts?.unread ?? 0, total ?? 0].map((one) => one.toLocaleString('en'));
    setText(this.age, counts?.unread ? `${age}; ${unread} of ${all} not read yet` : age);
  }

  /** What the verdict says of one asset of the map. */
  async explain({ id }) {
    try {
      const { now } = await call(assetPath(id, '/verdict'), { timeoutMs: PATIENCE_MS });
      return now.reasons[0] ?? '';
    } catch {
      return '';
    }
  }
}

function legend() {
  return h('ul', { class: 'legend', 'aria-label': 'Symbols of the map' },
    Object.entries(MARKS).map(([letter, { words }]) => h('li', {}, markIcon(letter), ' ', words)),
    h('li', {}, h('i', { class: 'framed' }), ' frame: alarm unacknowledged'));
}
