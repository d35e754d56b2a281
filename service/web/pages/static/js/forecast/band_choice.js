// Which band of the forecast a chart shows: that of each moment, or that of the whole run.
import { choice, key, Panel, v } from '../parts/panel.js';
import { ofWholeRun } from './forecast.js';

const BANDS = [
  [false, 'each moment', '95 % of the readings are expected inside'],
  [true, 'whole run', 'With 90 % all readings of the run are inside, from the first to the last'],
];

/** Key and switch of the band. The choice is the page's, so that every chart shows the same. */
export class BandChoice extends Panel {
  render({ onchange }) {
    const whole = Boolean(this.page.wholeRun);
    const choose = (isWhole) => {
      this.page.wholeRun = isWhole;
      this.draw();
      onchange();
    };
    return v('span', { class: 'bandkeys' }, !whole && key('f50', '50 %'),
      key('f95', v('span', {}, whole ? '90 % whole run' : '95 %')),
      choice('Band of the forecast', BANDS, whole, choose));
  }
}

export const chosenBand = (page, fan) => (page.wholeRun && fan ? ofWholeRun(fan) : fan);
