// The map of all assets: one small cell each, in blocks by group, as large as the room allows.
import { h, rem } from '../parts/dom.js';
import { draw, v } from '../parts/panel.js';
import { groupOf } from './bar.js';
import { drawMark, markColours, meaningOf } from './marks.js';
import { font } from '../charts/paint.js';

const LARGEST_PX = 36;
const LEAST_PX = 11; // below that shapes look alike
const LEAST_TOUCH_PX = 12;
const LABELLED_REM = [7.5, 1.9]; // a cell with its name
const HEADING_REM = 1.75;
const GAP_REM = 0.9;
const LEAST_BLOCK_REM = 9;
const MOST_BESIDE = 8; // blocks in a row
const MOST_RATIO = 2;
const NAMELESS = 'Without a group';

/** Sizes of a cell that may be tried, the largest first: { width, height, labelled } in pixels. */
function sizes() {
  const squares = [];
  const least = matchMedia('(pointer: coarse)').matches ? LEAST_TOUCH_PX : LEAST_PX;
  for (let size = LARGEST_PX; size >= least; size -= 1) squares.push(size);
  const [width, height] = LABELLED_REM.map((one) => Math.round(one * rem()));
  return [{ width, height, labelled: true },
    ...squares.map((size) => ({ width: size, height: size, labelled: false }))];
}

function columnsOf(count, { width, beside }, roomPx) {
  const own = (roomPx - (beside - 1) * GAP_REM * rem()) / beside;
  return Math.min(count, Math.max(1, Math.floor(own / width)));
}

/** How high blocks of these counts are together, next to each other where there is room. */
function heightOf(counts, layout, roomPx) {
  const [gap, least] = [GAP_REM * rem(), LEAST_BLOCK_REM * rem()];
  let [x, rowHeight, height] = [0, 0, 0];
  for (const count of counts) {
    const columns = columnsOf(count, layout, roomPx);
    const width = Math.max(columns * layout.width, least);
    const own = Math.ceil(count / columns) * layout.height + HEADING_REM * rem();
    if (x && x + width > roomPx) {
      height += rowHeight + gap;
      [x, rowHeight] = [0, 0];
    }
    x += width + gap;
    rowHeight = Math.max(rowHeight, own);
  }
  return height + rowHeight;
}

/** The largest cell with which blocks of these counts are seen at once; else what is least high. */
export function layoutFor(counts, room) {
  let best = null;
  for (const cell of sizes()) {
    for (let beside = 1; beside <= MOST_BESIDE; beside += 1) {
      const layout = { ...cell, beside, total: 0 };
      layout.total = heightOf(counts, layout, room.width);
      if (best?.width !== cell.width || layout.total < best.total) best = layout;
    }
    if (best.total <= room.height) break;
  }
  return best;
}

export class StateMap {
  colours;
  sprites;

  /** open(id): go to an asset; explain(asset): text about the chosen one, as a promise. */
  constructor({ open, explain }) {
    this.open = open;
    this.explain = explain;
    this.blocks = [];
    this.chosen = null; // { block, index }
    this.status = h('p', { class: 'vh', role: 'status' });
    this.pick = h('i', { class: 'pick', hidden: true });
    this.tip = h('div', { class: 'stip', hidden: true });
    // A finger leaves with each touch.
    this.room = h('div', { class: 'blocks', onpointermove: (event) => this.point(event),
      onpointerleave: (event) => event.pointerType === 'touch' || this.choose(null),
      onclick: (event) => this.click(event) });
    this.element = h('div', {
      class: 'smap', tabindex: 0, role: 'application', 'aria-roledescription': 'map',
      onkeydown: (event) => this.press(event), onfocus: () => this.enter(), onblur: () => this.choose(null),
    });
    this.element.append(this.room, this.tip);
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(this.element);
  }

  destroy() {
    this.observer.disconnect();
    clearTimeout(this.asking);
  }

  /** Show these assets, [{ id, name, mark, … }], in their order; null: the same, other marks. */
  show(assets) {
    const groups = Map.groupBy(assets, groupOf);
    // By name; those without a group come last.
    this.groups = [...groups].sort(([a], [b]) =>
      Number(!a) - Number(!b) || a.localeCompare(b, undefined, { numeric: true }));
    this.size = '';
    this.fit();
  }

  fit() {
    const { clientWidth: width } = this.element;
    if (!width || !this.groups) return;
    const scrolls = getComputedStyle(this.element).overflowY === 'auto';
    const height = scrolls ? this.element.clientHeight : 1.5 * innerHeight;
    const room = { width: width - rem(), height: height - rem() / 2 };
    const cell = layoutFor(this.groups.map(([, assets]) => assets.length), room);
    const size = [room.width, cell.width, cell.beside, window.devicePixelRatio].join();
    if (size === this.size) return;
    this.size = size;
    this.cell = cell;
    this.choose(null);
    const alone = this.groups.length === 1 && !this.groups[0][0];
    const ratio = Math.min(MOST_RATIO, window.devicePixelRatio || 1);
    this.pick.remove();
    draw(this.room);
    this.blocks = this.groups.map(([name, assets]) => ({ name, assets, ratio, drawn: [], canvas: null, count: null,
      columns: columnsOf(assets.length, cell, room.width) }));
    draw(this.room, this.blocks.map((block) => {
      const { name, assets, columns } = block;
      const [blockWidth, blockHeight] = [columns * cell.width, Math.ceil(assets.length / columns) * cell.height];
      return v('section', { class: 'block' },
        !alone && v('h3', {}, v('b', {}, name || NAMELESS),
          v('span', { class: 'n', ref: (one) => { block.count = one; } })),
        v('div', { class: 'cells' }, v('canvas', { 'aria-hidden': 'true', ref: (one) => { block.canvas = one; },
          width: Math.round(blockWidth * ratio), height: Math.round(blockHeight * ratio),
          style: { width: `${blockWidth}px`, height: `${blockHeight}px` } })));
    }));
    this.repaint();
  }

  repaint() {
    this.colours ??= markColours();
    this.sprites ??= new Map();
    for (const block of this.blocks) {
      let over = 0;
      const context = block.canvas.getContext('2d');
      block.assets.forEach((asset, index) => {
        const { state } = meaningOf(asset.mark);
        over += Number(state === 'over');
        if (block.drawn[index] === asset.mark) return;
        block.drawn[index] = asset.mark;
        this.paint(context, block, index);
      });
      const count = block.assets.length.toLocaleString('en');
      if (block.count) block.count.textContent = over ? `${count}, ${over} over a limit` : count;
    }
  }

  paint(context, block, index) {
    const { width, height, labelled } = this.cell;
    const { ratio, columns } = block;
    const { mark, name } = block.assets[index];
    const code = mark.toLowerCase();
    const [x, y] = [(index % columns) * width, Math.floor(index / columns) * height];
    context.setTransform(ratio, 0, 0, ratio, x * ratio, y * ratio);
    context.clearRect(0, 0, width, height);
    context.drawImage(this.sprite(code, height, ratio), 0, 0, height, height);
    const [, line, text] = this.colours[code];
    if (labelled) {
      const room = width - height - 4;
      context.font = font(rem() * 0.75, 'ab'.includes(code));
      context.fillStyle = 'ab'.includes(code) ? this.colours.c[1] : text;
      context.textBaseline = 'middle';
      context.fillText(cut(context, name, room), height, height / 2 + 1);
    }
    if (mark === code) return;
    context.lineWidth = height < 16 ? 1 : 1.5;
    context.strokeStyle = line;
    context.strokeRect(0.5, 0.5, width - 1, height - 1);
  }

  sprite(code, size, ratio) {
    const key = `${code}${size}/${ratio}`;
    if (!this.sprites.has(key)) {
      const canvas = document.createElement('canvas');
      canvas.width = canvas.height = Math.round(size * ratio);
      const context = canvas.getContext('2d');
      context.scale(ratio, ratio);
      drawMark(context, code, size, this.colours[code]);
      this.sprites.set(key, canvas);
    }
    return this.sprites.get(key);
  }

  // -- the chosen cell
  at(event) {
    const block = this.blocks.find(({ canvas }) => canvas === event.target);
    if (!block) return null;
    const box = block.canvas.getBoundingClientRect();
    const column = Math.floor((event.clientX - box.left) / this.cell.width);
    const row = Math.floor((event.clientY - box.top) / this.cell.height);
    const index = row * block.columns + column;
    return column < block.columns && index < block.assets.length ? { block, index } : null;
  }

  point(event) {
    if (event.pointerType !== 'touch') this.choose(this.at(event));
  }

  /** A finger first asks what a cell is, and opens it with the second touch. */
  click(event) {
    const found = this.at(event);
    const again = found && found.block === this.chosen?.block && found.index === this.chosen.index;
    if (found && (again || event.pointerType !== 'touch')) this.open(found.block.assets[found.index].id);
    else this.choose(found);
  }

  /** Who comes with the keyboard sees where it is; a finger or a mouse chooses itself. */
  enter() {
    if (!this.chosen && this.element.matches(':focus-visible')) this.step('Home');
  }

  press(event) {
    if (event.key === 'Enter' && this.chosen) {
      this.open(this.chosen.block.assets[this.chosen.index].id);
    } else if (event.key === 'Escape') this.choose(null);
    else if (!this.step(event.key)) return;
    event.preventDefault();
  }

  /** Go to the next cell with a key; gives whether the key is one of the map's. */
  step(key) {
    if (!this.blocks.length) return false;
    const at = this.blocks.indexOf(this.chosen?.block);
    const block = this.blocks[at] ?? this.blocks[0];
    const index = this.chosen?.index ?? 0;
    const by = { ArrowRight: 1, ArrowLeft: -1, ArrowDown: block.columns, ArrowUp: -block.columns }[key];
    const toFirst = (one) => one && this.choose({ block: one, index: 0 });
    const toLast = (one) => one && this.choose({ block: one, index: one.assets.length - 1 });
    if (key === 'Home') toFirst(this.blocks[0]);
    else if (key === 'End') toLast(this.blocks.at(-1));
    else if (by === undefined) return false;
    else if (this.chosen && block.assets[index + by]) this.choose({ block, index: index + by });
    else if (by > 0) toFirst(this.blocks[at + 1]);
    else toLast(this.blocks[at - 1]);
    this.pick.scrollIntoView({ block: 'nearest' });
    return true;
  }

  choose(chosen) {
    const same = chosen?.block === this.chosen?.block && chosen?.index === this.chosen?.index;
    if (same && Boolean(chosen) === Boolean(this.chosen)) return;
    this.chosen = chosen;
    clearTimeout(this.asking);
    this.pick.hidden = this.tip.hidden = !chosen;
    if (!chosen) return;
    const { block, index } = chosen;
    const { width, height } = this.cell;
    const [x, y] = [(index % block.columns) * width, Math.floor(index / block.columns) * height];
    Object.assign(this.pick.style, {
      left: `${x}px`, top: `${y}px`, width: `${width}px`, height: `${height}px`,
    });
    block.canvas.after(this.pick);
    this.announce();
    this.asking = setTimeout(() => this.ask(block.assets[index]), 150);
  }

  /** What the chosen cell stands for, next to it and for screen readers. */
  announce(more = '') {
    const { block, index } = this.chosen;
    const asset = block.assets[index];
    const { words, waits } = meaningOf(asset.mark);
    const state = `${words}${waits ? ', alarm unacknowledged' : ''}`;
    const [group, { name, bearing }] = [groupOf(asset), asset];
    draw(this.tip, v('b', {}, name), v('span', {}, [group, bearing].filter(Boolean).join(' · ')), v('span', {}, state),
      more && v('span', { class: 'mut' }, more));
    this.status.textContent = `${[name, group].filter(Boolean).join(', ')}: ${state}. ${more}`;
    const [of, at] = [this.element.getBoundingClientRect(), this.pick.getBoundingClientRect()];
    const left = Math.min(at.right + 8, of.right - this.tip.offsetWidth - 8) - of.left;
    const needed = this.tip.offsetHeight + 8;
    const below = at.bottom + needed < of.bottom || at.top - of.top < needed;
    const top = (below ? at.bottom + 6 : at.top - this.tip.offsetHeight - 6) - of.top;
    Object.assign(this.tip.style, {
      left: `${Math.max(4, left) + this.element.scrollLeft}px`, top: `${top + this.element.scrollTop}px`,
    });
  }

  async ask(asset) {
    const more = await this.explain(asset);
    const { block, index } = this.chosen ?? {};
    if (more && block?.assets[index] === asset) this.announce(more);
  }
}

/** As much of a name as there is room for: its end differs from its neighbours'. */
function cut(context, text, room) {
  if (context.measureText(text).width <= room) return text;
  let end = text;
  while (end.length > 1 && context.measureText(`…${end}`).width > room) end = end.slice(1);
  return `…${end}`;
}
