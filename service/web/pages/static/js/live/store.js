// What the page knows, by topic. Views subscribe; the live connection writes.

/** Run `action` now if it has not run for `intervalMs`, else once when that time is over. */
function throttled(action, intervalMs) {
  let last = -Infinity;
  let timer = null;
  return () => {
    if (timer !== null) return;
    const wait = Math.max(0, last + intervalMs - performance.now());
    timer = setTimeout(() => {
      timer = null;
      last = performance.now();
      action();
    }, wait);
  };
}

export class Store {
  constructor(initial) {
    this.state = { ...initial };
    this.listeners = new Map();
  }

  get(topic) {
    return this.state[topic];
  }

  set(topic, value) {
    this.state[topic] = value;
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  /**
   * Call `action` after a change of any of the topics, at most once per `intervalMs`.
   * Gives a function that ends the subscription.
   */
  on(topics, action, intervalMs = 50) {
    const listener = throttled(action, intervalMs);
    for (const topic of topics) {
      if (!this.listeners.has(topic)) this.listeners.set(topic, new Set());
      this.listeners.get(topic).add(listener);
    }
    return () => topics.forEach((topic) => this.listeners.get(topic).delete(listener));
  }
}

/** Everything that is forgotten when another asset is chosen. */
export const emptyAsset = () => ({
  loaded: false, // whether everything has been asked for once
  asset: null, // GET /assets/{id}
  tags: {}, // { name: { value, quality, time (ms), unit } }
  nodes: null, // latest state message
  forecast: null,
  verdict: null, // latest verdict of the service, with the moment `heard`
  alarms: new Map(),
  alarmsKnown: false, // whether the alarms were received since the service was started
  jobs: new Map(),
});
