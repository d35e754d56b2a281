// One line for the operator: how many forecasts were inside their band.
import { recordStart, recordText } from './accuracy.js';
import { assetPath, call } from './api.js';
import { h, setText } from './dom.js';
import { assetHash } from './route.js';

const REFRESH_MS = 300000;
const RETRY_MS = 20000;

export class ForecastRecord {
  /** hashAsset: the asset's id where the address names one. */
  constructor(page, hashAsset) {
    this.page = page;
    this.element = h('a', {
      class: 's record', href: assetHash('accuracy', hashAsset), hidden: true,
      title: 'Readings of all sensors, 5 min to 4 h ahead, where the machine followed the plan. '
        + 'A 95 % band holds 95 of 100.',
    });
    this.load();
  }

  async load() {
    let nextMs = RETRY_MS;
    try {
      const nowMs = this.page.clock.now() ?? Date.now();
      const { items } = await call(assetPath(this.page.live.assetId, '/forecast-performance'),
        { query: { start: recordStart(nowMs) } });
      if (this.gone) return;
      const text = recordText(items);
      setText(this.element, text);
      this.element.hidden = !text;
      if (text) nextMs = REFRESH_MS;
    } catch {
      // The page says elsewhere when the service is away.
    }
    if (!this.gone) this.timer = setTimeout(() => this.load(), nextMs);
  }

  destroy() {
    this.gone = true;
    clearTimeout(this.timer);
  }
}
