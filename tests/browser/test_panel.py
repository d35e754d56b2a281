"""What every view rests on: a panel follows, draws what differs, and ends what it has begun."""

import pytest
from playwright.sync_api import Page

from tests.browser.test_dashboard_parts import run

pytestmark = pytest.mark.browser

PANEL = """
const { Panel, place, v } = await import('/js/parts/panel.js');
const { Store } = await import('/js/live/store.js');
const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
document.body.replaceChildren();
const store = new Store({ rows: ['b', 'c'] });
let drawn = 0;
let ticks = 0;
class Rows extends Panel {
  constructor(attributes) {
    super(attributes);
    this.follow(store, ['rows'], 0);
    this.every(10, () => { ticks += 1; });
  }
  render({ title }) {
    drawn += 1;
    const style = { height: '50px', overflow: 'auto' };
    return [v('h1', {}, title), v('div', { class: 'box', style },
      store.get('rows').map((row) => v('p', { key: row }, v('input', { name: row }), row)))];
  }
}
const shown = place(document.body, Rows, { title: 'first' });
"""


def test_focus_typed_text_and_scroll_position_survive_an_update(parts: Page) -> None:
    found = run(
        parts,
        PANEL
        + """
        const input = document.querySelector('[name=c]');
        const box = document.querySelector('.box');
        input.value = 'half ty';
        input.focus();
        box.scrollTop = 20;
        store.set('rows', ['a', 'b', 'c', 'd']);
        await sleep(50);
        shown.update({ title: 'second' });
        const order = [...document.querySelectorAll('input')].map(({ name }) => name);
        return { order, same: document.activeElement === input, text: input.value,
          scrolled: box.scrollTop > 0, title: document.querySelector('h1').textContent };
        """,
    )
    assert found == {
        "order": ["a", "b", "c", "d"],
        "same": True,
        "text": "half ty",
        "scrolled": True,
        "title": "second",
    }


def test_a_panel_that_has_left_the_page_hears_and_does_nothing_more(parts: Page) -> None:
    before, after, ticked, late, left = run(
        parts,
        PANEL
        + """
        await sleep(100);
        const ticked = ticks;
        shown.destroy();
        const [before, late] = [drawn, ticks];
        store.set('rows', ['z']);
        shown.part.set({ anything: 1 });
        await sleep(100);
        return [before, drawn, ticked, ticks - late, document.body.childElementCount];
        """,
    )
    assert ticked > 0
    assert (after, late, left) == (before, 0, 0)


def test_a_panel_is_not_drawn_again_for_the_same_attributes(parts: Page) -> None:
    drawn = run(
        parts,
        PANEL
        + """
        const counts = [drawn];
        for (const title of ['first', 'second', 'second']) {
          shown.update({ title });
          counts.push(drawn);
        }
        return counts;
        """,
    )
    assert drawn == [1, 1, 2, 2]


def test_text_of_the_service_stays_text_and_handlers_are_functions_alone(parts: Page) -> None:
    evil = '<img src=x onerror="window.broken = true">'
    found = run(
        parts,
        """
        const { place, v } = await import('/js/parts/panel.js');
        document.body.replaceChildren();
        place(document.body, () => v('p', { title: evil, onclick: 'window.broken = true' }, evil));
        document.querySelector('p').click();
        await new Promise((resolve) => setTimeout(resolve, 50));
        return [document.images.length, window.broken ?? false, document.body.textContent];
        """,
        evil=evil,
    )
    assert found == [0, False, evil]
